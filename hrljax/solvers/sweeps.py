"""Sweeps of Bellman backups over all states, until the values change no more."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.solvers.model import Model


def loops_are_native() -> bool:
    """Whether a loop of small steps costs no more than its arithmetic; `hrljax` puts what its engine knows here."""
    return False


class Backup(NamedTuple):
    """``Q(s, a) = reward(s, a) + sum_k weight_k V(s'_k)``: a model and a discount, ready to be swept."""

    reward: Array  # [S, A]: expected reward of a step
    weight: Array  # [S, A, K]: discounted probability of what follows, 0 where the episode ends
    next_state: Array  # [S, A, K] uint32: of indices that cannot be negative no sign has to be looked at

    @staticmethod
    def of(model: Model, discount: float | Array) -> "Backup":
        probability = jnp.asarray(model.probability)
        dtype = probability.dtype
        reward = (probability * jnp.asarray(model.reward, dtype)).sum(-1)
        goes_on = jnp.where(jnp.asarray(model.terminated), jnp.zeros((), dtype), probability)
        return Backup(reward, jnp.asarray(discount, dtype) * goes_on, jnp.asarray(model.next_state).astype(jnp.uint32))

    def of_policy(self, action: Array) -> "Backup":
        """The backup of one action a state (``[S]`` int32), as that of a process with that action alone."""
        rows = jnp.arange(len(action)), action
        return Backup(*(array[rows][:, None] for array in self))

    def q(self, value: Array) -> Array:
        """Action values, of all states (``[S, A]``), or of one (``[A]``) where this is the backup of one."""
        return self.reward + (self.weight * value[self.next_state]).sum(-1)

    def least_value(self, discount: float | Array) -> Array:
        """Less than any policy's value with a discount below 1: the worst reward of a step for ever.

        0 with discount 1, where there may be no such number.
        """
        rest = 1 - jnp.asarray(discount, self.reward.dtype)
        worst = jnp.minimum(self.reward.min(), 0)
        return jnp.where(rest > 0, worst / jnp.where(rest > 0, rest, 1), 0).astype(self.reward.dtype)


def change(old: Array, new: Array) -> Array:
    """Greatest change of a value, relative to one plus the greatest value."""
    return jnp.abs(new - old).max() / (1 + jnp.abs(new).max())


def soft_value(q: Array, epsilon: float | Array) -> Array:
    """Value of the epsilon-greedy policy of `q` at each state: ``(1 - e) max q + e mean q``."""
    epsilon = jnp.asarray(epsilon, q.dtype)
    return (1 - epsilon) * q.max(-1) + epsilon * q.mean(-1)


def settled(
    backup: Backup, start: Array, epsilon: float | Array, tolerance: float | Array, max_sweeps: int | Array
) -> tuple[Array, Array]:
    """Values (``[S]``) after sweeps of ``V(s) <- soft_value(Q(s))`` that changed no value by more than a tolerance.

    Where loops are native a sweep changes the values in place, so that a state sees what the states before it have
    just become, and every other sweep goes backwards (Gauss and Seidel; Sutton and Barto 2018, section 4.4): values
    travel far in a sweep. Elsewhere all states are backed up at once.

    Args:
        backup: what is swept.
        start: ``[S]``.
        epsilon, tolerance, max_sweeps: as those of `hrljax.solvers.value_iteration`.

    Returns:
        the values, and the number of sweeps (int32).
    """
    in_place = loops_are_native()

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        value, _, count = carry
        renewed = _in_place(backup, value, epsilon, count) if in_place else soft_value(backup.q(value), epsilon)
        # Not within the sweep: a read of the old value beside its write has the whole table copied.
        return renewed, change(value, renewed), count + 1

    begin = start, jnp.array(np.inf, start.dtype), jnp.int32(0)
    value, _, count = lax.while_loop(lambda c: (c[1] > tolerance) & (c[2] < max_sweeps), sweep, begin)
    return value, count


def _in_place(backup: Backup, value: Array, epsilon: float | Array, count: Array) -> Array:
    last = jnp.uint32(len(value) - 1)
    backwards = count % 2 == 1

    def renew(turn: Array, value: Array) -> Array:
        state = jnp.where(backwards, last - turn, turn)
        here = Backup(*(lax.dynamic_index_in_dim(array, state, keepdims=False) for array in backup))
        return lax.dynamic_update_slice(value, soft_value(here.q(value), epsilon)[None], (state,))

    return lax.fori_loop(jnp.uint32(0), jnp.uint32(len(value)), renew, value)
