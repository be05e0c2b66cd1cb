"""Exact value of a fixed hierarchical policy, by dynamic programming over (subtask, state) pairs.

A flat policy is the case of one subtask that never ends.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import Tracer

from hrljax.envs.base import TabularEnvironment
from hrljax.models.multi_time import expectation


class HierarchicalPolicy(NamedTuple):
    """What every subtask does; T subtasks below the root, S states."""

    actions: Array  # [T, S] int32 primitive actions
    active: np.ndarray  # [T, S] bool: the subtask goes on
    choice: Array  # [S, T] float32: probabilities that the root invokes each subtask


class _Chances(NamedTuple):
    next_state: np.ndarray  # [S * A, K] int32
    probability: np.ndarray  # [S * A, K] float32, 0 where the episode ends
    reward: np.ndarray  # [S * A] float32, expected
    initial: np.ndarray  # [S] float64
    num_actions: int


@lru_cache(maxsize=16)
def _chances(env: TabularEnvironment[Any, Any], params: Any) -> _Chances:
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


def expected_return(
    env: TabularEnvironment[Any, Any], policy: HierarchicalPolicy, params: Any, zero: Array, tolerance: float = 1e-4
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
    num_tasks, num_states = policy.active.shape
    pair = jnp.arange(num_states, dtype=jnp.int32)[None] * chances.num_actions + policy.actions  # [T, S]
    after = jnp.asarray(chances.next_state)[pair]  # [T, S, K]
    probability = jnp.asarray(chances.probability)[pair]
    reward = jnp.asarray(chances.reward)[pair]
    goes_on = jnp.asarray(policy.active)
    outcomes = range(after.shape[-1])

    def entering(value: Array) -> Array:
        """[S]: value of a state in which the root decides."""
        return expectation([policy.choice[:, t] for t in range(num_tasks)], list(value), zero)

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        value, _, count = carry
        arriving = jnp.where(goes_on, value, jnp.broadcast_to(entering(value), value.shape))  # [T, S]
        follows = [jnp.take_along_axis(arriving, after[..., k], axis=1) for k in outcomes]
        updated = reward + expectation([probability[..., k] for k in outcomes], follows, zero)
        return updated, jnp.abs(updated - value).max(), count + 1

    value, _, _ = lax.while_loop(
        lambda carry: (carry[1] > tolerance) & (carry[2] < params.max_steps),
        sweep,
        (jnp.zeros((num_tasks, num_states), jnp.float32), jnp.float32(np.inf), jnp.int32(0)),
    )
    starts = np.flatnonzero(chances.initial)
    weights = [jnp.float32(chances.initial[s]) for s in starts]
    return expectation(weights, [entering(value)[s] for s in starts], zero)
