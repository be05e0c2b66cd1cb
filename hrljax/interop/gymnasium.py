"""Gymnasium environments: ``gymnasium.make("hrljax/Bus-v0")`` after ``import hrljax``, and back from tables.

Every environment that `hrljax.registered` names is one of Gymnasium's, with its options and numbers::

    gymnasium.make("hrljax/Taxi-v0", stochastic=True, params={"max_steps": 200}, render_mode="ansi")
    gymnasium.make_vec("hrljax/Bus-v0", num_envs=64, autoreset_mode="SameStep")

`from_table` goes the other way: it makes a Gymnasium environment with a transition table one of ours.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.error import ResetNeeded

from hrljax.core import checks
from hrljax.core.environment import EpisodeState
from hrljax.envs.base import AnyEnvironment, check_render_mode
from hrljax.envs.numpy_values import METADATA, as_element, as_python, metadata_of
from hrljax.interop import episodes
from hrljax.interop.gymnasium_table import from_table
from hrljax.interop.gymnasium_vector import BatchedEnv, Info

__all__ = ["BatchedEnv", "SingleEnv", "from_table"]


class SingleEnv(gymnasium.Env[Any, Any]):
    """One environment under Gymnasium's interface.

    Seeded with ``reset(seed=...)`` it repeats itself; it then goes through the same states as a
    `BatchedEnv` of size 1 with that seed. It truncates after ``params.max_steps``.

    Args:
        environment: the name of a registered environment, or an environment.
        params: its numbers: a mapping of some of them, or a NamedTuple of all.
        render_mode: ``"ansi"``, ``"rgb_array"``, or None.
        options: of the environment, if it is given by name.

    Raises:
        TypeError, ValueError: an option, a number or the render mode is not one that the environment has.
    """

    metadata = METADATA

    def __init__(
        self,
        environment: str | AnyEnvironment,
        *,
        params: episodes.Params = None,
        render_mode: str | None = None,
        **options: object,
    ):
        self.environment, self.params = episodes.made(environment, params, options)
        if render_mode is not None:
            check_render_mode(self.environment, render_mode)
        self.render_mode = render_mode
        self.metadata = metadata_of(self.environment)
        self.observation_space = self.environment.observation_space
        self.action_space = self.environment.action_space
        self.state: EpisodeState | None = None
        """The environment's own state, None before the first `reset`."""
        self._key: jax.Array | None = None
        self._goes_on = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[episodes.Observation, Info]:
        """Starts an episode: observation and an empty info.

        Raises:
            ValueError: `options` has entries; there are none to set.
        """
        super().reset(seed=seed)
        if checks.instance("options", options or {}, Mapping, "an empty mapping or None"):
            assert options is not None
            raise ValueError(f"options must be empty, got {', '.join(options)}")
        self._key = jnp.asarray(episodes.draw_key(self.np_random))
        observation, self.state = episodes.begin(self.environment, self.params, self._key)
        self._goes_on = True
        return as_element(self.observation_space, observation), {}

    def step(self, action: object) -> tuple[episodes.Observation, float, bool, bool, Info]:
        """Takes one step. The info has the environment's events (`Environment.metrics`).

        Raises:
            ResetNeeded: no episode has begun, or it is over.
            TypeError, ValueError: there is no such action.
        """
        if not self._goes_on:
            raise ResetNeeded("step needs an episode that goes on: call reset first")
        number = checks.integer("action", action, 0, self.environment.num_actions - 1)
        stepped = episodes.advance(self.environment, self.params, self._key, self.state, np.int32(number))
        observation, self.state, *outcome = stepped
        reward, terminated, truncated, info = jax.device_get(outcome)
        self._goes_on = not (terminated or truncated)
        events = {name: as_python(value) for name, value in info.items()}
        return as_element(self.observation_space, observation), float(reward), bool(terminated), bool(truncated), events

    def render(self) -> str | np.ndarray | None:
        """The picture of the state in the environment's `render_mode`."""
        if self.render_mode is None:
            gymnasium.logger.warn("render needs a render_mode, for example gymnasium.make(id, render_mode='ansi')")
            return None
        if self.state is None:
            raise ResetNeeded("render needs a state: call reset first")
        return self.environment.render(self.state, self.render_mode)
