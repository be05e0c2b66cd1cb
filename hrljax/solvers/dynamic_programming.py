"""Exact values and policies of known models: value iteration, policy iteration, policy evaluation.

Everything is jittable and vmap-able over models. Values have the dtype of the model's
probabilities as JAX holds them: float32, or float64 with ``jax.enable_x64``.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from hrljax.solvers.model import Model


class Solution(NamedTuple):
    """What a solver found."""

    q: Array  # [S, A] action values
    value: Array  # [S] state values
    policy: Array  # [S] int32, greedy in q, ties to the first action
    sweeps: Array  # int32 scalar: sweeps (value iteration) or improvements (policy iteration)


def action_values(model: Model, value: Array, discount: float | Array = 1.0) -> Array:
    """One Bellman backup: ``Q(s, a) = sum_k p_k (r_k + discount * value(s'_k))``, ``[S, A]``."""
    probability = jnp.asarray(model.probability)
    follows = jnp.asarray(value)[jnp.asarray(model.next_state)]
    follows = jnp.where(jnp.asarray(model.terminated), jnp.zeros_like(follows), follows)
    discount = jnp.asarray(discount, probability.dtype)
    return (probability * (jnp.asarray(model.reward, probability.dtype) + discount * follows)).sum(-1)


def _change(old: Array, new: Array) -> Array:
    """Greatest change of a value, relative to one plus the greatest value."""
    return jnp.abs(new - old).max() / (1 + jnp.abs(new).max())


def soft_value(q: Array, epsilon: float | Array) -> Array:
    """Value of the epsilon-greedy policy of `q` at each state: ``(1 - e) max q + e mean q``."""
    epsilon = jnp.asarray(epsilon, q.dtype)
    return (1 - epsilon) * q.max(-1) + epsilon * q.mean(-1)


@jax.jit
def value_iteration(
    model: Model,
    discount: float | Array = 1.0,
    epsilon: float | Array = 0.0,
    tolerance: float = 1e-6,
    max_sweeps: int | Array = 100_000,
) -> Solution:
    """The optimal values, by sweeps of ``V <- max_a Q`` from zero (Bellman 1957).

    Args:
        model: the decision process.
        discount: in [0, 1]; 1 needs an episode that some policy ends from every state.
        epsilon: probability of a uniformly random action at every step; with it, the result is
            the best epsilon-soft policy's, the most that epsilon-greedy learning can earn.
        tolerance: stops when no value changes by more, relative to one plus the greatest value.
        max_sweeps: stops in any case.
    """

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        value, _, count = carry
        updated = soft_value(action_values(model, value, discount), epsilon)
        return updated, _change(value, updated), count + 1

    start = jnp.zeros(model.num_states, jnp.asarray(model.probability).dtype)
    changed = jnp.array(jnp.inf, start.dtype)
    value, _, count = lax.while_loop(
        lambda c: (c[1] > tolerance) & (c[2] < max_sweeps), sweep, (start, changed, jnp.int32(0))
    )
    q = action_values(model, value, discount)
    return Solution(q, soft_value(q, epsilon), jnp.argmax(q, -1).astype(jnp.int32), count)


@jax.jit
def policy_evaluation(
    model: Model,
    policy: Array,
    discount: float | Array = 1.0,
    horizon: int | Array = 100_000,
    tolerance: float = 1e-6,
) -> Array:
    """Expected return of a policy from every state, ``[S]``.

    Args:
        model: the decision process.
        policy: ``[S]`` int32 actions, or ``[S, A]`` probabilities.
        discount: in [0, 1].
        horizon: number of steps after which the return is cut off. With discount 1, a policy that
            never ends the episode has no finite value beyond a horizon.
        tolerance: stops before the horizon when no value changes by more, relative to one plus the
            greatest value.
    """
    policy = jnp.asarray(policy)

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        value, _, count = carry
        q = action_values(model, value, discount)
        if policy.ndim == 1:
            updated = jnp.take_along_axis(q, policy[:, None], axis=-1)[:, 0]
        else:
            updated = (policy.astype(q.dtype) * q).sum(-1)
        return updated, _change(value, updated), count + 1

    start = jnp.zeros(model.num_states, jnp.asarray(model.probability).dtype)
    changed = jnp.array(jnp.inf, start.dtype)
    value, _, _ = lax.while_loop(lambda c: (c[1] > tolerance) & (c[2] < horizon), sweep, (start, changed, jnp.int32(0)))
    return value


def transition_matrix(model: Model, policy: Array) -> tuple[Array, Array]:
    """Dense ``[S, S]`` transition probabilities and ``[S]`` expected rewards under ``[S, A]`` probabilities."""
    probability = jnp.asarray(model.probability)
    weight = probability * policy.astype(probability.dtype)[..., None]
    follows = jnp.where(jnp.asarray(model.terminated), jnp.zeros_like(weight), weight)
    size = model.num_states
    rows = jnp.broadcast_to(jnp.arange(size)[:, None, None], follows.shape)
    matrix = jnp.zeros((size, size), weight.dtype).at[rows, jnp.asarray(model.next_state)].add(follows)
    return matrix, (weight * jnp.asarray(model.reward, weight.dtype)).sum((-1, -2))


@jax.jit
def policy_iteration(model: Model, discount: float | Array = 1.0, max_improvements: int | Array = 1000) -> Solution:
    """The optimal values, by exact evaluation and greedy improvement (Howard 1960).

    Starts from the uniformly random policy, which ends every episode that some policy can end, so
    that discount 1 is no special case. Solves ``[S, S]`` linear systems: needs ``S * S`` memory.
    A new action replaces an old one only where it is better by more than rounding, and actions that
    tie share the probability meanwhile, so that a policy that ends its episodes stays one.
    """

    def evaluate(policy: Array) -> Array:
        matrix, reward = transition_matrix(model, policy)
        identity = jnp.eye(model.num_states, dtype=matrix.dtype)
        return jnp.linalg.solve(identity - jnp.asarray(discount, matrix.dtype) * matrix, reward[:, None])[:, 0]

    def improve(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        policy, _, count = carry
        q = action_values(model, evaluate(policy), discount)
        current = (policy * q).sum(-1)
        margin = 100 * jnp.finfo(q.dtype).eps * (1 + jnp.abs(current))
        best = q.max(-1)
        renew = (best > current + margin) | (policy.max(-1) < 1)
        ties = (q >= (best - margin)[:, None]).astype(q.dtype)
        updated = jnp.where(renew[:, None], ties / ties.sum(-1, keepdims=True), policy)
        return updated, jnp.any(updated != policy), count + 1

    dtype = jnp.asarray(model.probability).dtype
    uniform = jnp.full((model.num_states, model.num_actions), 1 / model.num_actions, dtype)
    policy, _, count = lax.while_loop(
        lambda c: c[1] & (c[2] < max_improvements), improve, (uniform, jnp.bool_(True), jnp.int32(0))
    )
    q = action_values(model, evaluate(policy), discount)
    return Solution(q, (policy * q).sum(-1), jnp.argmax(policy, -1).astype(jnp.int32), count)
