"""Exact value of a fixed hierarchical policy, by dynamic programming over stacks of subtasks and states.

A flat policy is the case of one subtask that never ends.
"""

from functools import lru_cache
from typing import NamedTuple

import chex
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import Tracer

from hrljax.core.environment import Numbers
from hrljax.core.numerics import expectation
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.layout import StackLayout
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.learners.base import AnyLearner, outside_of_training


class _Chances(NamedTuple):
    next_state: np.ndarray  # [S * A, K] int32
    probability: np.ndarray  # [S * A, K] float32, 0 where the episode ends
    reward: np.ndarray  # [S * A] float32, expected
    initial: np.ndarray  # [S] float64
    num_actions: int


@lru_cache(maxsize=16)
def _chances(env: AnyTabularEnvironment, params: Numbers) -> _Chances:
    model = env.model(params)
    follows = np.where(model.terminated, 0.0, model.probability)
    reward = (model.probability * model.reward).sum(-1)
    width = model.next_state.shape[-1]
    return _Chances(
        model.next_state.reshape(-1, width),
        follows.reshape(-1, width).astype(np.float32),
        reward.ravel().astype(np.float32),
        env.initial_distribution(params),
        model.num_actions,
    )


class _Stacks:
    """All stacks of subtasks that a hierarchy allows, as numbers; the last number is that of an empty one."""

    def __init__(self, layout: StackLayout):
        self.layout = layout
        self.chains: list[tuple[int, ...]] = [(task,) for task in layout.levels[0]]
        for chain in self.chains:
            self.chains += [(*chain, child) for child in layout.children(chain[-1]).tasks if child >= 0]
        self.number = {chain: i for i, chain in enumerate(self.chains)}

    def left(self) -> np.ndarray:
        """``[stacks, S]`` int32: what is left of a stack in a state, after terminated subtasks have gone."""
        active = self.layout.active.copy()
        if not self.layout.offset:
            active[0] = True  # the root ends with the episode
        left = []
        for chain in self.chains:
            remains = np.full(self.layout.num_states, len(self.chains), np.int32)
            running = np.ones(self.layout.num_states, np.bool_)
            for length, task in enumerate(chain, start=1):
                running = running & active[task]
                remains = np.where(running, np.int32(self.number[chain[:length]]), remains)
            left.append(remains)
        return np.stack(left)

    def decided(self, slots: Array) -> tuple[Array, Array]:
        """``[stacks, S]`` int32 each: the stack and the action after the subtask on top of a stack decides."""
        stacks: dict[tuple[int, ...], tuple[Array, Array]] = {}
        for chain in reversed(self.chains):  # longer ones first
            children, slot = self.layout.children(chain[-1]), slots[chain[-1]]
            action = jnp.asarray(np.array(children.actions, np.int32))[slot]
            stack = jnp.full_like(action, self.number[chain])
            for k, child in enumerate(children.tasks):
                if child >= 0:
                    its_stack, its_action = stacks[(*chain, child)]
                    stack = lax.select(slot == k, its_stack, stack)
                    action = lax.select(slot == k, its_action, action)
            stacks[chain] = (stack, action)
        in_order = [stacks[chain] for chain in self.chains]
        return jnp.stack([stack for stack, _ in in_order]), jnp.stack([action for _, action in in_order])


def greedy_return(
    learner: AnyLearner,
    env: AnyTabularEnvironment,
    prepared: object,
    tables: chex.ArrayTree,
    params: Numbers,
    zero: Array,
    episode: Array | int,
) -> Array:
    """Expected return (float32 scalar) of an episode if the learner were greedy after learning from so many others."""
    policy = learner.greedy_policy(env, prepared, tables, outside_of_training(zero, episode))
    return expected_return(env, policy, params, zero)


def expected_return(
    env: AnyTabularEnvironment, policy: HierarchicalPolicy, params: Numbers, zero: Array, tolerance: float = 1e-4
) -> Array:
    """Expected undiscounted return of an episode, cut off at ``params.max_steps`` (float32 scalar).

    Sweeps from the last step backwards and stops early when no value changes by more than
    `tolerance`. Sums are taken in a fixed order, so that every mapping of runs gives the same bits.

    Raises:
        ValueError: `params` is traced; the model is made on the host.
    """
    if any(isinstance(value, Tracer) for value in params):
        raise ValueError("exact evaluation needs fixed params: it cannot be combined with an axis of the environment")
    chances = _chances(env, params)
    stacks, choice = _Stacks(policy.layout), policy.choice
    stack, action = stacks.decided(policy.slots)
    left, num_stacks, num_states = jnp.asarray(stacks.left()), len(stacks.chains), policy.layout.num_states
    pair = jnp.arange(num_states, dtype=jnp.int32)[None] * chances.num_actions + action  # [stacks, S]
    after = jnp.asarray(chances.next_state)[pair]  # [stacks, S, K]
    probability = jnp.asarray(chances.probability)[pair]
    reward = jnp.asarray(chances.reward)[pair]
    outcomes = range(after.shape[-1])

    def entering(value: Array) -> Array:
        """[S]: value of a state in which the root decides."""
        if choice is None:
            return value[0]
        children = policy.layout.levels[0]  # the first stacks are those of one subtask each
        return expectation([choice[:, task] for task in children], list(value[: len(children)]), zero)

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        value, _, count = carry
        arriving = jnp.take_along_axis(jnp.concatenate([value, entering(value)[None]]), left, axis=0)
        follows = [arriving[stack, after[..., k]] for k in outcomes]
        updated = reward + expectation([probability[..., k] for k in outcomes], follows, zero)
        return updated, jnp.abs(updated - value).max(), count + 1

    value, _, _ = lax.while_loop(
        lambda carry: (carry[1] > tolerance) & (carry[2] < params.max_steps),
        sweep,
        (jnp.zeros((num_stacks, num_states), jnp.float32), jnp.float32(np.inf), jnp.int32(0)),
    )
    starts = np.flatnonzero(chances.initial)
    weights = [jnp.float32(chances.initial[s]) for s in starts]
    return expectation(weights, [entering(value)[s] for s in starts], zero)
