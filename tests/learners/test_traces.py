"""SARSA(lambda) and Q(lambda): by hand, against plain Python and the textbook's tables, and in the limit."""

from collections import deque
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.learners.base import Context, LearnerState, Transition
from hrljax.learners.traces import QLambda, SARSALambda, TraceControl, TraceTables
from tests.learners.python_run import (
    PAIRS,
    assert_learns_only_when_live,
    assert_runs_as,
    assert_same_run,
    assert_same_under_every_mapping,
    choose,
)

F = np.float32


def two_state_episode(learner: Any, words: tuple[int, int] = (0, 0)) -> list[float]:
    """Action values (state 0, then 1; two actions) after (0, 0) -> 1, reward 4; (1, .) -> 0; (0, .) -> end, reward 8.

    The words decide on the second and third action.
    """

    @jax.jit
    def run() -> jax.Array:
        context = Context(jnp.int32(0), jnp.bool_(True), jnp.uint32(0))
        tables = TraceTables(jnp.zeros(4), jnp.full(learner._ring, -1, jnp.int32))
        state = LearnerState(tables, TraceControl(jnp.int32(0), jnp.int32(0)))
        for (here, reward, after), word in zip([(0, 4, 1), (1, 0, 0), (0, 8, 0)], (*words, 0), strict=True):
            numbers = jnp.int32(here), learner.action(state.control), jnp.float32(reward), jnp.int32(after)
            step = Transition(*numbers, jnp.bool_(reward == 8))
            state = learner.learn(2, state, step, (jnp.uint32(word),), context)
        return state.tables.values

    return np.asarray(run()).tolist()


HAND = {"step_size": 0.5, "trace_decay": 0.5, "epsilon": 0.0}


@pytest.mark.parametrize(
    ("options", "values"),
    [
        # TD errors 4, 2, 5.5; the first pair has traces 1; 1/2; 1 and 1/4 (or 1 alone).
        ({"trace": "accumulating"}, [5.9375, 0, 2.375, 0]),
        ({"trace": "replacing"}, [5.25, 0, 2.375, 0]),
        ({"trace": "accumulating", "trace_length": 3}, [5.9375, 0, 2.375, 0]),
        ({"trace": "accumulating", "trace_length": 2}, [5.25, 0, 2.375, 0]),
        ({"trace": "accumulating", "trace_cutoff": 0.5}, [5.25, 0, 2.375, 0]),
        # Without traces, TD errors 4, 2, 6.
        ({"trace": "accumulating", "trace_length": 1}, [5, 0, 1, 0]),
        ({"trace": "replacing", "trace_cutoff": 0.625}, [5, 0, 1, 0]),
    ],
    ids=str,
)
def test_an_episode_by_hand(options: dict[str, Any], values: list[float]):
    assert two_state_episode(SARSALambda(**HAND, **options)) == values
    assert two_state_episode(QLambda(**HAND, **options)) == values


def test_watkins_clears_the_traces_where_an_action_is_not_greedy():
    learner = QLambda(**{**HAND, "epsilon": 1.0}, trace="accumulating")
    assert two_state_episode(learner, words=(0, 0)) == [5.9375, 0, 2.375, 0]
    assert two_state_episode(learner, words=(0, 1)) == [2.5, 4, 1, 0]  # the last action is 1, worth less than 0
    assert two_state_episode(learner, words=(1, 0)) == [5.9375, 0, 0, 2.375]  # a tie is greedy


class Traced:
    """Both learners: replacing traces as a table of all pairs, accumulating ones as a list of visits."""

    def __init__(self, learner: Any):
        self.learner, self.on_policy = learner, isinstance(learner, SARSALambda)
        self.q = np.full(PAIRS, learner.initial_value, F)
        self.decay = F(learner.discount) * F(learner.trace_decay)
        self.textbook = self.q.astype(np.float64)  # with accumulating traces, and nothing dropped

    def begin(self, state: int, words: list[int]) -> int:
        self.clear()
        return choose(self.q, state, words[0], self.learner.epsilon)

    def clear(self) -> None:
        self.visits, self.table, self.age = deque(maxlen=self.learner.trace_length), np.zeros(PAIRS, F), np.zeros(PAIRS)
        self.exact = np.zeros(PAIRS)

    def learn(self, state: int, action: int, reward: F, after: int, terminated: bool, words: list[int]) -> int:
        pair, row = state * 4 + action, slice(after * 4, after * 4 + 4)
        next_action = choose(self.q, after, words[0], self.learner.epsilon)
        follows = after * 4 + (next_action if self.on_policy else int(np.argmax(self.q[row])))
        value = F(0) if terminated else self.q[follows]
        change = F(self.learner.step_size) * (reward + F(self.learner.discount) * value - self.q[pair])
        self.move_exactly(pair, float(reward), 0.0 if terminated else self.textbook[follows])
        if self.learner.trace == "accumulating":
            self.visits.appendleft(pair)
            trace = F(1)
            for visited in self.visits:
                if trace < F(self.learner.trace_cutoff):
                    break
                self.q[visited] += trace * change
                trace *= self.decay
        else:
            self.table[pair], self.age[pair] = 1, 0
            self.q += self.table * change
            self.table *= self.decay
            self.age += 1
            self.table[(self.table < F(self.learner.trace_cutoff)) | (self.age >= self.learner.trace_length)] = 0
        if not self.on_policy:
            next_action = choose(self.q, after, words[0], self.learner.epsilon)
            if self.q[after * 4 + next_action] < self.q[row].max():
                self.clear()
        return next_action

    def move_exactly(self, pair: int, reward: float, value: float) -> None:
        """Sutton and Barto (1998), Fig. 7.11, in float64."""
        self.exact[pair] += 1
        error = reward + self.learner.discount * value - self.textbook[pair]
        self.textbook += self.learner.step_size * error * self.exact
        self.exact *= self.learner.discount * self.learner.trace_decay


LEARNERS = {
    "replacing": SARSALambda(0.3, 0.125, 0.97, -3.0, 0.9, trace_cutoff=0.02),
    "replacing, short": SARSALambda(0.3, 0.125, 0.97, -3.0, 0.9, trace_length=5),
    "accumulating": SARSALambda(0.125, 0.125, 0.97, -3.0, 0.9, trace="accumulating", trace_cutoff=0.02),
    "accumulating, short": SARSALambda(0.125, 0.25, trace_decay=1.0, trace="accumulating", trace_length=11),
    "Q(lambda) replacing": QLambda(0.25, 0.125, 0.97, -25.0, 0.9),
    "Q(lambda) accumulating": QLambda(0.25, 0.125, 0.97, -25.0, 0.8, trace="accumulating", trace_length=9),
}


QUICK = {"replacing, short", "Q(lambda) accumulating"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in LEARNERS]
)
def test_a_run_gives_the_numbers_of_plain_python(name: str):
    assert_runs_as(Traced(LEARNERS[name]), LEARNERS[name])


def test_accumulating_traces_are_those_of_the_textbook():
    """Same steps, all pairs and all traces, another order of additions."""
    learner = SARSALambda(0.125, 0.125, 0.97, -3.0, 0.9, trace="accumulating", trace_cutoff=0.0)
    program = Traced(learner)
    assert_runs_as(program, learner)
    np.testing.assert_allclose(program.q, program.textbook, atol=1e-4)


@pytest.mark.parametrize("trace", [pytest.param("accumulating", marks=pytest.mark.slow), "replacing"])
def test_without_decay_they_are_the_learners_of_one_step(trace: str):
    numbers = {"step_size": 0.3, "epsilon": 0.2, "discount": 0.97, "initial_value": -20.0}
    assert_same_run(SARSALambda(**numbers, trace_decay=0.0, trace=trace), hrljax.SARSA(**numbers))
    assert_same_run(QLambda(**numbers, trace_decay=0.0, trace=trace), hrljax.QLearning(**numbers))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("learner", "axes"),
    [
        (SARSALambda(trace_length=12), {"trace_decay": [0.0, 0.9]}),
        (QLambda(trace="accumulating", trace_length=12, discount=0.97), {"trace_cutoff": [0.1, 0.5]}),
    ],
    ids=["SARSA(lambda)", "Q(lambda)"],
)
def test_a_seed_has_one_result_under_every_mapping(learner: Any, axes: dict[str, list[float]]):
    assert_same_under_every_mapping(learner, axes)


@pytest.mark.parametrize("learner", [SARSALambda(), QLambda(trace="accumulating")], ids=["SARSA(lambda)", "Q(lambda)"])
def test_a_step_that_is_not_live_changes_nothing(learner: Any):
    assert_learns_only_when_live(learner)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trace_decay": 1.5}, r"SARSALambda: trace_decay must be a finite number in \[0, 1\], got 1\.5"),
        ({"trace_cutoff": -0.5}, r"trace_cutoff must be a finite number in \[0, 1\], got -0\.5"),
        ({"trace_length": 0}, "SARSALambda: trace_length must be an integer from 1 to 16777216, got 0"),
        ({"trace_length": 2.0}, r"trace_length must be an integer from 1 to 16777216, got 2\.0"),
        ({"trace": "dutch"}, "SARSALambda: trace must be one of 'accumulating', 'replacing', got 'dutch'"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str):
    with pytest.raises((TypeError, ValueError), match=message):
        SARSALambda(**options)
