"""What comes of acting at random, where an environment has too many outcomes to look at each of them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax import random
from hrljax.envs import contract
from hrljax.envs.occurring import allowed_numbers, check_range, outside

_EPISODES, _STEPS = 32, 128
_STEP_STREAM, _BEGIN_STREAM = 3, 4


class _Played(NamedTuple):
    """Steps of an episode."""

    goes_on: Any  # [steps] bool: the episode was not over before the step
    number: Any  # [steps] int32: of the state before the step; 0 unless the environment is tabular
    action: Any  # [steps] int32
    reward: Any  # [steps] float32
    amounts: Any  # [steps, events] float32
    next_number: Any  # [steps] int32
    renumbered: Any  # [steps] int32: encode(decode(next_number))


def check_sampled_steps(env: Any, points: tuple[Any, ...]) -> None:
    """Raises for a step of random episodes that makes no sense, under any of several `params`.

    Raises:
        ValueError: a number outside of the range of states or that decodes to another state, a reward
            or an event that is not finite.
    """
    limit = points[0].max_steps

    @jax.jit
    def play(numbers: Any) -> _Played:
        keys = jax.random.split(jax.random.key(0), _EPISODES)
        return lax.map(lambda key: _episode(env, numbers._replace(max_steps=limit), random.key_words(key)), keys)

    for params in points:
        with jax.ensure_compile_time_eval():
            played = jax.tree.map(np.asarray, play(params))
        _check_played(env, played)


def _episode(env: Any, params: Any, key: tuple[Array, Array]) -> _Played:
    def number_of(state: Any) -> Array:
        return contract.encode(env, state) if env.is_tabular else jnp.int32(0)

    def renumbered(number: Array) -> Array:
        return contract.encode(env, contract.decode(env, number)) if env.is_tabular else number

    def step(carry: tuple[Any, Array], position: Array) -> tuple[tuple[Any, Array], _Played]:
        state, goes_on = carry
        *words, choice = random.words(key, position, env.num_words + 1, _STEP_STREAM)
        action = (choice % np.uint32(env.num_actions)).astype(jnp.int32)
        after, reward, terminated, info = contract.transition(env, state, action, tuple(words), params)
        amounts = [info[name].astype(jnp.float32) for name in env.metrics]
        stacked = jnp.stack(amounts) if amounts else jnp.zeros(0, jnp.float32)
        before, next_number = number_of(state), number_of(after)
        seen = _Played(
            goes_on & (position < params.max_steps),
            before,
            action,
            reward,
            stacked,
            next_number,
            renumbered(next_number),
        )
        return (after, goes_on & ~terminated), seen

    begin = random.words(key, jnp.uint32(0), env.num_initial_words, _BEGIN_STREAM)
    first = contract.initial(env, begin, params)
    return lax.scan(step, (first, jnp.bool_(True)), jnp.arange(_STEPS, dtype=jnp.uint32))[1]


def _check_played(env: Any, played: _Played) -> None:
    """Raises for the first step that makes no sense; fields are ``[episodes, steps]``."""
    steps = np.nonzero(played.goes_on)[1]
    taken = _Played(*(field[played.goes_on] for field in played))

    def refuse(wrong: np.ndarray, what: Callable[[int], str]) -> None:
        rows = np.flatnonzero(wrong)
        if len(rows):
            row = int(rows[0])
            action = env.action_names[taken.action[row]]
            place = f"from state {taken.number[row]}" if env.is_tabular else f"in step {steps[row] + 1} of an episode"
            raise ValueError(f"{env.name}: {what(row)} {place} by action {action!r}")

    if env.is_tabular:
        check_range(env, played.number[:, 0])
        after, again = taken.next_number, taken.renumbered
        refuse(outside(env, after), lambda row: f"{allowed_numbers(env)}, got {after[row]}")
        refuse(after != again, lambda row: f"encode(decode({after[row]})) must be {after[row]}, got {again[row]}")
    columns = {"reward": taken.reward, **{f"event {n!r}": taken.amounts[:, i] for i, n in enumerate(env.metrics)}}
    for name, column in columns.items():
        rule = f"transition must return a finite number as {name}"
        refuse(~np.isfinite(column), lambda row, rule=rule, column=column: f"{rule}, got {column[row]}")
