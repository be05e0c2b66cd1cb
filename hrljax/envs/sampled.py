"""Checks by random episodes, for environments with too many outcomes to look at each of them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core import contract
from hrljax.core.environment import AnyDynamics, EpisodeState, Numbers, Words, is_tabular
from hrljax.core.random import WORD_RANGE
from hrljax.envs.occurring import allowed_numbers, check_range, outside

_EPISODES, _STEPS = 32, 128
"""Most random episodes for all `params` together, and most steps of one."""


class _Seen(NamedTuple):
    """What is checked of a step; state numbers are 0 unless the environment is tabular."""

    reward: Array  # float32
    amounts: Array  # [events] float32
    terminated: Array  # bool
    number: Array  # int32: of the next state
    renumbered: Array  # int32: encode(decode(number))


def check_sampled_steps(env: AnyDynamics, points: tuple[Numbers, ...]) -> None:
    """Raises if a step of a random episode makes no sense, under any of several `params`.

    Raises:
        ValueError: a number outside of the range of states or that decodes to another state, a reward
            or an event that is not finite.
    """
    limit = points[0].max_steps

    # A single step is compiled, not an episode, because that takes the least time.
    @jax.jit
    def begin(numbers: Numbers, words: Words) -> tuple[EpisodeState, Array]:
        first = contract.initial(env, words, numbers._replace(max_steps=limit))
        return first, _number(env, first)

    @jax.jit
    def step(numbers: Numbers, state: EpisodeState, action: Array, words: Words) -> tuple[EpisodeState, _Seen]:
        numbers = numbers._replace(max_steps=limit)
        after, reward, terminated, info = contract.transition(env, state, action, words, numbers)
        amounts = [info[name].astype(jnp.float32) for name in env.metrics]
        stacked, number = jnp.stack(amounts) if amounts else jnp.zeros(0, jnp.float32), _number(env, after)
        again = contract.encode(env, contract.decode(env, number)) if is_tabular(env) else number
        return after, _Seen(reward, stacked, terminated, number, again)

    generator = np.random.default_rng(0)
    with jax.ensure_compile_time_eval():
        for params in (params for params in points for _ in range(max(1, _EPISODES // len(points)))):
            state, number = begin(params, _words(generator, env.num_initial_words))
            if is_tabular(env):
                check_range(env, np.asarray(number)[None])
            for time in range(min(limit, _STEPS)):
                action = generator.integers(env.num_actions, dtype=np.int32)
                place = f"from state {number}" if is_tabular(env) else f"in step {time + 1} of an episode"
                state, seen = step(params, state, action, _words(generator, env.num_words))
                _check_seen(env, jax.device_get(seen), f"{place} by action {env.action_names[action]!r}")
                number = seen.number
                if seen.terminated:
                    break


def _words(generator: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    return tuple(generator.integers(WORD_RANGE, size=count, dtype=np.uint32))


def _number(env: AnyDynamics, state: EpisodeState) -> Array:
    return contract.encode(env, state) if is_tabular(env) else jnp.int32(0)


def _check_seen(env: AnyDynamics, seen: _Seen, place: str) -> None:
    if is_tabular(env) and outside(env, seen.number):
        raise ValueError(f"{env.name}: {allowed_numbers(env)}, got {seen.number} {place}")
    if seen.number != seen.renumbered:
        wrong = f"encode(decode({seen.number})) must be {seen.number}, got {seen.renumbered}"
        raise ValueError(f"{env.name}: {wrong} {place}")
    events = (f"event {name!r}" for name in env.metrics)
    for name, value in (("reward", seen.reward), *zip(events, seen.amounts, strict=True)):
        if not np.isfinite(value):
            raise ValueError(f"{env.name}: transition must return a finite number as {name}, got {value} {place}")
