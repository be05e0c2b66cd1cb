"""R-MAX: against plain Python, against the optimum of its own model, and against that of the domain."""

from typing import Any

import numpy as np
import pytest

import hrljax
from hrljax import solvers
from hrljax.envs.bus.env import BusParams
from hrljax.learners.rmax import RMax, RMaxTables
from tests.learners.python_run import (
    PAIRS,
    assert_learns_only_when_live,
    assert_runs_as,
    assert_same_under_every_mapping,
    choose,
    settled,
    trained,
)
from tests.maps import SMALL

F = np.float32


class OptimisticModel:
    """Outcomes in a list for each pair, closed when the pair is known."""

    def __init__(self, learner: RMax):
        self.learner = learner
        self.q = np.full(PAIRS, learner.optimistic_value, F)
        self.outcomes: dict[int, list[tuple[F, int | None]]] = {}
        self.plans = self.settled = 0

    def begin(self, state: int, words: list[int]) -> int:
        return choose(self.q, state, words[0], self.learner.epsilon)

    def learn(self, state: int, action: int, reward: F, after: int, terminated: bool, words: list[int]) -> int:
        seen = self.outcomes.setdefault(state * 4 + action, [])
        if len(seen) < self.learner.known_after:
            seen.append((reward, None if terminated else after))
            if len(seen) == self.learner.known_after:
                self.plan()
        return choose(self.q, after, words[0], self.learner.epsilon)

    def plan(self) -> None:
        self.plans += 1
        share = F(1 / self.learner.known_after)

        def sweep(q: np.ndarray) -> np.ndarray:
            value, new = q.reshape(-1, 4).max(1), q.copy()
            for pair, seen in self.outcomes.items():
                if len(seen) == self.learner.known_after:
                    reward, follows = F(0), F(0)
                    for earned, after in seen:
                        reward, follows = reward + earned, follows + (F(0) if after is None else value[after])
                    new[pair] = reward * share + F(self.learner.discount) * (follows * share)
            return new

        self.q, is_settled = settled(self.learner, self.q, sweep)
        self.settled += is_settled


@pytest.mark.parametrize(
    "learner",
    [
        RMax(discount=0.97, planning_tolerance=0.03125, known_after=3, planning_sweeps=3),
        RMax(planning_tolerance=0.5, known_after=3, planning_sweeps=5),
        RMax(epsilon=0.125, optimistic_value=10.0, planning_tolerance=0.5, known_after=1, planning_sweeps=5),
    ],
    ids=str,
)
def test_a_run_gives_the_numbers_of_plain_python(learner: RMax):
    program = OptimisticModel(learner)
    assert_runs_as(program, learner)
    assert program.plans > 50
    assert 0 < program.settled < program.plans


CERTAIN = BusParams(slip_probability=0.0, road_change_probability=0.0, breakdown_probability=0.0, max_steps=60)


def optimum(params: BusParams) -> float:
    value = solvers.value_iteration(SMALL.model(params)).value
    return float(SMALL.initial_distribution(params) @ np.asarray(value, np.float64))


@pytest.mark.parametrize("optimistic_value", [0.0, 20.0])
def test_the_optimum_is_reached_where_one_visit_tells_all(optimistic_value: float):
    run = trained(RMax(known_after=1, optimistic_value=optimistic_value), CERTAIN, 150, evaluate_every=150)
    best = optimum(CERTAIN)
    assert float(run.greedy_return[-1]) == pytest.approx(best, abs=1e-3)
    assert np.asarray(run.metrics["return"])[-30:].mean() == pytest.approx(best, abs=1.0)  # the start varies


def test_the_values_are_the_optimal_ones_of_the_model_of_known_pairs():
    """Value iteration in float64, where every unknown pair ends the episode with the optimistic value."""
    learner = RMax(known_after=4, planning_tolerance=1e-4, optimistic_value=3.0, discount=0.9)
    learned: RMaxTables = trained(learner, episodes=60).learned
    known = np.asarray(learned.samples.seen) >= 4
    after = np.asarray(learned.samples.after).reshape(4, PAIRS)
    reward = np.asarray(learned.samples.reward, np.float64).reshape(4, PAIRS).mean(0)
    assert 100 < known.sum() < PAIRS
    assert np.asarray(learned.samples.seen).max() == 4
    q = np.full(PAIRS, 3.0)
    for _ in range(500):
        value = np.append(q.reshape(-1, 4).max(1), 0.0)
        q = np.where(known, reward + 0.9 * value[after].mean(0), 3.0)
    np.testing.assert_allclose(learned.values, q, atol=1e-3)


@pytest.mark.slow
def test_the_optimum_is_near_where_thirty_visits_tell_much():
    slippery = CERTAIN._replace(slip_probability=0.1, max_steps=200)
    options = {"seeds": 4, "num_episodes": 8000, "bin_size": 4000, "evaluate_every": 1, "progress": False}
    actual = hrljax.sweep(SMALL, RMax(known_after=30), params=slippery, **options)
    gap = optimum(slippery) - actual["greedy_return"].values
    assert gap.min() > -0.01
    assert gap[:, -1].mean() < 0.1
    assert gap[:, 0].mean() < 0.3


@pytest.mark.slow
def test_a_seed_has_one_result_under_every_mapping():
    learner = RMax(epsilon=0.5, known_after=2, planning_sweeps=20, discount=0.97)
    assert_same_under_every_mapping(learner, {"optimistic_value": [-8.0, -20.0]}, episodes=40)


def test_a_step_that_is_not_live_changes_nothing():
    assert_learns_only_when_live(RMax(known_after=2))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"known_after": 0}, "RMax: known_after must be an integer from 1 to 2147483647, got 0"),
        (
            {"planning_tolerance": -0.5},
            r"planning_tolerance must be a finite number in \[0, 3\.4e\+38\], got -0\.5",
        ),
        ({"planning_sweeps": 0}, "RMax: planning_sweeps must be an integer from 1 to 2147483647, got 0"),
        ({"planning_sweeps": True}, "RMax: planning_sweeps must be an integer from 1 to 2147483647, got True"),
        ({"optimistic_value": np.inf}, "RMax: optimistic_value must be a finite number in .*got inf"),
        ({"discount": 1.5}, r"RMax: discount must be a finite number in \[0, 1\], got 1\.5"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str):
    with pytest.raises((TypeError, ValueError), match=message):
        RMax(**options)
