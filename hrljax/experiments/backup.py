"""What happens if a pseudo-reward is not kept apart: a learner that is here to fail."""

from dataclasses import dataclass

import jax.numpy as jnp
from jax import Array, lax

from hrljax.learners.base import Discounted
from hrljax.learners.hordq import HORDQ, Q


@dataclass(frozen=True)
class PseudoRewardInBackup(HORDQ):
    """HORDQ that writes the pseudo-reward into Q_c, from where it spreads into every bootstrap.

    Without discounting it is earned for ever: through a door and back, and through it again.

    Attributes: as `HORDQ`.
    """

    name = "HORDQ, pseudo-reward in the backup"

    def target(self, reward: Array, gamma: Discounted, exited: Array, pseudo_reward: Array, q_next: Q) -> Q:
        target = super().target(reward, gamma, exited, pseudo_reward, q_next)
        return target._replace(c=lax.select(exited, pseudo_reward, target.c), p=jnp.float32(0))
