"""Episodes as functions of one key each, for one environment and for a batch: what the Gymnasium adapters run.

A key is two uint32 words. An episode draws its beginning from ``fold_in(key, 0)`` and its step number
t from ``fold_in(key, t)``, so that an environment alone and in a batch goes through the same states.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.environment import EpisodeState, Numbers
from hrljax.envs.base import AnyEnvironment, Environment, numbers_of
from hrljax.envs.registry import make

Env = AnyEnvironment
Observation: TypeAlias = Any
"""What an agent sees: an array, or a tree of them, as the environment's space says."""
Step: TypeAlias = tuple[Any, ...]
"""Observation, state, reward, terminated, truncated, info."""
Params: TypeAlias = "Mapping[str, float] | Numbers | None"
"""Numbers of an environment as users give them: some as a mapping, or all as a NamedTuple."""


class Batch(NamedTuple):
    """N episodes."""

    key: Array  # [N, 2] uint32
    state: EpisodeState  # every leaf [N, ...]
    observation: Observation  # every leaf [N, ...]


def made(environment: str | Env, params: Params, options: Mapping[str, object]) -> tuple[Env, Numbers]:
    """An environment and its numbers.

    Args:
        environment: the environment, or the name of a registered one.
        params: all its numbers as a NamedTuple, some of them as a mapping, or None.
        options: of the environment; none if it is made already.

    Raises:
        TypeError, ValueError: an option or a number is unknown or has a bad value.
    """
    if isinstance(environment, Environment):
        if options:
            raise TypeError(f"options are for environments that are given by name, got {', '.join(options)}")
        env = environment
    else:
        env = make(environment, **options)
    if isinstance(params, Mapping):
        numbers = env.default_params
        if unknown := set(params) - set(numbers._asdict()):
            names = ", ".join(sorted(unknown))
            raise ValueError(f"params of {env.name} must be among {', '.join(numbers._asdict())}, got {names}")
        params = numbers._replace(**params)
    return env, numbers_of(env, params)


def draw_key(generator: np.random.Generator) -> np.ndarray:
    """The key of the next episode."""
    return generator.integers(0, 1 << 32, 2, np.uint32)


def _nth_key(key: Array, n: Array | int) -> Array:
    return jax.random.fold_in(jax.random.wrap_key_data(key, impl="threefry2x32"), n)


def _begin(env: Env, params: Numbers, key: Array) -> tuple[Observation, EpisodeState]:
    return env.reset(_nth_key(key, 0), params)


def _advance(env: Env, params: Numbers, key: Array, state: EpisodeState, action: Array) -> Step:
    return env.step(_nth_key(key, state.time + 1), state, action, params)


begin = jax.jit(_begin, static_argnums=(0, 1))
"""``obs, state`` of an episode, from its key."""
advance = jax.jit(_advance, static_argnums=(0, 1))
"""``obs, state, reward, terminated, truncated, info`` of one step of an episode with a key."""


def _begin_all(env: Env, params: Numbers, keys: Array) -> Batch:
    observation, state = jax.vmap(partial(_begin, env, params))(keys)
    return Batch(keys, state, observation)


def _begin_some(env: Env, params: Numbers, batch: Batch, which: Array, keys: Array) -> Batch:
    def pick(new: Array, old: Array) -> Array:
        return jnp.where(which.reshape(-1, *(1,) * (new.ndim - 1)), new, old)

    return lax.cond(which.any(), lambda: jax.tree.map(pick, _begin_all(env, params, keys), batch), lambda: batch)


def _advance_all(
    env: Env, params: Numbers, same_step: bool, batch: Batch, actions: Array, pending: Array, keys: Array
) -> tuple[Batch, Observation, Array, Array, Array, dict[str, Array]]:
    one = jax.vmap(partial(_advance, env, params))
    observation, state, reward, terminated, truncated, info = one(batch.key, batch.state, actions)
    after = Batch(batch.key, state, observation)
    after = _begin_some(env, params, after, terminated | truncated if same_step else pending, keys)
    return after, observation, reward, terminated, truncated, info


begin_all = jax.jit(_begin_all, static_argnums=(0, 1))
"""A batch of episodes from their keys ``[N, 2]``."""
begin_some = jax.jit(_begin_some, static_argnums=(0, 1))
"""A batch with new episodes in place of some (``[N]`` bool), from keys ``[N, 2]``."""
advance_all = jax.jit(_advance_all, static_argnums=(0, 1, 2))
"""A step of a batch, and new episodes where old ones are over.

With `same_step`, new episodes replace those that end in this step; else those in `pending` (``[N]``
bool), which take no step. Returns the batch after that, and of the step, before any new episode:
observation, reward, terminated, truncated, info. What it returns for `pending` ones is of no use.
"""
