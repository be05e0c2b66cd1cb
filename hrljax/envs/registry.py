"""Environments by name."""

import re
from collections.abc import Callable
from typing import Any

import gymnasium

from hrljax.envs.base import Environment
from hrljax.envs.bus import Bus
from hrljax.envs.gridworld import Gridworld
from hrljax.envs.mario.env import Mario
from hrljax.envs.maze import Maze
from hrljax.envs.taxi import Taxi

_ENVIRONMENTS: dict[str, Callable[..., Environment[Any, Any]]] = {}


def register(name: str, make: Callable[..., Environment[Any, Any]]) -> None:
    """Makes an environment known to `make`, and to Gymnasium as ``hrljax/<name>-v0``.

    Raises:
        ValueError: the name is taken, or has other characters than letters, digits, ``_``, ``-`` and ``.``.
    """
    if not re.fullmatch(r"[\w.-]+", name):
        raise ValueError(f"name must consist of letters, digits, '_', '-' and '.', got {name!r}")
    if name in _ENVIRONMENTS:
        raise ValueError(f"an environment named {name!r} is registered already")
    _ENVIRONMENTS[name] = make
    adapters = "hrljax.interop.gymnasium"  # loaded when Gymnasium makes the first environment
    gymnasium.register(
        f"hrljax/{name}-v0",
        entry_point=f"{adapters}:SingleEnv",
        vector_entry_point=f"{adapters}:BatchedEnv",
        kwargs={"environment": name},
    )


def registered() -> tuple[str, ...]:
    """Names that `make` knows."""
    return tuple(sorted(_ENVIRONMENTS))


def make(name: str, **options: Any) -> Any:
    """An environment by name, for example ``make("Bus", site="cell")``.

    Raises:
        ValueError: an unknown name; the message lists the known ones.
    """
    if name not in _ENVIRONMENTS:
        raise ValueError(f"unknown environment {name!r}; known are {', '.join(registered())}")
    return _ENVIRONMENTS[name](**options)


for _environment in (Bus, Gridworld, Mario, Maze, Taxi):
    register(_environment.name, _environment)
