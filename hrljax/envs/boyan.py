"""Boyan's chain, on which policy evaluation with linear features is compared."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.environment import Cuts, Events, Words
from hrljax.core.random import below
from hrljax.envs.base import TabularEnvironment


class BoyanState(NamedTuple):
    """Both fields are int32 scalars."""

    position: Array  # from `BoyanChain.length` down to 0
    time: Array  # steps taken in this episode


class BoyanParams(NamedTuple):
    """Numbers of the chain; each may be swept as ``env.<name>``."""

    step_reward: float = -3.0
    last_reward: float = -2.0
    """Of the step from position 1 to 0; leaving 0 earns nothing."""
    max_steps: int = 1000


@dataclass(frozen=True)
class BoyanChain(TabularEnvironment[BoyanState, BoyanParams]):
    """A chain with one action: from position p to p - 1 or p - 2, equally likely (Boyan 1999).

    Episodes begin at the far end. From 1 the only way is to 0, from where the episode ends. With the default rewards
    position p is worth ``-2 p``, which is linear in `interpolation`.

    Attributes:
        length: of the chain, a multiple of `spacing`: the position of the far end. 12 is Boyan's, 96 that of Sutton,
            Szepesvari, Geramifard and Bowling (2008), who count the end as a state too.
        spacing: between positions that have a feature of their own.

    Raises:
        TypeError: an attribute is no integer.
        ValueError: `spacing` is less than 1, or `length` is no multiple of it.
    """

    length: int = 96
    spacing: int = 4

    name = "BoyanChain"
    action_names = ("onwards",)
    num_words = 1
    num_initial_words = 0

    def __post_init__(self) -> None:
        checks.integer("spacing", self.spacing, 1)
        checks.integer("length", self.length, 1)
        if self.length % self.spacing:
            raise ValueError(f"length must be a multiple of spacing={self.spacing}, got {self.length}")

    @property
    def default_params(self) -> BoyanParams:
        return BoyanParams()

    @property
    def num_states(self) -> int:
        return self.length + 1

    def interpolation(self) -> np.ndarray:
        """The features of every state, ``[length + 1, length / spacing + 1]`` float32.

        A state at a multiple of `spacing` has one feature, of weight 1; in between the two nearest ones have weights
        that sum to 1, the more the nearer. The last feature is the far end's.
        """
        near, between = np.divmod(np.arange(self.num_states), self.spacing)
        share = (between / self.spacing).astype(np.float32)
        matrix = np.zeros((self.num_states, self.length // self.spacing + 2), np.float32)
        rows = np.arange(self.num_states)
        matrix[rows, near], matrix[rows, near + 1] = 1 - share, share
        return matrix[:, :-1]

    def encode(self, state: BoyanState) -> Array:
        return state.position

    def decode(self, index: Array) -> BoyanState:
        return BoyanState(jnp.asarray(index, jnp.int32), jnp.int32(0))

    def initial(self, words: Words, params: BoyanParams) -> BoyanState:
        return BoyanState(jnp.int32(self.length), jnp.int32(0))

    def transition(
        self, state: BoyanState, action: Array, words: Words, params: BoyanParams
    ) -> tuple[BoyanState, Array, Array, Events]:
        step = lax.select(below(words[0], 0.5), jnp.int32(1), jnp.int32(2))
        position = lax.max(state.position - step, jnp.int32(0))
        reward = lax.select(state.position > 1, jnp.float32(params.step_reward), jnp.float32(params.last_reward))
        reward = lax.select(state.position > 0, reward, jnp.float32(0))
        return BoyanState(position, state.time + 1), reward, state.position == 0, {}

    def initial_word_cuts(self, params: BoyanParams) -> Cuts:
        return ()

    def word_cuts(self, params: BoyanParams) -> Cuts:
        return ((0.5,),)
