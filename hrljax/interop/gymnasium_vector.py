"""Gymnasium's vector environment on the batched step."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import gymnasium
import jax
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from hrljax.core import checks
from hrljax.envs.base import AnyEnvironment, check_render_mode
from hrljax.envs.numpy_values import METADATA, as_element, entry, metadata_of, widened
from hrljax.interop import episodes
from hrljax.interop.episodes import Observation

Info: TypeAlias = dict[str, Any]
"""What Gymnasium's environments tell of a step besides: arrays by name, and the masks of those that have them."""


class BatchedEnv(gymnasium.vector.VectorEnv[Any, Any, np.ndarray]):
    """Many environments in one compiled step. Seeded with s, number i is a `SingleEnv` seeded with s + i.

    Observations, rewards, ends and infos are those of Gymnasium's ``SyncVectorEnv`` in every mode:

    - ``NEXT_STEP``: after an episode's end, the next step ignores the action and begins a new one.
    - ``SAME_STEP``: the step that ends an episode begins a new one; ``infos["final_obs"]`` and
      ``infos["final_info"]`` tell of the end.
    - ``DISABLED``: the caller resets, with ``reset(options={"reset_mask": ended})``.

    Args:
        environment: the name of a registered environment, or an environment.
        num_envs: how many.
        params: numbers of the environment: a mapping of some of them, or a NamedTuple of all.
        render_mode: ``"ansi"``, ``"rgb_array"``, or None.
        autoreset_mode: the mode or its value: ``"NextStep"``, ``"SameStep"``, ``"Disabled"``.
        max_episode_steps: truncates episodes earlier than ``params.max_steps`` does.
        options: of the environment, if it is given by name.

    Raises:
        TypeError, ValueError: an argument is not one of those.
    """

    metadata = METADATA

    def __init__(
        self,
        environment: str | AnyEnvironment,
        num_envs: int = 1,
        *,
        params: episodes.Params = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        **options: object,
    ):
        num_envs = checks.integer("num_envs", num_envs, 1)
        self.environment, numbers = episodes.made(environment, params, options)
        if max_episode_steps is not None:
            limit = min(numbers.max_steps, checks.integer("max_episode_steps", max_episode_steps, 1))
            self.environment, numbers = episodes.made(self.environment, numbers._replace(max_steps=limit), {})
        self.params = numbers
        if render_mode is not None:
            check_render_mode(self.environment, render_mode)
        self.num_envs, self.render_mode = num_envs, render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**metadata_of(self.environment), "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = self.environment.observation_space
        self.single_action_space = self.environment.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators = [seeding.np_random() for _ in range(num_envs)]
        self._next_keys = np.array([episodes.draw_key(generator) for generator, _ in self._generators])
        self._batch: episodes.Batch | None = None
        self._ended = np.zeros(num_envs, np.bool_)

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generators of the environments; each has drawn the key of its next episode already."""
        return tuple(generator for generator, _ in self._generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seeds of the environments."""
        return tuple(seed for _, seed in self._generators)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Starts episodes, in all environments or in those of ``options["reset_mask"]`` (``[num_envs]`` bool).

        Args:
            seed: of environment 0, the others counting on from there; or a sequence, None leaving
                an environment's generator as it is. Environments outside the mask keep theirs.
            options: ``{"reset_mask": mask}`` or nothing.

        Raises:
            ValueError: wrong number of seeds, unknown option, or a mask of another shape or without True.
            TypeError: the mask is no array of bool.
            ResetNeeded: a mask leaves out an environment that has never been reset.
        """
        checks.instance("options", options or {}, Mapping, "a mapping or None")
        mask = self._reset_mask(options or {})
        if seed is None or isinstance(seed, int | np.integer):
            seed = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        checks.instance("seed", seed, (Sequence, np.ndarray), "an integer, a sequence of integers or None")
        if len(seed) != self.num_envs:
            raise ValueError(f"seed must have one entry for each of {self.num_envs} environments, got {len(seed)}")
        for i, seed_of_one in enumerate(seed):
            if seed_of_one is not None and mask[i]:
                self._generators[i] = seeding.np_random(seed_of_one)
                self._next_keys[i] = episodes.draw_key(self._generators[i][0])
        if self._batch is None:
            self._batch = episodes.begin_all(self.environment, self.params, self._next_keys.copy())
        else:
            keys = self._next_keys.copy()
            self._batch = episodes.begin_some(self.environment, self.params, self._batch, mask, keys)
        self._draw_next_keys(mask)
        self._ended = self._ended & ~mask
        return self._observation(), {}

    def _reset_mask(self, options: Mapping[str, object]) -> np.ndarray:
        if unknown := set(options) - {"reset_mask"}:
            raise ValueError(f"options must be empty or have reset_mask, got {', '.join(sorted(unknown))}")
        if "reset_mask" not in options:
            return np.ones(self.num_envs, np.bool_)
        mask = options["reset_mask"]
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError(f"options['reset_mask'] must be a NumPy array of bool, got {mask!r}")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(f"options['reset_mask'] must have shape ({self.num_envs},) and a True, got {mask!r}")
        if self._batch is None and not mask.all():
            raise ResetNeeded("reset all environments before you reset some")
        return mask.copy()

    def step(self, actions: ArrayLike) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, Info]:
        """Takes a step in every environment, or begins an episode, as the autoreset mode says.

        Raises:
            ResetNeeded: `reset` was not called; without autoreset, also if an episode is over.
            ValueError: `actions` has another shape, no integers, or an action that does not exist.
        """
        if self._batch is None:
            raise ResetNeeded("step needs episodes: call reset first")
        is_same_step = self.autoreset_mode == AutoresetMode.SAME_STEP
        pending = self._ended & (self.autoreset_mode == AutoresetMode.NEXT_STEP)
        if self.autoreset_mode == AutoresetMode.DISABLED and self._ended.any():
            over = np.flatnonzero(self._ended).tolist()
            raise ResetNeeded(f"episodes of environments {over} are over: reset them with options['reset_mask']")
        batch, *outcome = episodes.advance_all(
            *(self.environment, self.params, is_same_step),
            *(self._batch, self._actions(actions), pending, self._next_keys.copy()),
        )
        final, (reward, terminated, truncated, info) = outcome[0], jax.device_get(outcome[1:])
        stepped = ~pending
        terminated, truncated = terminated & stepped, truncated & stepped
        self._batch, self._ended = batch, terminated | truncated
        infos = self._infos(info, stepped & ~(self._ended & is_same_step))
        if is_same_step and self._ended.any():
            infos |= self._final(final, info)
        self._draw_next_keys(self._ended if is_same_step else pending)
        return self._observation(), np.where(stepped, widened(reward), 0.0), terminated, truncated, infos

    def _actions(self, actions: ArrayLike) -> np.ndarray:
        array, most = np.asarray(actions), self.environment.num_actions - 1
        if array.shape != (self.num_envs,) or array.dtype.kind not in "iu":
            raise ValueError(f"actions must be {self.num_envs} integers, got {array.dtype} of shape {array.shape}")
        if array.min() < 0 or array.max() > most:
            raise ValueError(f"actions must be from 0 to {most}, got {array.min()} to {array.max()}")
        return array.astype(np.int32)

    def _draw_next_keys(self, which: np.ndarray) -> None:
        for i in np.flatnonzero(which).tolist():
            self._next_keys[i] = episodes.draw_key(self._generators[i][0])

    def _observation(self) -> Observation:
        assert self._batch is not None
        return as_element(self.observation_space, jax.device_get(self._batch.observation))

    def _infos(self, info: dict[str, np.ndarray], which: np.ndarray) -> Info:
        """Infos of a step in the environments `which`, each with the mask of those that have it."""
        infos: Info = {}
        for name, values in info.items() if which.any() else ():
            wide = widened(values)
            wide[~which] = 0
            infos |= {name: wide, f"_{name}": which.copy()}
        return infos

    def _final(self, observation: Observation, info: dict[str, np.ndarray]) -> Info:
        """The last observation and info of the episodes that have just ended."""
        last, ended = jax.device_get(observation), self._ended
        final_obs = np.full(self.num_envs, None, object)
        for i in np.flatnonzero(ended).tolist():
            final_obs[i] = as_element(self.single_observation_space, entry(last, i))
        return {
            "final_obs": final_obs,
            "_final_obs": ended.copy(),
            "final_info": self._infos(info, ended),
            "_final_info": ended.copy(),
        }

    def render(self) -> tuple[str | np.ndarray, ...] | None:
        """The pictures of all states in the environment's `render_mode`."""
        if self.render_mode is None:
            gymnasium.logger.warn("render needs a render_mode, for example make_vec(id, render_mode='ansi')")
            return None
        if self._batch is None:
            raise ResetNeeded("render needs states: call reset first")
        states = self._batch.state
        return tuple(self.environment.render(entry(states, i), self.render_mode) for i in range(self.num_envs))
