"""Random decision processes with random hierarchies over regions of their states."""

from functools import cache

import jax.numpy as jnp
import numpy as np

from hrljax.envs.table import Table, TableEnvironment, TableState
from hrljax.hierarchy.definition import Hierarchy, Predicate, Subtask
from hrljax.solvers.model import Model

_ACTIONS = ("a", "b", "c", "d")
_OUTCOMES = 3
_ENDING = 0.002
"""Probability that a step ends the episode, wherever it is, so that every policy ends."""


@cache
def random_task(number: int) -> tuple[TableEnvironment, Hierarchy]:
    """The process of a number, and a hierarchy with a total leaf cover over its regions.

    States lie in 3 to 6 regions; actions stay in one for the most part. A step costs 1, in a few states
    with some action up to 20; a goal in the last region ends the episode. The root's subtasks each head
    for one region, from all others or from some; half of the hierarchies let a subtask end as soon as it
    leaves the region in which it was invoked, as the Bus domain's do.
    """
    generator = np.random.default_rng(number)
    num_regions = int(generator.integers(3, 7))
    num_states = 20 * num_regions
    region = np.arange(num_states) % num_regions
    model = _process(generator, region)
    initial = (region == 0) / np.sum(region == 0)
    table = Table(model, initial.astype(np.float64))
    env = TableEnvironment(table, name=f"Random {number}", max_steps=300, action_names=_ACTIONS)
    reachable = generator.random((num_regions, num_regions)) < 0.7  # from a region to a region
    reachable[np.arange(num_regions), (np.arange(num_regions) + 1) % num_regions] = True
    np.fill_diagonal(reachable, False)
    ends_early = bool(generator.integers(2))

    def at(states: np.ndarray) -> Predicate:
        return lambda state: _of(states, state)

    subtasks = [Subtask("Root", tuple(f"Go({r})" for r in range(num_regions)), at(np.zeros(num_states, np.bool_)))]
    for target in range(num_regions):
        starts = reachable[:, target] if ends_early else np.arange(num_regions) != target
        children = tuple(_ACTIONS[i] for i in generator.permutation(len(_ACTIONS)))
        subtasks.append(Subtask(f"Go({target})", children, at(~starts[region]), goal=at(region == target)))
    return env, Hierarchy(_ACTIONS, subtasks)


def _of(states: np.ndarray, state: TableState):
    return jnp.asarray(states)[state.number]


def _process(generator: np.random.Generator, region: np.ndarray) -> Model:
    """Transitions that stay in a region with probability 0.8 or so."""
    num_states, num_actions = len(region), len(_ACTIONS)
    shape = (num_states, num_actions, _OUTCOMES)
    near = np.stack([generator.choice(np.flatnonzero(region == r), shape[1:]) for r in region])
    far = generator.integers(num_states, size=shape)
    after = np.where(generator.random(shape) < 0.8, near, far)
    chance = generator.dirichlet(np.full(_OUTCOMES, 0.5), shape[:2]) * (1 - _ENDING)
    cost = np.where(generator.random(shape[:2]) < 0.08, generator.uniform(1, 20, shape[:2]), 1.0)
    goal = num_states - 1
    terminated = np.concatenate([after == goal, np.ones((*shape[:2], 1), np.bool_)], -1)
    return Model(
        next_state=np.concatenate([after, np.zeros((*shape[:2], 1), after.dtype)], -1).astype(np.int32),
        probability=np.concatenate([chance, np.full((*shape[:2], 1), _ENDING)], -1),
        reward=np.broadcast_to(-cost[..., None], terminated.shape).astype(np.float32),
        terminated=terminated,
    )
