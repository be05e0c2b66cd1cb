"""What came after steps, against plain Python."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.learners.relational.aftermath import REACH, Aftermath, after_step, nothing_came, worth_of

ROWS = 6
DECAY = 0.5


class PythonAftermath:
    """The worth of every row from whole episodes."""

    def __init__(self) -> None:
        self.worth: dict[int, float] = {}

    def learn(self, rows: list[int], last_reward: float) -> None:
        """Row by row, in the order in which a step leaves the reach of an end or an end comes."""
        gone, near = rows[:-REACH], rows[-REACH:]
        for row in gone:
            self.worth[row] = 0.0
        loss = min(0.0, last_reward)
        for row in reversed(near):
            self.worth[row] = max(self.worth.get(row, -np.inf), loss)
            loss *= DECAY


step = jax.jit(lambda known, row, reward, ended, learns: after_step(known, row, reward, ended, DECAY, learns))


def learned(known: Aftermath, rows: list[int], last_reward: float) -> Aftermath:
    for number, row in enumerate(rows):
        ended = number == len(rows) - 1
        reward = jnp.float32(last_reward if ended else 1.0)
        before = np.asarray(known.worth)
        known, has_changed = step(known, jnp.int32(row), reward, jnp.bool_(ended), jnp.bool_(True))
        assert bool(has_changed) == bool((np.asarray(known.worth)[:-1] != before[:-1]).any())
        waits, _ = step(known, jnp.int32(0), jnp.float32(-9), jnp.bool_(True), jnp.bool_(False))
        np.testing.assert_array_equal(worth_of(waits), worth_of(known))
        np.testing.assert_array_equal(waits.path, known.path)
        assert int(waits.steps) == int(known.steps)
    return known


episodes = st.tuples(st.lists(st.integers(0, ROWS - 1), min_size=1, max_size=24), st.sampled_from([-50.0, -3.0, 100.0]))


@settings(max_examples=25, deadline=None)
@given(st.lists(episodes, min_size=1, max_size=3))
def test_worths_are_those_of_plain_python(walks: list[tuple[list[int], float]]):
    known, python = nothing_came(ROWS), PythonAftermath()
    for rows, last_reward in walks:
        known = learned(known, rows, last_reward)
        python.learn(rows, last_reward)
        assert int(known.steps) == 0
    np.testing.assert_array_equal(worth_of(known), [python.worth.get(row, 0.0) for row in range(ROWS)])


def test_by_hand():
    """A death counts half a step earlier; what was survived once is not held against a row."""
    known = learned(nothing_came(ROWS), [0, 1, 2], -40.0)
    np.testing.assert_array_equal(worth_of(known), [-10, -20, -40, 0, 0, 0])
    known = learned(known, [0, 3, 4], -8.0)
    np.testing.assert_array_equal(worth_of(known), [-2, -20, -40, -4, -8, 0])
    known = learned(known, [1, 5], 100.0)
    np.testing.assert_array_equal(worth_of(known), [-2, 0, -40, -4, -8, 0])
