"""Exact values and policies of known models: value iteration, policy iteration, policy evaluation.

Everything is jittable and vmap-able over models. Values have the dtype of the model's
probabilities as JAX holds them: float32, or float64 with ``jax.enable_x64``.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import Tracer

from hrljax.core import checks
from hrljax.solvers.model import Model, check_model
from hrljax.solvers.sweeps import Backup, change, settled, soft_value

MOST_SOLVED_STATES = 2048
"""With more states, `policy_iteration` evaluates policies by sweeps instead of linear systems."""
_MAX_SWEEPS = 100_000


class Solution(NamedTuple):
    """What a solver found."""

    q: Array  # [S, A] action values
    value: Array  # [S] state values
    policy: Array  # [S] int32, greedy in q, ties to the first action
    sweeps: Array  # int32 scalar: sweeps (value iteration) or improvements (policy iteration)


def action_values(model: Model, value: Array, discount: float | Array = 1.0) -> Array:
    """One Bellman backup: ``Q(s, a) = sum_k p_k (r_k + discount * value(s'_k))``, ``[S, A]``.

    Raises:
        TypeError, ValueError: a bad argument.
    """
    _check(model, discount=discount)
    checks.as_array("value", value, np.floating, (model.num_states,), "numbers", may_be_traced=True)
    return Backup.of(model, discount).q(jnp.asarray(value))


def _check(model: Model, *, tolerance: float = 0.0, **shares: float | Array) -> None:
    """Raises for a bad model, tolerance or number that must be in [0, 1]; traced ones pass."""
    check_model(model)
    for name, value in shares.items():
        checks.number(name, value, checks.SHARE, may_be_traced=True)
    checks.number("tolerance", tolerance, checks.NOT_NEGATIVE, may_be_traced=True)


def value_iteration(
    model: Model,
    discount: float | Array = 1.0,
    epsilon: float | Array = 0.0,
    tolerance: float = 1e-6,
    max_sweeps: int | Array = 100_000,
) -> Solution:
    """The optimal values, by sweeps of ``V(s) <- max_a Q(s, a)`` until they hold (Bellman 1957).

    They start from zero with discount 1, else from the value of the worst reward for ever: from below, a value
    travels as far as a sweep looks, while values that are too great come down by one step's reward a sweep.

    Args:
        model: the decision process.
        discount: in [0, 1]; 1 needs an episode that some policy ends from every state.
        epsilon: probability of a uniformly random action at every step; with it, the result is
            the best epsilon-soft policy's, the most that epsilon-greedy learning can earn.
        tolerance: stops when no value changes by more, relative to one plus the greatest value.
        max_sweeps: stops in any case; at least 1.

    Raises:
        TypeError, ValueError: a bad argument.
    """
    _check(model, discount=discount, epsilon=epsilon, tolerance=tolerance)
    checks.integer("max_sweeps", max_sweeps, 1, may_be_traced=True)
    return _value_iteration(model, discount, epsilon, tolerance, max_sweeps)


@jax.jit
def _value_iteration(
    model: Model, discount: float | Array, epsilon: float | Array, tolerance: float, max_sweeps: int | Array
) -> Solution:
    backup = Backup.of(model, discount)
    start = jnp.full(model.num_states, backup.least_value(discount))
    value, count = settled(backup, start, epsilon, tolerance, max_sweeps)
    q = backup.q(value)
    return Solution(q, soft_value(q, epsilon), jnp.argmax(q, -1).astype(jnp.int32), count)


def policy_evaluation(
    model: Model,
    policy: Array | np.ndarray,
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

    Raises:
        TypeError, ValueError: a bad argument.
    """
    _check(model, discount=discount, tolerance=tolerance)
    checks.integer("horizon", horizon, 0, may_be_traced=True)
    _check_policy(model, policy)
    return _policy_evaluation(model, jnp.asarray(policy), discount, horizon, tolerance)


def _check_policy(model: Model, policy: Array | np.ndarray) -> None:
    shapes = (model.num_states,), (model.num_states, model.num_actions)
    if np.shape(policy) not in shapes:
        allowed = f"actions of shape {shapes[0]} or probabilities of shape {shapes[1]}"
        raise ValueError(f"policy must be {allowed}, got shape {np.shape(policy)}")
    kind, what = (np.integer, "integers") if np.ndim(policy) == 1 else (np.floating, "probabilities")
    array = checks.as_array("policy", policy, kind, np.shape(policy), what, may_be_traced=True)
    if isinstance(array, Tracer):
        return
    if array.ndim == 1 and not (array.min() >= 0 and array.max() < model.num_actions):
        most = model.num_actions - 1
        raise ValueError(f"policy must have actions from 0 to {most}, got {array.min()} to {array.max()}")
    if array.ndim == 2 and not (array.min() >= 0 and np.allclose(array.sum(-1), 1, rtol=0, atol=1e-4)):
        raise ValueError("policy must have rows of probabilities that are not negative and sum to one")


@jax.jit
def _policy_evaluation(
    model: Model, policy: Array, discount: float | Array, horizon: int | Array, tolerance: float
) -> Array:
    backup = Backup.of(model, discount)

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        value, _, count = carry
        q = backup.q(value)
        if policy.ndim == 1:
            updated = jnp.take_along_axis(q, policy[:, None], axis=-1)[:, 0]
        else:
            updated = (policy.astype(q.dtype) * q).sum(-1)
        return updated, change(value, updated), count + 1

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


def policy_iteration(model: Model, discount: float | Array = 1.0, max_improvements: int | Array = 1000) -> Solution:
    """The optimal values, by evaluation to rounding and greedy improvement (Howard 1960).

    Up to `MOST_SOLVED_STATES` it starts from the uniformly random policy, which ends every episode that some policy
    can end, so that discount 1 is no special case, and solves ``[S, S]`` linear systems. A new action replaces an
    old one only where it is better by more than rounding, and actions that tie share the probability meanwhile, so
    that a policy that ends its episodes stays one. With more states it starts from the policy that
    `value_iteration` finds, and evaluates by sweeps from the last policy's values (Puterman and Shin 1978): it needs
    no more memory than the model.

    Args:
        model: the decision process.
        discount: in [0, 1].
        max_improvements: stops in any case; at least 1.

    Raises:
        TypeError, ValueError: a bad argument.
    """
    _check(model, discount=discount)
    checks.integer("max_improvements", max_improvements, 1, may_be_traced=True)
    return _policy_iteration(model, discount, max_improvements)


@jax.jit
def _policy_iteration(model: Model, discount: float | Array, max_improvements: int | Array) -> Solution:
    if model.num_states > MOST_SOLVED_STATES:
        return _policy_iteration_by_sweeps(model, discount, max_improvements)
    return _policy_iteration_by_systems(model, discount, max_improvements)


def _margin(value: Array) -> Array:
    """By how much one action's value has to exceed another's to be the better one, for all its rounding."""
    return 100 * float(jnp.finfo(value.dtype).eps) * (1 + jnp.abs(value))


def _policy_iteration_by_sweeps(model: Model, discount: float | Array, max_improvements: int | Array) -> Solution:
    backup = Backup.of(model, discount)
    rounding = float(jnp.finfo(backup.reward.dtype).eps)

    def improve(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        value, policy, _, count = carry
        value, _ = settled(backup.of_policy(policy), value, 0.0, rounding, _MAX_SWEEPS)
        q = backup.q(value)
        current = jnp.take_along_axis(q, policy[:, None], -1)[:, 0]
        is_better = q.max(-1) > current + _margin(current)
        return value, jnp.where(is_better, jnp.argmax(q, -1).astype(jnp.int32), policy), is_better.any(), count + 1

    start = _value_iteration(model, discount, 0.0, 1e-6, _MAX_SWEEPS)
    value, policy, _, count = lax.while_loop(
        lambda c: c[2] & (c[3] < max_improvements), improve, (start.value, start.policy, jnp.bool_(True), jnp.int32(0))
    )
    value, _ = settled(backup.of_policy(policy), value, 0.0, rounding, _MAX_SWEEPS)
    return Solution(backup.q(value), value, policy, count)


def _policy_iteration_by_systems(model: Model, discount: float | Array, max_improvements: int | Array) -> Solution:
    backup = Backup.of(model, discount)

    def evaluate(policy: Array) -> Array:
        matrix, reward = transition_matrix(model, policy)
        identity = jnp.eye(model.num_states, dtype=matrix.dtype)
        return jnp.linalg.solve(identity - jnp.asarray(discount, matrix.dtype) * matrix, reward[:, None])[:, 0]

    def improve(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        policy, _, count = carry
        q = backup.q(evaluate(policy))
        current = (policy * q).sum(-1)
        margin = _margin(current)
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
    q = backup.q(evaluate(policy))
    return Solution(q, (policy * q).sum(-1), jnp.argmax(policy, -1).astype(jnp.int32), count)
