"""Linear SARSA on the nearest things, the winner of the 2009 RL competition as it has been described."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.levels.tiles import TILE
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.hyperparameters import Hyperparameter, hyperparameter
from hrljax.learners.relational.concepts import ConceptSet, NearestThings
from hrljax.learners.relational.learner import Prepared, RelationalHORDQ

_INTERVAL = 10
"""Tiles."""


@dataclass(frozen=True)
class NearestThingsSARSA(RelationalHORDQ):
    """Linear SARSA on where the three nearest monsters or pits are, rewarded for every ten tiles (Ringstad et al.).

    To the reward of a step it adds `interval_reward` for every multiple of ten tiles that Mario has passed, and takes
    it off again where he goes back over one, so that running to and fro earns nothing. The rest is undescribed; it is
    as of `hrljax.RelationalHORDQ` without a root.
    """

    interval_reward: Hyperparameter = hyperparameter(10.0)
    concepts: ConceptSet = NearestThings(3)

    name = "SARSA on the nearest things"

    def learn(
        self, prepared: Prepared, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        intervals = _intervals(transition.next_state) - _intervals(transition.state)
        extra = context.product(jnp.asarray(self.interval_reward, jnp.float32), intervals)
        paid = transition._replace(reward=transition.reward + extra)
        return super().learn(prepared, state, paid, words, context)


def _intervals(episode: Episode) -> Array:
    """Whole tens of tiles to the left of Mario (float32)."""
    return jnp.floor(episode.world.player.x / np.float32(_INTERVAL * TILE))
