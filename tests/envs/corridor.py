"""A small environment of a user's own, with and without numbers of states, in which tests make mistakes."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium
import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core.random import below
from hrljax.envs.base import Environment, TabularEnvironment

LENGTH = 4


class State(NamedTuple):
    cell: Array
    has_key: Array
    time: Array


class Numbers(NamedTuple):
    slip_probability: float = 0.25
    key_reward: float = 0.5
    max_steps: int = 30


class _Moves:
    """Left and right, both of which may slip; the key lies at the left end, the door at the right end."""

    name = "Corridor"
    action_names = ("left", "right")
    metrics = ("key",)
    num_words, num_initial_words = 1, 1
    default_params = Numbers()

    def initial(self, words: tuple[Array, ...], params: Any) -> Any:
        return State(1 + below(words[0], 0.5).astype(jnp.int32), jnp.int32(0), jnp.int32(0))

    def transition(self, state: Any, action: Array, words: tuple[Array, ...], params: Any) -> Any:
        move = jnp.where(below(words[0], params.slip_probability), 0, 2 * action - 1)
        cell = jnp.clip(state.cell + move, 0, LENGTH - 1)
        has_key = jnp.where(cell == 0, 1, state.has_key)
        picked = (has_key == 1) & (state.has_key == 0)
        opened = (cell == LENGTH - 1) & (has_key == 1)
        reward = jnp.where(picked, jnp.float32(params.key_reward), jnp.float32(-1))
        return State(cell, has_key, state.time + 1), reward, opened, {"key": picked}


@dataclass(frozen=True)
class Corridor(_Moves, TabularEnvironment[State, Numbers]):
    """Some numbers belong to no state: those from `LENGTH` cells on, which `spare` adds."""

    spare: int = 3

    @property
    def num_states(self) -> int:
        return 2 * LENGTH + self.spare

    def encode(self, state: Any) -> Array:
        return state.has_key * LENGTH + state.cell

    def decode(self, index: Array) -> Any:
        return State(index % LENGTH, index // LENGTH, jnp.int32(0))

    def word_cuts(self, params: Any) -> Any:
        return ((params.slip_probability,),)

    def initial_word_cuts(self, params: Any) -> Any:
        return ((0.5,),)


@dataclass(frozen=True)
class Untabular(_Moves, Environment[State, Numbers]):
    """The same without numbers; the event tells the cell, too."""

    metrics = ("key", "cell")

    def transition(self, state: Any, action: Array, words: tuple[Array, ...], params: Any) -> Any:
        after, reward, terminated, info = super().transition(state, action, words, params)
        return after, reward, terminated, {**info, "cell": after.cell.astype(jnp.float32)}

    def observation(self, state: Any) -> Array:
        return jnp.stack([state.cell, state.has_key])

    @property
    def observation_space(self) -> gymnasium.spaces.Box:
        return gymnasium.spaces.Box(0, LENGTH, (2,), np.int32)


def changed(base: type[Any] = Corridor, **attributes: Any) -> Any:
    """An environment that differs from `base` in some attributes; `step=` changes what `transition` returns.

    ``step(state, action, words, params, after, reward, terminated, info)`` returns the four values.
    """
    step = attributes.pop("step", None)
    if step is not None:

        def transition(self: Any, state: Any, action: Array, words: tuple[Array, ...], params: Any) -> Any:
            returned = base.transition(self, state, action, words, params)
            return step(state, action, words, params, *returned)

        attributes["transition"] = transition
    return type("Changed", (base,), attributes)()
