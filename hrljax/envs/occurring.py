"""Which states of a tabular environment can occur, and whether their outcomes make sense."""

from typing import NamedTuple

import numpy as np
from jax import Array

from hrljax.core.environment import AnyTabularDynamics


class Outcomes(NamedTuple):
    """What every action leads to in every state, for each of N kinds of random words."""

    next_state: np.ndarray  # [S, A, N] int32
    reward: np.ndarray  # [S, A, N] float32
    flags: np.ndarray  # [S, A, N] int32: bit 0, the episode terminates; bit i, event i - 1 happens


def check_outcomes(
    env: AnyTabularDynamics, outcomes: Outcomes, firsts: np.ndarray, renumbered: np.ndarray
) -> tuple[Outcomes, np.ndarray]:
    """Raises if a state that occurs has an outcome that makes no sense.

    Args:
        env: the environment.
        outcomes: what every action leads to.
        firsts: the numbers of the states in which episodes begin.
        renumbered: ``[S]`` int32, ``encode(decode(i))`` of every number i.

    Returns:
        The outcomes; senseless ones of states that do not occur are replaced by an end of the episode
        with reward 0. ``[S]`` bool: states that occur and in which the episode goes on.

    Raises:
        ValueError: a next state without a number, a reward that is not finite, or a number that decodes
            to the state of another one.
    """
    check_range(env, firsts)
    goes_on, ends = reached(env, outcomes, firsts)
    wrong = np.flatnonzero((renumbered != np.arange(env.num_states)) & (goes_on | ends))
    if len(wrong):
        number = wrong[0]
        raise ValueError(f"{env.name}: encode(decode({number})) must be {number}, got {renumbered[number]}")
    infinite = ~np.isfinite(outcomes.reward)
    wrong = np.argwhere(infinite & goes_on[:, None, None])
    if len(wrong):
        state, action, kind = wrong[0]
        raise ValueError(
            f"{env.name}: transition must return a finite number as reward, got {outcomes.reward[state, action, kind]} "
            f"from state {state} by action {env.action_names[action]!r}"
        )
    senseless = infinite | outside(env, outcomes.next_state)
    if senseless.any():
        ended = zip(outcomes, (0, 0, 1), strict=True)
        outcomes = Outcomes(*(np.where(senseless, part.dtype.type(end), part) for part, end in ended))
    return outcomes, goes_on


def reached(env: AnyTabularDynamics, outcomes: Outcomes, firsts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``[S]`` bool each: states in which an episode can go on, and those in which one can end."""
    goes_on, ends = np.zeros((2, env.num_states), np.bool_)
    latest = np.unique(firsts)
    while len(latest):
        goes_on[latest] = True
        after, terminated = outcomes.next_state[latest], (outcomes.flags[latest] & 1) == 1
        wrong = np.argwhere(outside(env, after))
        if len(wrong):
            row, action, kind = wrong[0]
            raise ValueError(
                f"{env.name}: {allowed_numbers(env)}, got {after[row, action, kind]} from state {latest[row]} "
                f"by action {env.action_names[action]!r}"
            )
        ends[after[terminated]] = True
        following = np.unique(after[~terminated])
        latest = following[~goes_on[following]]
    return goes_on, ends


def check_range(env: AnyTabularDynamics, firsts: np.ndarray) -> None:
    """Raises if an episode begins in a state without a number."""
    wrong = firsts[outside(env, firsts)]
    if len(wrong):
        raise ValueError(f"{env.name}: {allowed_numbers(env)}, got {wrong[0]} for a state that initial returns")


def outside(env: AnyTabularDynamics, numbers: np.ndarray | Array) -> np.ndarray:
    """Which numbers, an array of any shape, belong to no state (bool)."""
    values = np.asarray(numbers)
    return (values < 0) | (values >= env.num_states)


def allowed_numbers(env: AnyTabularDynamics) -> str:
    """The part of an error message that says what `encode` must return."""
    return f"encode must return a number in 0..{env.num_states - 1}"
