"""Update rules against tables computed by hand, and choices among a few values."""

import re
from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax

from hrljax.core.choices import epsilon_greedy, greedy, greedy_of, pick
from hrljax.core.random import WORD_RANGE
from hrljax.engine import compiler
from hrljax.learners.hordq import Q, hordq_target
from hrljax.learners.updates import Move, increment, moved, td_target, traced_increment
from tests.contexts import learning

ZERO = np.uint32(0)
NEXT = Q(r=-2.0, c=-8.0, e=-16.0, p=4.0)
few_values = st.lists(st.floats(-100, 100, width=32, allow_subnormal=False), min_size=1, max_size=7)


def scalars(values: list[float]) -> list[jax.Array]:
    return [jnp.float32(v) for v in values]


@cache
def target(discount: float) -> Callable[..., Q]:
    """HORDQ's target with a discount that the compiler knows."""

    @jax.jit
    def of(reward, exited, pseudo_reward, q_next):
        return hordq_target(reward, learning().discounted(jnp.float32(discount)), exited, pseudo_reward, q_next)

    return of


def targets(reward: float, discount: float, exited: bool, pseudo_reward: float, q_next: Q = NEXT) -> dict:
    numbers = jnp.float32(reward), jnp.bool_(exited), jnp.float32(pseudo_reward), Q(*scalars(list(q_next)))
    q = target(discount)(*numbers)
    assert all(part.dtype == jnp.float32 for part in q)
    return {name: float(part) for name, part in q._asdict().items()}


@pytest.mark.parametrize(
    ("old", "target", "step_size", "live", "new"),
    [(1.0, 3.0, 0.5, True, 2.0), (1.0, 3.0, 0.5, False, 1.0), (-4.0, 0.0, 1.0, True, 0.0), (2.0, 2.0, 0.25, True, 2.0)],
)
def test_increment_moves_a_live_value_by_its_step_size(old, target, step_size, live, new):
    args = jnp.float32(old), jnp.float32(target), jnp.float32(step_size), jnp.bool_(live), ZERO
    assert increment(*args) == new


@pytest.mark.parametrize(
    ("old", "change", "trace", "live", "new"),
    [(1.0, 3.0, 0.5, True, 2.5), (1.0, 3.0, 0.5, False, 1.0), (-4.0, 4.0, 1.0, True, 0.0), (2.0, 8.0, 0.0, True, 2.0)],
)
def test_a_trace_shares_in_a_change(old, change, trace, live, new):
    args = jnp.float32(old), jnp.float32(change), jnp.float32(trace), jnp.bool_(live), ZERO
    assert traced_increment(*args) == new


def test_increment_of_a_row_takes_scalars_or_rows():
    old, target = jnp.array([0.0, 1.0, 2.0, 3.0]), jnp.array([8.0, 8.0, 8.0, 8.0])
    np.testing.assert_array_equal(increment(old, target, jnp.float32(0.5), jnp.bool_(True), ZERO), [4, 4.5, 5, 5.5])
    live = jnp.array([True, False, True, False])
    np.testing.assert_array_equal(increment(old, target, jnp.float32(0.5), live, ZERO), [4, 1, 5, 3])
    step_sizes = jnp.array([0.0, 0.25, 0.5, 1.0])
    np.testing.assert_array_equal(increment(old, target, step_sizes, jnp.bool_(True), ZERO), [0, 2.75, 5, 8])


@pytest.mark.parametrize("options", [compiler.OPTIONS, compiler.NESTED_OPTIONS], ids=["flat", "nested"])
def test_rows_are_moved_in_place(options: dict[str, Any]):
    """Both are read before either is written; of one place the first target counts, and no turn copies the table."""

    def steps(table: jax.Array, alike: jax.Array) -> jax.Array:
        def step(i: jax.Array, table: jax.Array) -> jax.Array:
            first, second = i, lax.select(alike, i, 49 - i)
            moves = [Move(first, jnp.full(1, 8.0), True), Move(second, jnp.full(1, -8.0), i < 10)]
            return moved(table, moves, jnp.float32(0.5), learning())

        return lax.fori_loop(jnp.int32(0), jnp.int32(20), step, table)

    table = jnp.ones(50)
    compiled = jax.jit(steps, donate_argnums=0, compiler_options=options).lower(table, jnp.bool_(False)).compile()
    assert not re.findall(r"f32\[50\]\S* copy\(", compiled.as_text() or "")
    assert compiled(table, jnp.bool_(False)).tolist() == [4.5] * 20 + [1.0] * 20 + [-3.5] * 10
    assert compiled(jnp.ones(50), jnp.bool_(True)).tolist() == [4.5] * 20 + [1.0] * 30


@pytest.mark.parametrize(("discount", "target"), [(1, -21), (0.5, -11), (0, -1)])
def test_td_target_is_the_reward_and_the_discounted_value(discount: float, target: float):
    for as_dtype in (np.float32, jnp.float32):
        gamma = learning().discounted(as_dtype(discount))
        assert td_target(jnp.float32(-1), gamma, jnp.float32(-20)) == target


def test_hordq_bootstraps_part_by_part_while_the_subtask_goes_on():
    assert targets(-1, 1.0, False, 5.0) == {"r": -1, "c": -10, "e": -16, "p": 4}
    assert targets(-1, 0.5, False, 5.0) == {"r": -1, "c": -5, "e": -8, "p": 2}


def test_hordq_bootstraps_the_exit_on_the_whole_next_value_when_the_subtask_has_ended():
    assert targets(-1, 1.0, True, 5.0) == {"r": -1, "c": 0, "e": -26, "p": 5}
    assert targets(-1, 0.5, True, 5.0) == {"r": -1, "c": 0, "e": -13, "p": 5}


def test_hordq_leaves_nothing_after_the_end_of_the_episode():
    after_the_end = Q(0.0, 0.0, 0.0, 0.0)
    assert targets(-51, 1.0, True, 0.0, after_the_end) == {"r": -51, "c": 0, "e": 0, "p": 0}
    assert targets(-51, 1.0, False, 5.0, after_the_end) == {"r": -51, "c": 0, "e": 0, "p": 0}


number = st.floats(-64, 64, width=16).map(lambda x: round(x * 4) / 4)


@given(reward=number, discount=st.sampled_from([0.25, 0.5, 1.0]), exited=st.booleans(), parts=st.tuples(*[number] * 4))
@settings(deadline=None, max_examples=50)
def test_the_real_parts_of_hordq_sum_to_the_flat_target_whatever_the_pseudo_reward(reward, discount, exited, parts):
    with_pseudo = targets(reward, discount, exited, 60.0, Q(*parts))
    without = targets(reward, discount, exited, 0.0, Q(*parts[:3], 0.0))
    real = ("r", "c", "e")
    assert [with_pseudo[name] for name in real] == [without[name] for name in real]
    assert sum(without[name] for name in real) == reward + discount * sum(parts[:3])


def test_parts_refuse_to_be_joined_like_tuples():
    with pytest.raises(TypeError):
        Q(*scalars([1, 2, 3, 4])) + Q(*scalars([1, 2, 3, 4]))


@pytest.mark.parametrize("count", range(1, 8))
def test_greedy_ties_go_to_the_first(count: int):
    index, value = greedy(scalars([2.0] * count))
    assert (index, value) == (0, 2)
    assert index.dtype == jnp.int32
    for best in range(count):
        values = [1.0] * best + [3.0] * (count - best)
        assert greedy(scalars(values)) == (best, 3)


@given(values=few_values | st.lists(st.sampled_from([-1.0, 0.0, 1.0]), min_size=1, max_size=7))
@settings(deadline=None, max_examples=150)
def test_greedy_is_the_first_argmax(values: list[float]):
    index, value = greedy(scalars(values))
    assert (int(index), float(value)) == (np.argmax(np.float32(values)), max(np.float32(values)))
    belongings = [(jnp.int32(10 + i), jnp.float32(-i)) for i in range(len(values))]
    again, (number, other) = greedy_of(scalars(values), belongings)
    assert (int(again), int(number), int(other)) == (int(index), 10 + int(index), -int(index))


@given(values=few_values)
@settings(deadline=None, max_examples=30)
def test_pick_reads_by_index(values: list[float]):
    assert [float(pick(scalars(values), jnp.int32(i))) for i in range(len(values))] == values


WORDS = np.arange(0, WORD_RANGE, 997, dtype=np.uint32)


def choices(num_actions: int, epsilon: float) -> np.ndarray:
    """What is chosen on many words where the greedy action is 1."""
    choose = jax.vmap(lambda word: epsilon_greedy(jnp.int32(1), num_actions, word, jnp.float32(epsilon)))
    chosen = np.asarray(choose(jnp.asarray(WORDS)))
    assert chosen.dtype == np.int32
    return chosen


def test_epsilon_zero_is_greedy():
    assert set(choices(4, 0.0).tolist()) == {1}


@pytest.mark.parametrize("num_actions", [2, 3, 6])
def test_epsilon_one_is_uniform(num_actions: int):
    shares = np.bincount(choices(num_actions, 1.0), minlength=num_actions) / len(WORDS)
    np.testing.assert_allclose(shares, 1 / num_actions, atol=0.01)


def test_epsilon_is_shared_equally_between_all_actions():
    shares = np.bincount(choices(4, 0.2), minlength=4) / len(WORDS)
    np.testing.assert_allclose(shares, [0.05, 0.85, 0.05, 0.05], atol=0.01)
