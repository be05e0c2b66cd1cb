"""What the library believes of the compiler: faults that it works around, and how it notices slow writes.

The tests of faults say that XLA still has them. One that fails tells what can be taken out of the library.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from hrljax.core.numerics import exact_product, opaque_zero
from hrljax.engine import compiler

# Faults of the compiler

newest = pytest.mark.skipif(jax.__version_info__ < (0, 10), reason="is about the newest versions of XLA")


def nested(table: Any, loop: Callable[..., Any], get: Callable[..., Any], put: Callable[..., Any]) -> Any:
    """For each i below 8, for each j up to i: ``table[(i + j) % 8] = table[i] + 1``.

    The inner loop reads the counter of the outer one.
    """

    def outer(i: Any, table: Any) -> Any:
        return loop(i + 1, lambda j, table: put(table, (i + j) % 8, get(table, i) + 1), table)

    return loop(8, outer, table)


def in_python(table: list[int]) -> list[int]:
    def loop(count: int, turn: Callable[..., Any], table: list[int]) -> list[int]:
        for i in range(count):
            table = turn(i, table)
        return table

    return nested(table, loop, lambda table, i: table[i], lambda table, i, value: [*table[:i], value, *table[i + 1 :]])


def in_jax(table: jax.Array) -> jax.Array:
    def put(table: jax.Array, i: jax.Array, value: jax.Array) -> jax.Array:
        return lax.dynamic_update_slice(table, value[None], (i,))

    def loop(count: Any, turn: Callable[..., Any], table: jax.Array) -> jax.Array:
        return lax.fori_loop(jnp.int32(0), jnp.asarray(count, jnp.int32), turn, table)

    return nested(table, loop, lambda table, i: lax.dynamic_slice(table, (i,), (1,))[0], put)


TABLE = [5, 2, 7, 1, 8, 3, 6, 4]


def with_options(options: dict[str, Any]) -> list[int]:
    # A function of its own: JAX would give back what the options before compiled.
    return jax.jit(lambda table: in_jax(table), compiler_options=options)(jnp.array(TABLE, jnp.int32)).tolist()


def test_loops_in_loops_are_right_with_their_options():
    assert with_options({}) == with_options(dict(compiler.NESTED_OPTIONS)) == in_python(TABLE)


@newest
def test_loops_in_loops_are_still_wrong_under_region_analysis():
    assert with_options(dict(compiler.OPTIONS)) != in_python(TABLE), (
        "XLA is right about loops in loops under region analysis now. If Mario's engine is too (run tests/envs/mario "
        "and tests/experiments/mario_fidelity with OPTIONS in place of NESTED_OPTIONS), then NESTED_OPTIONS, has_loops "
        "and the trap in CONTRIBUTING.md can go as soon as no older version is supported."
    )


def contracted(zero_of: Callable[[jax.Array], jax.Array]) -> int:
    """Of a thousand ``a * b + c``, how many are not what two roundings give."""
    a, b, c = np.random.default_rng(0).normal(size=(3, 1000)).astype(np.float32)

    @jax.jit
    def summed(a: jax.Array, b: jax.Array, c: jax.Array, word: jax.Array) -> jax.Array:
        return exact_product(a, b, zero_of(word)) + c

    return int((np.asarray(summed(a, b, c, jnp.uint32(12345))) != a * b + c).sum())


def test_products_with_a_zero_made_of_data_are_rounded():
    assert contracted(opaque_zero) == 0


@newest
def test_a_zero_made_of_a_constant_is_still_folded():
    assert contracted(lambda word: opaque_zero(jnp.uint32(12345))) > 0, (
        "XLA does not contract products whose opaque_zero is a constant any more: see whether it contracts any "
        "(hrljax/core/numerics.py), and take the trap out of CONTRIBUTING.md."
    )


# Slow writes


class Clock:
    """A clock that only what is timed moves."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def taking(self, *seconds: float) -> Callable[[], None]:
        """A program whose calls take these times, the last one for ever."""
        times = list(seconds)

        def run() -> None:
            self.now += times.pop(0) if len(times) > 1 else times[0]

        return run


TURNS = compiler._TURNS


def test_a_turn_is_timed_without_the_first_call():
    clock = Clock()
    cost = compiler._timed(clock.taking(99, TURNS * 2.0), clock.taking(99, TURNS * 3.0), clock)
    assert cost == (2.0, 3.0)
    assert not cost.grows


def test_a_busy_machine_is_no_slow_compiler():
    clock = Clock()
    cost = compiler._timed(clock.taking(TURNS * 1.0), clock.taking(0, TURNS * 900.0, TURNS * 500.0, TURNS * 2.0), clock)
    assert cost == (1.0, 2.0)
    assert not cost.grows


@pytest.fixture
def copying(monkeypatch: pytest.MonkeyPatch) -> Iterator[Clock]:
    """A compiler whose loops take as long as their tables are large."""
    clock = Clock()
    monkeypatch.setattr(compiler, "_writing", lambda size: clock.taking(size * 1e-9 * TURNS))
    monkeypatch.setattr(compiler._timed, "__defaults__", (clock,))
    for cached in (compiler.native_loops_available, compiler.write_cost):
        cached.cache_clear()
    yield clock
    monkeypatch.undo()
    for cached in (compiler.native_loops_available, compiler.write_cost):
        cached.cache_clear()


def test_a_compiler_that_copies_tables_is_told_of_once(copying: Clock):
    with pytest.warns(
        RuntimeWarning, match=r"runs will be slow: .* 1024 ns .* 4 KiB and 262144 ns .* 1 MiB, so .*#40101"
    ):
        assert compiler.native_loops_available()
    assert compiler.native_loops_available()  # a second warning would be an error
    assert compiler.write_cost().grows
    spent = copying.now
    compiler.write_cost()
    assert copying.now == spent


@pytest.mark.parametrize("size", compiler._TABLE_SIZES)
def test_the_loops_that_are_timed_write_all_over_their_table(size: int):
    places = (np.arange(TURNS, dtype=np.uint32) * np.uint32(0x9E3779B9)) >> np.uint32(32 - np.log2(size))
    result: Any = compiler._writing(size)()
    np.testing.assert_array_equal(result, np.bincount(places, minlength=size))


def test_nothing_is_timed_at_import():
    """Tests of the import alone cannot see it: what is cached has been asked for by other tests."""
    program = "import hrljax; from hrljax.engine import compiler; print(compiler.write_cost.cache_info().currsize)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0"]


@pytest.mark.slow
def test_a_program_that_jax_keeps_gives_the_same_bits_to_the_next_process(tmp_path: Path):
    program = """
import jax

import hrljax as hrl

read = []
jax.monitoring.register_event_listener(lambda event, **_: read.append(event == "/jax/compilation_cache/cache_hits"))
env = hrl.make("Bus")
learner = hrl.SharedHORDQ(env.hierarchy(), hrl.ModelRoot(), initial_value=-25.0)
curves = hrl.sweep(env, learner, seeds=2, num_episodes=50, cores=1, progress=False)
print(curves["return"].values.tobytes().hex(), sum(read))
"""
    kept = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    outputs = [
        subprocess.run([sys.executable, "-c", program], env=kept, check=True, capture_output=True, text=True).stdout
        for _ in range(2)
    ]
    (first, _), (second, num_read) = map(str.split, outputs)
    assert first == second
    assert int(num_read) > 0
