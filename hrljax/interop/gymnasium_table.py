"""Gymnasium environments with a transition table as environments of this library."""

import math
import sys
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from hrljax.core import checks
from hrljax.envs.table import Table, TableEnvironment
from hrljax.solvers.model import Model

_DEFAULT_MAX_STEPS = 1000


def from_table(
    env: gymnasium.Env[Any, Any] | str,
    *,
    initial: np.ndarray | None = None,
    max_steps: int | None = None,
    action_names: Sequence[str] = (),
) -> TableEnvironment:
    """Makes an environment with discrete spaces and a table ``P`` one that can be solved and learned in.

    ``P[state][action]`` lists tuples (probability, next state, reward, terminated), as in Gymnasium's
    FrozenLake, CliffWalking and Taxi. What `env` does outside its table is lost.

    Args:
        env: the environment or its id; wrappers are looked through.
        initial: ``[S]`` probabilities of the first state; ``env.unwrapped.initial_state_distrib`` if None.
        max_steps: default limit of steps; that of the environment's spec if None, or 1000 without one.
        action_names: one for each action; if empty, the environment's own (``get_action_meanings``, or constants of
            its module such as FrozenLake's ``LEFT``), or else their numbers.

    Raises:
        TypeError: the spaces are not discrete from 0 on, there is no table, or `initial` is needed.
        ValueError: an entry of the table is missing or makes no distribution.
    """
    checks.instance("env", env, (gymnasium.Env, str), "a Gymnasium environment or its id")
    env = gymnasium.make(env) if isinstance(env, str) else env
    source: Any = env.unwrapped
    name = type(source).__name__ if env.spec is None else env.spec.id
    sizes = [_size(name, field, getattr(source, field, None)) for field in ("observation_space", "action_space")]
    if not hasattr(source, "P"):
        raise TypeError(f"env must have a transition table env.unwrapped.P; {name} has none")
    if initial is None:
        if not hasattr(source, "initial_state_distrib"):
            raise TypeError(f"initial must be given, for {name} has no env.unwrapped.initial_state_distrib")
        initial = source.initial_state_distrib
    if max_steps is not None:
        checks.integer("max_steps", max_steps, 1)
    else:
        limit = None if env.spec is None else env.spec.max_episode_steps
        max_steps = _DEFAULT_MAX_STEPS if limit is None else limit
    model = _model(name, source.P, sizes[0], sizes[1])
    names = tuple(action_names) or _names_of_actions(source, sizes[1])
    table = Table(model, np.asarray(initial))
    shape = _shape_of(source, sizes[0])
    return TableEnvironment(table, name=name, max_steps=max_steps, action_names=names, shape=shape)


def _shape_of(source: Any, num_states: int) -> tuple[int, int] | None:
    """Rows and columns where states are cells, as in FrozenLake (``nrow``, ``ncol``) and CliffWalking (``shape``)."""
    shape: Any = getattr(source, "shape", (getattr(source, "nrow", None), getattr(source, "ncol", None)))
    is_pair = isinstance(shape, tuple) and len(shape) == 2 and all(isinstance(size, int) for size in shape)
    return shape if is_pair and min(shape) > 0 and math.prod(shape) == num_states else None


def _names_of_actions(source: Any, count: int) -> tuple[str, ...]:
    """Names that an environment gives its actions; none if it does not.

    Gymnasium's have a method for them, or constants in their module, such as ``LEFT = 0``.
    """
    if hasattr(source, "get_action_meanings"):
        return tuple(map(str, source.get_action_meanings()))
    constants = [
        (name.lower(), value)
        for name, value in vars(sys.modules[type(source).__module__]).items()
        if name.isupper() and type(value) is int
    ]
    named = [[name for name, value in constants if value == action] for action in range(count)]
    return tuple(name for (name,) in named) if all(len(names) == 1 for names in named) else ()


def _size(name: str, field: str, space: object) -> int:
    if not isinstance(space, spaces.Discrete) or space.start != 0:
        raise TypeError(f"{field} of {name} must be Discrete and start at 0, got {space}")
    return int(space.n)


def _model(name: str, table: Any, num_states: int, num_actions: int) -> Model:
    try:
        rows = [[list(table[state][action]) for action in range(num_actions)] for state in range(num_states)]
    except (KeyError, IndexError) as error:
        raise ValueError(f"P of {name} must have all {num_states} states and {num_actions} actions") from error
    if not all(row for of_state in rows for row in of_state):
        raise ValueError(f"P of {name} must have an outcome for every state and action")
    longest = max(len(row) for of_state in rows for row in of_state)
    # A row that is shorter than others repeats its last outcome with probability 0.
    padded = [[[*row, *[(0.0, *row[-1][1:])] * (longest - len(row))] for row in of_state] for of_state in rows]
    columns = np.array(padded, np.float64)  # [S, A, K, 4]
    probability, next_state, reward, terminated = np.moveaxis(columns, -1, 0)
    return Model.merged(next_state.astype(np.int32), reward, terminated != 0, probability)
