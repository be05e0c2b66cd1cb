"""What happens if a pseudo-reward is not kept apart: a learner that is here to fail."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jax import Array, lax

from hrljax.learners import updates
from hrljax.learners.hordq import HORDQ


@dataclass(frozen=True)
class PseudoRewardInBackup(HORDQ):
    """HORDQ that writes the pseudo-reward into Q_c, from where it spreads into every bootstrap.

    Without discounting it is earned for ever: through a door and back, and through it again.

    Attributes: as `HORDQ`.
    """

    name = "HORDQ, pseudo-reward in the backup"

    def _target(
        self, reward: Array, discount: Any, exited: Array, pseudo: Array, follows: updates.Parts, zero: Array
    ) -> updates.Parts:
        target = super()._target(reward, discount, exited, pseudo, follows, zero)
        return target._replace(completion=lax.select(exited, pseudo, target.completion), pseudo=jnp.float32(0))
