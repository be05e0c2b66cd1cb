"""The linear root: bit for bit plain Python under HORDQ and shared HORDQ."""

import math
from typing import Any

import jax
import numpy as np
import pytest

import hrljax
from hrljax.learners.features import Features
from hrljax.learners.roots.linear import LinearRoot
from tests.learners.python_levels import Decomposed, PythonEnv, train_in_python
from tests.learners.python_shared import Shared
from tests.learners.test_levels_against_python import DOMAINS
from tests.learners.test_linear_dyna import PlainModel
from tests.words import KEY

F = np.float32
EPISODES = 40


def features(states: int, size: int, active: int) -> Features:
    generator = np.random.default_rng(8)
    index = np.stack([generator.permutation(size)[:active] for _ in range(states)]).astype(np.int32)
    return Features(index, np.full(index.shape, active**-0.5), size)


class PlainRoot:
    """Linear Dyna over the names of subtasks."""

    def __init__(self, root: LinearRoot, features: Features, names: list[str], active: dict[str, np.ndarray]):
        self.root, self.names, self.epsilon = root, names, F(0)
        has = features.dense() != 0
        allowed = np.stack([has[active[name]].any(0) for name in names])
        self.model = PlainModel(features, root.unknown_value, allowed)

    def choose(self, state: int, invocable: list[str], word: int, is_first: bool) -> str:
        self.earned, self.weight = F(0), F(1)
        values = self.model.action_values(state)
        best = max(invocable, key=lambda name: values[self.names.index(name)])
        return invocable[word % len(invocable)] if word < math.ceil(float(self.epsilon) * 2**24) else best

    def see(self, reward: F, discount: F) -> None:
        self.earned, self.weight = self.earned + self.weight * reward, self.weight * discount

    def observe(self, state: int, task: str, after: int, weight: F, terminated: bool) -> None:
        size, model_size = F(self.root.step_size), F(self.root.model_step_size)
        self.model.learn(state, self.names.index(task), self.earned, after, weight, size, model_size)
        for _ in range(self.root.planning_steps):
            self.model.sweep(size)

    def plan(self, episode: int) -> None: ...


def seeing(base: type[Any]) -> type[Any]:
    """A program that tells its root what every step earned."""

    class Seeing(base):
        def learn(self, state: int, reward: F, after: int, terminated: bool, words: list[int]) -> None:
            self.root_policy.see(reward, F(self.learner.discount))
            super().learn(state, reward, after, terminated, words)

    return Seeing


CASES = {
    "HORDQ": ("grid under a random root", hrljax.HORDQ, {"pseudo_reward": 4.0}),
    "shared": ("completed grid under a random root", hrljax.SharedHORDQ, {"pseudo_reward": 4.0, "taught": "active"}),
}


@pytest.mark.parametrize("case", CASES)
def test_a_run_gives_the_numbers_of_plain_python(case: str):
    where, kind, options = CASES[case]
    domain = DOMAINS[where]
    over = features(24, 7, 3)
    root = LinearRoot(over, 0.3, 0.4, -6.0, 2)
    learner = kind(domain.hierarchy, root, step_size=0.5, epsilon=0.25, discount=0.93, initial_value=-10.0, **options)
    run = jax.jit(lambda key: hrljax.train(domain.env, learner, key, EPISODES, params=domain.params, bin_size=1))(KEY)
    names = domain.tasks.children["Root"]
    plain = PlainRoot(root, over, names, domain.tasks.active)
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
    learned, model, n = run.learned.root, plain.model, over.size
    np.testing.assert_array_equal(learned.theta, model.theta)
    np.testing.assert_array_equal(learned.priority, model.waits)
    np.testing.assert_array_equal(np.asarray(learned.follows).reshape(n, n, -1), model.follows.transpose(2, 1, 0))
    np.testing.assert_array_equal(np.asarray(learned.earned).reshape(n, -1), model.earned.T)
    assert len(np.unique(model.follows)) > 50
