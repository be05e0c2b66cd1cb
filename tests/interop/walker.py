"""An environment without state numbers, whose observations are a tree, for the adapters' tests."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from jax import Array

from hrljax.core.random import WORD_RANGE
from hrljax.envs.base import Environment


class WalkState(NamedTuple):
    place: Array  # [2] float32
    time: Array  # int32


class WalkParams(NamedTuple):
    far: float = 1.0
    max_steps: int = 12


class Sight(NamedTuple):
    place: Array
    parts: tuple[Array, Array]


@dataclass(frozen=True)
class Walker(Environment[WalkState, WalkParams]):
    """A random walk in the plane, which ends `far` from where it began."""

    name = "Walker"
    action_names = ("along", "across")
    metrics = ("stride", "long")
    num_words = 1
    num_initial_words = 0

    @property
    def default_params(self) -> WalkParams:
        return WalkParams()

    def initial(self, words: tuple[Array, ...], params: WalkParams) -> WalkState:
        return WalkState(jnp.zeros(2, jnp.float32), jnp.int32(0))

    def transition(
        self, state: WalkState, action: Array, words: tuple[Array, ...], params: WalkParams
    ) -> tuple[WalkState, Array, Array, dict[str, Array]]:
        length = words[0].astype(jnp.float32) / np.float32(WORD_RANGE)
        place = state.place + length * (jnp.arange(2, dtype=jnp.int32) == action).astype(jnp.float32)
        ends = place.max() >= params.far
        return WalkState(place, state.time + 1), -length, ends, {"stride": length, "long": length > 0.5}

    def observation(self, state: WalkState) -> Any:
        return Sight(state.place, (state.time, (state.place > 0.5).astype(jnp.int8)))

    @property
    def observation_space(self) -> spaces.Dict:
        parts = spaces.Tuple([spaces.Discrete(100), spaces.MultiBinary(2)])
        return spaces.Dict({"place": spaces.Box(0.0, 9.0, (2,), np.float32), "parts": parts})
