"""Random problems for any test: decision processes with task hierarchies of several levels, also as environments.

`random_problem` is for many problems from one generator, `problems` for hypothesis. Probabilities are
multiples of 1/16, so that `ProblemEnvironment` has the very model that the solvers get.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium
import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st
from jax import Array

from hrljax.core.random import uniform_cuts, uniform_index
from hrljax.envs.base import TabularEnvironment
from hrljax.hierarchy.definition import Hierarchy, Predicate, Subtask
from hrljax.solvers.model import Model

SHARES = 16
ENDED = -1


class Problem(NamedTuple):
    """A hierarchy on a model; `active` and `goal` are also what the hierarchy's predicates say."""

    hierarchy: Hierarchy
    active: np.ndarray  # [tasks, S] bool
    goal: np.ndarray  # [tasks, S] float32
    outcomes: np.ndarray  # [S, A, SHARES] int32: equally likely next states, or ENDED
    reward: np.ndarray  # [S, A] float32
    discount: float

    @property
    def model(self) -> Model:
        ended = self.outcomes == ENDED
        reward = np.broadcast_to(self.reward[..., None], ended.shape)
        return Model.merged(np.where(ended, 0, self.outcomes), reward, ended, np.full(SHARES, 1 / SHARES))

    @property
    def initial(self) -> np.ndarray:
        size = len(self.outcomes)
        return np.full(size, 1 / size)

    def optimal_q(self) -> np.ndarray:
        """``[S, A]`` float64: plain value iteration, then the exact values of the policy that it found."""
        reward, states = self.reward.astype(np.float64), np.arange(len(self.outcomes))
        q, updated = np.full(reward.shape, np.inf), np.zeros(reward.shape)
        while np.abs(updated - q).max() > 1e-10:
            q, updated = updated, self._backup(reward, updated.max(-1))
        best = q.argmax(-1)
        chain = (self.outcomes[states, best][:, :, None] == states).mean(1)
        return self._backup(reward, np.linalg.solve(np.eye(len(states)) - self.discount * chain, reward[states, best]))

    def _backup(self, reward: np.ndarray, value: np.ndarray) -> np.ndarray:
        return reward + self.discount * np.append(value, 0.0)[self.outcomes].mean(-1)  # ENDED reads the last


class NumberState(NamedTuple):
    number: Array
    time: Array


class NoParams(NamedTuple):
    max_steps: int = 200


@dataclass(frozen=True, eq=False)
class ProblemEnvironment(TabularEnvironment[NumberState, NoParams]):
    """A problem to act in. Starts anywhere."""

    problem: Problem

    name = "Problem"
    num_words = 1
    num_initial_words = 1

    @property
    def action_names(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.problem.hierarchy.actions

    @property
    def default_params(self) -> NoParams:
        return NoParams()

    @property
    def num_states(self) -> int:
        return len(self.problem.outcomes)

    @property
    def observation_space(self) -> gymnasium.spaces.Discrete:
        return gymnasium.spaces.Discrete(self.num_states)

    def encode(self, state: NumberState) -> Array:
        return state.number

    def decode(self, index: Array) -> NumberState:
        return NumberState(jnp.asarray(index, jnp.int32), jnp.int32(0))

    def initial(self, words: tuple[Array, ...], params: NoParams) -> NumberState:
        return self.decode(uniform_index(words[0], jnp.int32(self.num_states)))

    def transition(
        self, state: NumberState, action: Array, words: tuple[Array, ...], params: NoParams
    ) -> tuple[NumberState, Array, Array, dict[str, Array]]:
        share = uniform_index(words[0], jnp.int32(SHARES))
        after = jnp.asarray(self.problem.outcomes, jnp.int32)[state.number, action, share]
        reward = jnp.asarray(self.problem.reward, jnp.float32)[state.number, action]
        return NumberState(jnp.maximum(after, 0), state.time + 1), reward, after == ENDED, {}

    def word_cuts(self, params: NoParams) -> tuple[tuple[float, ...], ...]:
        return (uniform_cuts(SHARES),)

    def initial_word_cuts(self, params: NoParams) -> tuple[tuple[float, ...], ...]:
        return (uniform_cuts(self.num_states),)

    def hierarchy(self) -> Hierarchy:
        return self.problem.hierarchy


def numbered(table: np.ndarray) -> Predicate:
    """A function of a state that reads a table over state numbers."""
    return lambda state: jnp.asarray(table)[state.number]


def hierarchy_on(
    actions: tuple[str, ...], children: dict[str, tuple[str, ...]], active: np.ndarray, goal: np.ndarray
) -> Hierarchy:
    """A hierarchy from children by subtask and ``[tasks, S]`` tables, in the same order."""
    return Hierarchy(
        actions,
        [
            Subtask(name, children[name], numbered(~active[i]), goal=numbered(goal[i]))
            for i, name in enumerate(children)
        ],
    )


def random_process(
    generator: np.random.Generator, num_states: int, num_actions: int, ending: float
) -> tuple[np.ndarray, np.ndarray]:
    """Outcomes ``[S, A, SHARES]`` and rewards ``[S, A]``; shares end the episode with probability `ending`,
    the last one always, unless `ending` is 0.
    """
    likely = generator.dirichlet(np.full(num_states, 0.4), (num_states, num_actions)).cumsum(-1)
    draws = generator.random((num_states, num_actions, SHARES))
    outcomes = np.minimum((draws[..., None] > likely[:, :, None]).sum(-1), num_states - 1).astype(np.int32)
    outcomes[generator.random(outcomes.shape) < ending] = ENDED
    outcomes[..., -1] = ENDED if ending else outcomes[..., -1]  # no policy goes on for ever
    reward = np.rint(generator.normal(scale=8, size=(num_states, num_actions))) / 8
    return outcomes, reward.astype(np.float32)


def random_problem(
    generator: np.random.Generator,
    levels: int = 2,
    num_states: int = 8,
    num_actions: int = 3,
    discount: float = 0.9,
    ending: float = 0.05,
    width: int = 3,
) -> Problem:
    """A random problem whose leaf cover is total, every action being accessible in every active state.

    The lowest of `levels` layers of subtasks has all actions, in random order. A subtask above it has
    some of the subtasks below, which may have several callers, and in half of the cases some actions
    of its own; it is active only where one of its subtasks is. Slots are in random order.
    """
    actions = tuple(f"a{i}" for i in range(num_actions))
    children: dict[str, tuple[str, ...]] = {}
    active: dict[str, np.ndarray] = {}

    def shuffled(names: list[str]) -> tuple[str, ...]:
        return tuple(names[i] for i in generator.permutation(len(names)))

    def some(names: list[str], least: int = 1) -> list[str]:
        return generator.choice(names, generator.integers(least, len(names) + 1), replace=False).tolist()

    def somewhere() -> np.ndarray:
        actual = generator.random(num_states) < generator.uniform(0.3, 0.9)
        actual[generator.integers(num_states)] = True
        return actual

    below: list[str] = []
    for layer in range(levels - 1):
        names = [f"T{layer}.{i}" for i in range(generator.integers(2, width + 1))]
        for name in names:
            called = some(below) if below else []
            some_actions = some(list(actions), 0) if called and generator.random() < 0.5 else []
            children[name] = shuffled(called + some_actions) if called else shuffled(list(actions))
            active[name] = somewhere() & np.any([active[c] for c in called], axis=0) if called else somewhere()
            if not active[name].any():
                active[name] = np.any([active[c] for c in called], axis=0)
        if not layer:  # together the leaves are active everywhere
            for state in np.flatnonzero(~np.any(list(active.values()), axis=0)):
                active[names[generator.integers(len(names))]][state] = True
        below += names
    called = [name for name in below if generator.random() < 0.6]
    called += [n for n in below if n not in called and not any(n in c for c in children.values())]
    for name in below:  # in the order of layers, the leaves first
        if not np.any([np.zeros(num_states), *(active[c] for c in called)], axis=0).all() and name not in called:
            called.append(name)
    children = {"Root": shuffled(called), **dict(reversed(children.items()))}
    active["Root"] = np.ones(num_states, np.bool_)
    table = np.stack([active[name] for name in children])
    goal = ((generator.random(table.shape) < 0.4) & ~table).astype(np.float32)
    outcomes, reward = random_process(generator, num_states, num_actions, ending)
    hierarchy = hierarchy_on(actions, children, table, goal)
    return Problem(hierarchy, table, goal, outcomes, reward, discount)


def problems(
    levels: Any = (2, 3), discounts: Any = (0.5, 0.9, 1.0), max_states: int = 8, ending: float = 0.1
) -> st.SearchStrategy[Problem]:
    """`random_problem` of small sizes; episodes end by themselves, so that discount 1 is allowed."""
    return st.builds(
        lambda seed, **sizes: random_problem(np.random.default_rng(seed), ending=ending, **sizes),
        seed=st.integers(0, 2**32 - 1),
        levels=st.sampled_from(levels),
        num_states=st.integers(2, max_states),
        num_actions=st.integers(2, 4),
        discount=st.sampled_from(discounts),
    )


def random_policy(generator: np.random.Generator, problem: Problem, deterministic: bool = False) -> np.ndarray:
    """``[tasks, S, K]`` probabilities of children that can be invoked, by their slots."""
    width = max(len(task.children) for task in problem.hierarchy.subtasks)
    policy = np.zeros((*problem.active.shape, width))
    for number, task in enumerate(problem.hierarchy.subtasks):
        for slot, child in enumerate(task.children):
            primitive = problem.hierarchy.is_primitive(child)
            open_to = True if primitive else problem.active[problem.hierarchy.index(child)]
            policy[number, :, slot] = (problem.active[number] & open_to) * generator.exponential(
                size=problem.active.shape[1]
            )
    if deterministic:
        policy = (policy == policy.max(-1, keepdims=True)) & (policy > 0)
    return policy / np.maximum(policy.sum(-1, keepdims=True), 1e-300)
