"""How this version of XLA compiles a loop into one native function on a CPU.

Neither the flag nor the options are documented. They are probed for once; where they are refused,
everything works through `vmap`, only slower.
"""

import os
import time
import warnings
from collections.abc import Callable
from functools import cache
from math import inf
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

_FLAG = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000"

OPTIONS: dict[str, str | bool | int] = {
    # Tables are changed in place when every read of them comes before the write.
    "xla_cpu_copy_insertion_use_region_analysis": True,
    "xla_cpu_prefer_vector_width": 512,
    # A loop that is one function cannot call the thread pool; cores are used by running many loops.
    "xla_disable_hlo_passes": "cpu-parallel-task-assigner",
}
"""Compiler options of a native loop."""

NESTED_OPTIONS: dict[str, str | bool | int] = {
    name: value for name, value in OPTIONS.items() if "region_analysis" not in name
}
"""Compiler options of a native loop whose steps hold loops that change the same arrays several times.

With the region analysis of copies, XLA (jaxlib 0.10.2) drops copies that such loops need: an outer
loop's counter is overwritten while an inner loop still reads it, and of two writes to one array the
second sees the first in values that were read before. ``tests/engine/test_compiler.py`` shows the day on
which that is mended.
"""

_TURNS = 256
_TABLE_SIZES = 2**10, 2**18
_MOST_GROWTH = 200
"""By how much more a turn may take with the larger table. A call has it copied once: 3 on a quiet machine, 40 on a
busy one; that jaxlib 0.11.1 copied it in every turn made for 1,000."""
_TRIES = 8


def request_native_loops() -> None:
    """Asks XLA, through its environment variable, to compile large loops natively too.

    Has an effect only before the process compiles for the first time. Flags that the user has set
    are kept; a user's own ``xla_backend_extra_options`` are left as they are.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_backend_extra_options" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_FLAG}".strip()


@cache
def native_loops_available() -> bool:
    """Whether a loop over a large table compiles into one native function; warns once if not."""
    problem = _probe()
    if problem:
        warnings.warn(
            f"runs are mapped with vmap, which is slower on a CPU: {problem}. Import hrljax before anything "
            "is computed with JAX, or set XLA_FLAGS=" + _FLAG + " in the environment.",
            RuntimeWarning,
            stacklevel=3,
        )
    elif write_cost().grows:
        warnings.warn(f"runs will be slow: {write_cost()}", RuntimeWarning, stacklevel=3)
    return not problem


class WriteCost(NamedTuple):
    """What a turn of a loop takes that writes one number into a table, in seconds."""

    small: float  # with a table of 4 KiB
    large: float  # with a table of 1 MiB

    @property
    def grows(self) -> bool:
        """Whether it takes longer the larger the table is, as if the table were copied in every turn."""
        return self.large > _MOST_GROWTH * self.small

    def __str__(self) -> str:
        small, large = (f"{1e9 * seconds:.0f} ns" for seconds in self)
        what = f"a loop's turn that writes one number takes {small} with a table of 4 KiB and {large} with one of 1 MiB"
        if not self.grows:
            return what
        return f"{what}, so this version of jaxlib copies whole tables (as in jax-ml/jax#40101); try another one"


@cache
def write_cost() -> WriteCost:
    """Times a tiny native loop with a small and with a large table, once a process.

    Some versions of XLA copy the table in every turn, with the same optimised program: only time tells.
    """
    small, large = map(_writing, _TABLE_SIZES)
    return _timed(small, large)


def _writing(size: int) -> Callable[[], object]:
    """A compiled loop that writes into a table of some float32 numbers, a power of two of them."""
    shift = np.uint32(33 - size.bit_length())

    def loop(table: jax.Array) -> jax.Array:
        def turn(i: jax.Array, table: jax.Array) -> jax.Array:
            place = (i * np.uint32(0x9E3779B9)) >> shift
            return lax.dynamic_update_slice(table, lax.dynamic_slice(table, (place,), (1,)) + np.float32(1), (place,))

        return lax.fori_loop(np.uint32(0), np.uint32(_TURNS), turn, table)

    table = np.zeros(size, np.float32)
    # The copies that are looked for are XLA's: LLVM need not do its best, which takes a third of the time.
    options = {**OPTIONS, "xla_backend_optimization_level": 0}
    with jax.default_device(jax.devices("cpu")[0]):
        compiled = jax.jit(loop, compiler_options=options).lower(table).compile()
    return lambda: compiled(table).block_until_ready()


def _timed(
    small: Callable[[], object], large: Callable[[], object], clock: Callable[[], float] = time.perf_counter
) -> WriteCost:
    """The least times of a few tries: other programs only make them longer."""

    def turn(run: Callable[[], object]) -> float:
        began = clock()
        run()
        return (clock() - began) / _TURNS

    cost = WriteCost(inf, inf)
    for run in (small, large):
        run()  # the first call has more to do
    for number in range(_TRIES):
        cost = WriteCost(min(cost.small, turn(small)), min(cost.large, turn(large)))
        if number >= 2 and not cost.grows:
            break
    return cost


def nested_options() -> dict[str, str | bool | int] | None:
    """`NESTED_OPTIONS` for ``jax.jit``; None where there are no native loops.

    A loop that holds Mario's engine must be compiled with these: with `OPTIONS` its sprites differ from the original's.
    """
    return dict(NESTED_OPTIONS) if native_loops_available() else None


@cache
def lockstep_options() -> dict[str, str | bool | int]:
    """Those of `NESTED_OPTIONS` that this version of XLA takes, for runs that `vmap` puts side by side on a CPU.

    With the pass that they switch off, a step that reads a large table for many runs is spread over cores, which up to
    jax 0.10 does not link within a native loop. It is chunks of runs that the cores are given.
    """
    return {name: value for name, value in NESTED_OPTIONS.items() if _is_taken(name, value)}


def _is_taken(name: str, value: str | bool | int) -> bool:
    try:
        with jax.default_device(jax.devices("cpu")[0]):
            jax.jit(lambda: jnp.float32(0), compiler_options={name: value}).lower().compile()
    except Exception:  # whatever a future compiler raises
        return False
    return True


def _probe() -> str:
    """Compiles a loop that touches as much memory in a turn as learners do; says what is wrong, or nothing."""

    def loop(table: jax.Array) -> jax.Array:
        def step(i: jax.Array, table: jax.Array) -> jax.Array:
            old = lax.dynamic_slice(table, (i,), (2**17,))
            return lax.dynamic_update_slice(table, old + jnp.float32(1), (i,))

        return lax.fori_loop(jnp.uint32(0), jnp.uint32(8), step, table)

    try:
        table = jax.ShapeDtypeStruct((2**18,), jnp.float32)
        cpu = jax.devices("cpu")[0]
        with jax.default_device(cpu):
            text = jax.jit(loop, compiler_options=dict(OPTIONS)).lower(table).compile().as_text()
    except Exception as error:  # whatever a future compiler raises, the fallback is the same
        return f"this version of XLA refuses the compiler options of native loops ({type(error).__name__})"
    if "xla_cpu_small_call" not in (text or ""):
        return "XLA was started without the flag for native loops"
    return ""
