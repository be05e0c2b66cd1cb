"""How this version of XLA compiles a loop into one native function on a CPU.

Neither the flag nor the options are documented. They are probed for once; where they are refused,
everything works through `vmap`, only slower.
"""

import os
import warnings
from functools import cache

import jax
import jax.numpy as jnp
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
second sees the first in values that were read before.
"""


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
    return not problem


def nested_options() -> dict[str, str | bool | int] | None:
    """`NESTED_OPTIONS` for ``jax.jit``; None where there are no native loops.

    A loop that holds Mario's engine must be compiled with these: with `OPTIONS` its sprites differ from the original's.
    """
    return dict(NESTED_OPTIONS) if native_loops_available() else None


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
