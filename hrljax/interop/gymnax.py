"""The environments for code that is written for gymnax, 1.0 or before: functional, with auto-reset.

``env, env_params = hrljax.interop.gymnax.make("Bus", one_hot=True)`` stands in for ``gymnax.make``.
gymnax itself is not needed; if it is installed, the spaces are its own.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import Tracer

from hrljax.core import checks
from hrljax.core.environment import EpisodeState, Numbers
from hrljax.envs.base import AnyEnvironment, Environment, TabularEnvironment, check_options, concrete_number
from hrljax.interop.episodes import Observation, Step, made
from hrljax.interop.gymnax_spaces import Space, box_of_ones, gymnax_space

__all__ = ["GymnaxEnvironment", "GymnaxParams", "make"]


@partial(jax.tree_util.register_dataclass, data_fields=["numbers"], meta_fields=[])
@dataclass(frozen=True)
class GymnaxParams:
    """Numbers of an environment under the names that gymnax's users expect; a pytree.

    Every number is an attribute, and ``max_steps_in_episode`` is another name of ``max_steps``.
    """

    numbers: Numbers

    @property
    def max_steps_in_episode(self) -> int:
        """After so many steps, an episode is truncated."""
        return self.numbers.max_steps

    def replace(self, **changes: Any) -> "GymnaxParams":
        """The same numbers but for `changes`.

        Raises:
            TypeError: a number is of the wrong kind.
            ValueError: there is no number of that name, or it is out of range.
        """
        if "max_steps_in_episode" in changes:
            changes["max_steps"] = changes.pop("max_steps_in_episode")
        if unknown := set(changes) - set(self.numbers._asdict()):
            names = ", ".join(sorted(unknown))
            raise ValueError(f"params must be among {', '.join(self.numbers._asdict())}, got {names}")
        for name, value in changes.items():
            if np.ndim(value) == 0:  # arrays are for `jax.vmap`, which gives one of their entries to each environment
                concrete_number(name, value)
        return GymnaxParams(self.numbers._replace(**changes))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "numbers":
            raise AttributeError(name)
        return getattr(self.numbers, name)


@dataclass(frozen=True)
class GymnaxEnvironment:
    """An environment under the interface of gymnax.

    `step` resets by itself, as gymnax does: where an episode is over, state and observation are
    those of the next one's beginning. Keys may be old (``jax.random.PRNGKey``) or new ones.

    There is no ``is_terminal``: whether an episode ended is an outcome of a step, and not always of
    the state that it led to (a bus that broke down).

    Attributes:
        environment: the environment.
        one_hot: observations are vectors of zeros with a one at the number of the state (float32
            ``[S]``), for networks; only for tabular environments.
        step_values: how many values `step` returns: 6 as in gymnax 1.0 (observation, state, reward,
            terminated, truncated, info), or 5 as before (..., reward, done, info).

    Raises:
        TypeError: `environment` is no environment.
        ValueError: an attribute has another value, or `one_hot` does not fit the environment.
    """

    environment: AnyEnvironment
    one_hot: bool = False
    step_values: Literal[5, 6] = 6

    def __post_init__(self) -> None:
        checks.instance("environment", self.environment, Environment, "an environment such as hrljax.make('Bus')")
        check_options(self, {"one_hot": (False, True), "step_values": (5, 6)})
        if self.one_hot and not isinstance(self.environment, TabularEnvironment):
            raise ValueError(f"one_hot needs a tabular environment, got {self.environment!r}")

    @property
    def name(self) -> str:
        return self.environment.name

    @property
    def num_actions(self) -> int:
        return self.environment.num_actions

    @property
    def default_params(self) -> GymnaxParams:
        return GymnaxParams(self.environment.default_params)

    @partial(jax.jit, static_argnames=("self",))
    def reset(self, key: Array, params: GymnaxParams | None = None) -> tuple[Observation, EpisodeState]:
        """Starts an episode: observation and state."""
        return self.reset_env(key, params)

    @partial(jax.jit, static_argnames=("self",))
    def step(self, key: Array, state: EpisodeState, action: Array | int, params: GymnaxParams | None = None) -> Step:
        """Takes a step, and begins a new episode where one is over.

        The info has the environment's events (`Environment.metrics`), ``terminated``, ``truncated``
        and ``final_observation`` (that of the step, before any new episode), and with 5 values
        ``discount`` (0 where the episode terminated, else 1), all of this step.
        """
        step_key, reset_key = jax.random.split(key)
        stepped, after, reward, terminated, truncated, events = self._native_step(step_key, state, action, params)
        begun, first = self.reset_env(reset_key, params)
        done = terminated | truncated
        obs, state = jax.tree.map(partial(_select, done), (begun, first), (stepped, after))
        info = {**events, "terminated": terminated, "truncated": truncated, "final_observation": stepped}
        if self.step_values == 6:
            return obs, state, reward, terminated, truncated, info
        info["discount"] = 1 - terminated.astype(jnp.float32)
        return obs, state, reward, done, info

    def reset_env(self, key: Array, params: GymnaxParams | None = None) -> tuple[Observation, EpisodeState]:
        """As `reset`."""
        _, state = self.environment.reset(_new_style(key), self._numbers(params))
        return self.get_obs(state), state

    def step_env(
        self, key: Array, state: EpisodeState, action: Array | int, params: GymnaxParams | None = None
    ) -> Step:
        """One step without auto-reset: ``obs, state, reward, ended, info``.

        ``ended`` is `terminated` as in gymnax 1.0, or `done` (terminated or truncated) with 5 values.
        """
        obs, state, reward, terminated, truncated, events = self._native_step(key, state, action, params)
        return obs, state, reward, terminated if self.step_values == 6 else terminated | truncated, events

    def _native_step(self, key: Array, state: EpisodeState, action: Array | int, params: GymnaxParams | None) -> Step:
        _, after, *outcome = self.environment.step(_new_style(key), state, action, self._numbers(params))
        return self.get_obs(after), after, *outcome

    def get_obs(self, state: EpisodeState, params: GymnaxParams | None = None, key: Array | None = None) -> Observation:
        """What an agent sees of a state."""
        observation = self.environment.observation(state)
        if not isinstance(self.environment, TabularEnvironment) or not self.one_hot:
            return observation
        return (jnp.arange(self.environment.num_states, dtype=jnp.int32) == observation).astype(jnp.float32)

    def observe(
        self, key: Array, state: EpisodeState, action: Array | int, params: GymnaxParams | None = None
    ) -> Observation:
        """As `get_obs`, with gymnax 1.0's arguments."""
        return self.get_obs(state)

    def is_truncated(self, state: EpisodeState, params: GymnaxParams | None = None) -> Array:
        """Whether the limit of steps is reached."""
        return state.time >= self._numbers(params).max_steps

    def action_space(self, params: GymnaxParams | None = None) -> Space:
        """gymnax's space of actions."""
        return gymnax_space(self.environment.action_space)

    def observation_space(self, params: GymnaxParams | None = None) -> Space:
        """gymnax's space of observations."""
        if isinstance(self.environment, TabularEnvironment) and self.one_hot:
            return box_of_ones(self.environment.num_states)
        return gymnax_space(self.environment.observation_space)

    def _numbers(self, params: GymnaxParams | None) -> Numbers:
        """The environment's numbers; traced ones as float32, and int32 for the limit of steps."""
        params = self.default_params if params is None else params
        checks.instance("params", params, GymnaxParams, "GymnaxParams such as env.default_params.replace(max_steps=5)")
        numbers = params.numbers
        dtypes = {name: jnp.int32 if name == "max_steps" else jnp.float32 for name in numbers._asdict()}
        traced = {name: value for name, value in numbers._asdict().items() if isinstance(value, Tracer)}
        return numbers._replace(**{name: jnp.asarray(value, dtypes[name]) for name, value in traced.items()})


def make(
    name: str | AnyEnvironment,
    *,
    one_hot: bool = False,
    step_values: Literal[5, 6] = 6,
    params: Mapping[str, float] | Numbers | None = None,
    **options: Any,
) -> tuple[GymnaxEnvironment, GymnaxParams]:
    """An environment and its numbers, as ``gymnax.make`` returns them.

    Args:
        name: of a registered environment, or an environment.
        one_hot, step_values: see `GymnaxEnvironment`.
        params: numbers of the environment: a mapping of some of them, or a NamedTuple of all.
        options: of the environment, if it is given by name.

    Raises:
        TypeError, ValueError: an argument is not one of those.
    """
    env, numbers = made(name, params, options)
    return GymnaxEnvironment(env, one_hot, step_values), GymnaxParams(numbers)


def _new_style(key: Array) -> Array:
    return key if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) else jax.random.wrap_key_data(key)


def _select(done: Array, these: Array, those: Array) -> Array:
    return lax.select(jnp.broadcast_to(done, these.shape), these, those)
