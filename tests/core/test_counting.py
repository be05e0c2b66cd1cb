"""Counts beyond 32 bits and sums beyond 24, against Python's integers and fractions."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hrljax
from hrljax.core.counting import Count, Total, count, one_more, total
from hrljax.envs.table import Table, TableEnvironment
from hrljax.solvers.model import Model
from hrljax.sweeps.learned import Learned

LARGE = st.integers(0, 2**60)
plus, minus = jax.jit(Count.plus), jax.jit(Count.minus)


def number(one: Count) -> int:
    return int(one.low) + (int(one.high) << 32)


@settings(deadline=None, max_examples=50)
@given(LARGE, st.integers(0, 2**32 - 1))
def test_a_count_carries(start: int, more: int):
    after = plus(count(start), jnp.uint32(more))
    assert number(after) == start + more
    assert number(minus(after, count(start))) == more
    assert float(after.as_float()) == pytest.approx(start + more, rel=2e-7)


@pytest.mark.parametrize("left", [1, 7, 8, 9, 2**31, 2**32])
def test_a_count_has_room_until_its_low_half_is_full(left: int):
    assert int(count(5 * 2**32 - left).room(8)) == min(left, 8)


@settings(deadline=None, max_examples=20)
@given(st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=50))
def test_a_total_loses_nothing(numbers: list[float]):
    """Compiled as a loop, where a compiler could simplify what only rounding makes different from zero."""
    padded = jnp.zeros(50, jnp.float32).at[: len(numbers)].set(jnp.asarray(numbers, jnp.float32))
    exact = sum(map(Fraction, padded.tolist()))
    summed = added_up(padded)
    size = max(1.0, float(sum(abs(Fraction(x)) for x in padded.tolist())))
    assert abs(Fraction(float(summed.value)) + Fraction(float(summed.lost)) - exact) <= Fraction(size) / 2**44


@jax.jit
def added_up(numbers: jax.Array) -> Total:
    return jax.lax.scan(lambda now, number: (now.plus(number), None), total(), numbers)[0]


def test_a_counter_of_places_goes_round_for_ever():
    step, places = jax.jit(one_more, static_argnums=1), 7
    now = jnp.int32(2**30 - 3)
    for i in range(20):
        assert int(now) % places == (2**30 - 3 + i) % places
        assert 2**30 - 10 < int(now) < 2**31
        now = step(now, places, jnp.bool_(True))
    assert int(step(now, places, jnp.bool_(False))) == int(now)


def one_state(reward: float, ends: bool, max_steps: int) -> TableEnvironment:
    """One state, one action."""
    shape = (1, 1, 1)
    model = Model(
        next_state=np.zeros(shape, np.int32),
        probability=np.ones(shape),
        reward=np.full(shape, reward, np.float32),
        terminated=np.full(shape, ends),
    )
    return TableEnvironment(Table(model, np.ones(1)), name="one state", max_steps=max_steps)


@pytest.mark.parametrize("mapping", ["native", "vmap"])
def test_the_mean_of_many_episodes_is_right(mapping: str):
    """A plain float32 sum of 400,000 times -0.1 is 0.9 % off."""
    count = 400_000 if mapping == "native" else 40_000
    run = hrljax.sweep(
        one_state(-0.1, True, 5), hrljax.QLearning(), seeds=1, num_episodes=count, bin_size=count, mapping=mapping,
        progress=False,
    )  # fmt: skip
    np.testing.assert_allclose(run["return"], np.float32(-0.1), rtol=1e-6)
    assert (int(run["steps"][0]), float(run["length"].squeeze())) == (count, 1)


def test_the_return_of_a_long_episode_is_right():
    """A plain float32 sum stops at -16777216."""
    steps = 40_000_000
    run = hrljax.sweep(one_state(-1.0, False, steps), hrljax.QLearning(), seeds=1, num_episodes=1, progress=False)
    assert float(run["return"].squeeze()) == -steps == -float(run["length"].squeeze())
    assert int(run["truncated"].squeeze()) == 1


@pytest.mark.parametrize("before", [2**31 - 20, 2**32 - 20, 5 * 2**32 - 20])
@pytest.mark.parametrize("mapping", ["native", "vmap"])
def test_steps_go_on_beyond_31_and_32_bits(before: int, mapping: str):
    env, learner = hrljax.make("Maze"), hrljax.QLearning(initial_value=-5.0)
    shapes = jax.eval_shape(lambda: learner.init(env, learner.prepare(env)).tables)
    start = Learned(env, learner, np.zeros(shapes.shape, np.float32), episodes=10, steps=before)
    run = hrljax.sweep(env, learner, seeds=2, num_episodes=5, bin_size=1, start=start, mapping=mapping, progress=False)
    taken = run["length"].sum("episode").values
    assert (taken > 20).all()
    np.testing.assert_array_equal(run["steps"], before + taken)
