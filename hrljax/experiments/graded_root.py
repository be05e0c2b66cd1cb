"""Roots of graded quality, and what they are worth: the best advice, the worst, and all that lies between."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.numerics import take
from hrljax.core.random import threshold
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.base import Context
from hrljax.learners.hyperparameters import Hyperparameter, hyperparameter
from hrljax.learners.roots.base import ChildValue, Decision, MemorylessRoot, Question
from hrljax.solvers.hierarchical import recursively_optimal
from hrljax.solvers.joint import JointProcess, joint_process
from hrljax.solvers.joint_optima import optimise

_OBEYS = 100.0
"""A pseudo-reward, in mean absolute rewards of a step, with which a subtask looks at nothing but its goal."""


@dataclass(frozen=True, eq=False)
class Advice:
    """What a root may invoke; subtasks are counted without it."""

    allowed: np.ndarray  # [S, tasks] bool
    best: np.ndarray  # [S] int32
    worst: np.ndarray  # [S] int32


class Obedience(NamedTuple):
    """A hierarchy whose subtasks do nothing but what they are asked for."""

    process: JointProcess
    slots: np.ndarray  # [tasks, S] int: their policies
    values: np.ndarray  # [S, K] of the root's children, if the root is then the best; NaN where it cannot invoke them


@lru_cache(maxsize=16)
def obedience(hierarchy: Hierarchy, env: AnyTabularEnvironment) -> Obedience:
    """Exact values under subtasks that obey strictly, by dynamic programming without discounting."""
    tables, model = tabulate(hierarchy, env), env.model()
    typical = float(np.abs(model.reward[model.probability > 0]).mean())
    slots = recursively_optimal(hierarchy, tables, model, pseudo_reward=_OBEYS * typical)
    process = joint_process(hierarchy, tables.active, model)
    is_root = np.arange(process.contexts.size) == 0
    best = optimise(process, process.weights(slots), is_root)
    return Obedience(process, slots, process.spread(best.q)[0])


@dataclass(frozen=True)
class GradedRoot(MemorylessRoot[Advice]):
    """Advises well, badly or at random, as far as it is told to.

    With probability ``|quality|`` it invokes the subtask that is best (worst, if the quality is
    negative) for subtasks that obey strictly and a root that is the best afterwards; else any.

    Attributes:
        quality: from -1, an adversary, over 0, random, to 1, a planner with the exact model.
    """

    quality: Hyperparameter = hyperparameter(1.0, -1, 1)

    name = "graded"

    def prepare(self, hierarchy: Hierarchy, env: AnyTabularEnvironment) -> Advice:
        values = obedience(hierarchy, env).values
        allowed = ~np.isnan(values)
        tasks = np.array([hierarchy.index(child) - 1 for child in hierarchy.root.children], np.int32)
        best, worst = (np.where(allowed, sign * values, -np.inf).argmax(-1) for sign in (1, -1))
        by_task = np.zeros((len(values), len(hierarchy.subtasks) - 1), np.bool_)
        by_task[:, tasks] = allowed
        return Advice(by_task, tasks[best], tasks[worst])

    def begin(self, prepared: Advice, tables: tuple[()], asked: Question, context: Context) -> Decision[tuple[()]]:
        quality = jnp.asarray(self.quality, jnp.float32)
        best, worst = (take(jnp.asarray(choice), asked.state) for choice in (prepared.best, prepared.worst))
        num_tasks = prepared.allowed.shape[1]
        row = jnp.asarray(prepared.allowed)[asked.state]
        random = choices.nth_allowed([row[task] for task in range(num_tasks)], asked.word)
        is_random = asked.word >= threshold(jnp.abs(quality))
        return Decision(lax.select(is_random, random, lax.select(quality > 0, best, worst)), ())

    def probabilities(
        self, prepared: Advice, tables: tuple[()], child_value: ChildValue, state: Array, context: Context
    ) -> Array:
        extremes = (choice_probabilities(prepared, quality).astype(np.float32) for quality in (1.0, -1.0, 0.0))
        best, worst, random = (jnp.asarray(table)[state] for table in extremes)
        quality = jnp.asarray(self.quality, jnp.float32)
        weight = jnp.broadcast_to(jnp.abs(quality), random.shape)
        directed = lax.select(quality > 0, best, worst)
        return context.product(weight, directed) + context.product(1 - weight, random)


def choice_probabilities(advice: Advice, quality: float) -> np.ndarray:
    """``[S, tasks]``: how likely a `GradedRoot` invokes each subtask."""
    random = advice.allowed / np.maximum(advice.allowed.sum(-1, keepdims=True), 1)
    directed = np.eye(advice.allowed.shape[1])[advice.best if quality > 0 else advice.worst] * advice.allowed
    return abs(quality) * directed + (1 - abs(quality)) * random


def worth(hierarchy: Hierarchy, env: AnyTabularEnvironment, quality: float) -> float:
    """Expected return of an episode under a `GradedRoot` whose subtasks obey strictly, exactly."""
    of_subtasks = obedience(hierarchy, env)
    process = of_subtasks.process
    chances = choice_probabilities(GradedRoot(quality).prepare(hierarchy, env), quality)
    policy = np.zeros((len(hierarchy.subtasks), *of_subtasks.values.shape[:1], process.shape[2]))
    for task in range(1, len(hierarchy.subtasks)):
        states = np.flatnonzero(of_subtasks.slots[task] >= 0)
        policy[task, states, of_subtasks.slots[task, states]] = 1
    for slot, child in enumerate(hierarchy.root.children):
        policy[0, :, slot] = chances[:, hierarchy.index(child) - 1]
    none = np.zeros(process.contexts.size, np.bool_)
    value = process.spread_nodes(optimise(process, process.weights(policy), none).value)[0]
    initial = env.initial_distribution()
    return float(initial[initial > 0] @ value[initial > 0])
