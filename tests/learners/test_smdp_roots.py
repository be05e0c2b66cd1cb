"""Roots that learn of subtasks as of actions: bit for bit plain Python under HORDQ and shared HORDQ."""

import math
from typing import Any

import jax
import numpy as np
import pytest

import hrljax
from hrljax.learners.features import Features
from hrljax.learners.roots.linear import LinearRoot
from hrljax.learners.roots.rldt import RLDTRoot
from tests.learners.python_levels import Decomposed, PythonEnv, train_in_python
from tests.learners.python_planner import Planner
from tests.learners.python_run import assert_same_under_every_mapping
from tests.learners.python_shared import Shared
from tests.learners.test_levels_against_python import DOMAINS
from tests.learners.test_linear_dyna import PlainModel
from tests.maps import SMALL
from tests.words import KEY

F = np.float32
EPISODES = 40


def features(states: int, size: int, active: int) -> Features:
    generator = np.random.default_rng(8)
    index = np.stack([generator.permutation(size)[:active] for _ in range(states)]).astype(np.int32)
    return Features(index, np.full(index.shape, active**-0.5), size)


class PlainRoot:
    """Invokes what is worth most by a model over the names of subtasks."""

    def __init__(self, root: Any, names: list[str]):
        self.root, self.names, self.epsilon = root, names, F(0)

    def choose(self, state: int, invocable: list[str], word: int, is_first: bool) -> str:
        self.earned, self.weight = F(0), F(1)
        values = self.values(state)
        best = max(invocable, key=lambda name: values[self.names.index(name)])
        return invocable[word % len(invocable)] if word < math.ceil(float(self.epsilon) * 2**24) else best

    def see(self, reward: F, discount: F) -> None:
        self.earned, self.weight = self.earned + self.weight * reward, self.weight * discount

    def plan(self, episode: int) -> None: ...

    def values(self, state: int) -> Any: ...


class PlainLinear(PlainRoot):
    """Linear Dyna."""

    def __init__(self, root: LinearRoot, names: list[str], domain: Any):
        super().__init__(root, names)
        has = root.features.dense() != 0
        allowed = np.stack([has[domain.tasks.active[name]].any(0) for name in names])
        self.model = PlainModel(root.features, root.unknown_value, allowed)

    def values(self, state: int) -> Any:
        return self.model.action_values(state)

    def observe(self, state: int, task: str, after: int, weight: F, terminated: bool) -> None:
        size, model_size = F(self.root.step_size), F(self.root.model_step_size)
        self.model.learn(state, self.names.index(task), self.earned, after, weight, size, model_size)
        for _ in range(self.root.planning_steps):
            self.model.sweep(size)

    def compare(self, learned: Any) -> None:
        model, n = self.model, len(self.model.theta)
        np.testing.assert_array_equal(learned.theta, model.theta)
        np.testing.assert_array_equal(learned.priority, model.waits)
        np.testing.assert_array_equal(np.asarray(learned.follows).reshape(n, n, -1), model.follows.transpose(2, 1, 0))
        np.testing.assert_array_equal(np.asarray(learned.earned).reshape(n, -1), model.earned.T)
        assert len(np.unique(model.follows)) > 50


class PlainTrees(PlainRoot):
    """RL-DT."""

    def __init__(self, root: RLDTRoot, names: list[str], domain: Any):
        super().__init__(root, names)
        invocable = np.stack([domain.tasks.active[name] for name in names], 1)
        self.planner = Planner(root, root.model_over(domain.env, invocable))

    def values(self, state: int) -> Any:
        return self.planner.worth(state)

    def observe(self, state: int, task: str, after: int, weight: F, terminated: bool) -> None:
        self.planner.see(state, self.names.index(task), self.earned, after, weight, terminated)

    def compare(self, learned: Any) -> None:
        planner = self.planner
        np.testing.assert_array_equal(learned.values, planner.q)
        np.testing.assert_array_equal(learned.exploring, planner.exploring)
        np.testing.assert_array_equal(learned.numbers.weights.values[: len(planner.weights)], planner.weights)
        assert planner.plans > 3
        assert planner.explored
        assert len(planner.weights) == len(planner.rewards) == self.root.max_rewards
        assert len(np.unique(planner.q)) > 20


def seeing(base: type[Any]) -> type[Any]:
    """A program that tells its root what every step earned."""

    class Seeing(base):
        def learn(self, state: int, reward: F, after: int, terminated: bool, words: list[int]) -> None:
            self.root_policy.see(reward, F(self.learner.discount))
            super().learn(state, reward, after, terminated, words)

    return Seeing


ROOTS = {
    "linear": (LinearRoot(features(24, 7, 3), 0.3, 0.4, -6.0, 2), PlainLinear),
    "RL-DT": (
        RLDTRoot(satisfying_value=-4.0, least_value=-30.0, refit_interval=12, max_rewards=4, max_nodes=15),
        PlainTrees,
    ),
}
CASES = {
    "HORDQ": ("grid under a random root", hrljax.HORDQ, {"pseudo_reward": 4.0}),
    "shared": ("completed grid under a random root", hrljax.SharedHORDQ, {"pseudo_reward": 4.0, "taught": "active"}),
}


@pytest.mark.parametrize(
    ("case", "which"),
    [
        pytest.param("shared", "linear", marks=pytest.mark.slow),
        pytest.param("HORDQ", "RL-DT", marks=pytest.mark.slow),
        pytest.param("HORDQ", "linear", marks=pytest.mark.slow),
        pytest.param("shared", "RL-DT", marks=pytest.mark.slow),
    ],
)
def test_a_run_gives_the_numbers_of_plain_python(case: str, which: str):
    where, kind, options = CASES[case]
    domain, (root, plain_root) = DOMAINS[where], ROOTS[which]
    learner = kind(domain.hierarchy, root, step_size=0.5, epsilon=0.25, discount=0.93, initial_value=-10.0, **options)
    run = jax.jit(lambda key: hrljax.train(domain.env, learner, key, EPISODES, params=domain.params, bin_size=1))(KEY)
    plain = plain_root(root, domain.tasks.children["Root"], domain)
    plain.epsilon = F(learner.epsilon)
    base = seeing(Shared if kind is hrljax.SharedHORDQ else Decomposed)
    program = (
        base(learner, domain.tasks, 4, plain) if kind is hrljax.SharedHORDQ else base(learner, domain.tasks, plain)
    )
    program.program = program
    walk = train_in_python(program, PythonEnv(domain.env, domain.params), EPISODES)
    assert int(run.steps) == walk.steps
    np.testing.assert_array_equal(run.metrics["return"], walk.episodes[:, 0].astype(F))
    program.compare(run.learned)
    plain.compare(run.learned.root)


@pytest.mark.slow
def test_trees_of_a_root_have_one_result_under_every_mapping():
    root = RLDTRoot(satisfying_value=-30.0, least_value=-50.0, refit_interval=20, max_nodes=31, max_rewards=8)
    learner = hrljax.SharedHORDQ(SMALL.hierarchy(), root, initial_value=-25.0)
    assert_same_under_every_mapping(learner, {"root.least_score": [1e-4, 0.2]})
