"""Environments by name."""

import inspect
import re
from collections.abc import Callable
from typing import Any

import gymnasium

from hrljax.core import checks
from hrljax.envs.base import AnyEnvironment
from hrljax.envs.boyan import BoyanChain
from hrljax.envs.bus.env import Bus
from hrljax.envs.grid.gridworld import Gridworld
from hrljax.envs.grid.maze import Maze
from hrljax.envs.mario.env import Mario
from hrljax.envs.taxi.env import Taxi

_ENVIRONMENTS: dict[str, Callable[..., AnyEnvironment]] = {}


def register(name: str, make: Callable[..., AnyEnvironment]) -> None:
    """Makes an environment known to `make`, and to Gymnasium as ``hrljax/<name>-v0``.

    Raises:
        TypeError: the name is no string, or `make` cannot be called.
        ValueError: the name is taken, or has other characters than letters, digits, ``_``, ``-`` and ``.``.
    """
    checks.text("name", name, "'MyWorld'")
    if not callable(make):
        raise TypeError(f"make must be a function that returns an environment, such as its class, got {make!r}")
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


def make(name: str, **options: object) -> Any:
    """An environment by name, for example ``make("Bus", site="cell")``.

    Raises:
        TypeError: the name is no string, or there is no such option; the message lists those that there are.
        ValueError: an unknown name; the message lists the known ones.
    """
    checks.text("name", name, "'Bus'")
    if name not in _ENVIRONMENTS:
        raise ValueError(f"unknown environment {name!r}; known are {', '.join(registered())}")
    _check_options_known(name, options)
    return _ENVIRONMENTS[name](**options)


def _check_options_known(name: str, options: dict[str, object]) -> None:
    """Raises TypeError for an option that the environment does not have; says so if it is one of its numbers."""
    parameters = inspect.signature(_ENVIRONMENTS[name]).parameters
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values()):
        return
    unknown = [option for option in options if option not in parameters]
    if not unknown:
        return
    known = {option: value for option, value in options.items() if option in parameters}
    numbers = _ENVIRONMENTS[name](**known).default_params._fields
    if unknown[0] in numbers:
        raise TypeError(
            f"{name} has no option {unknown[0]!r}: it is one of its numbers, which are given to what uses it, as "
            f"params=env.default_params._replace({unknown[0]}={options[unknown[0]]!r})"
        )
    raise TypeError(f"{name} has no option {unknown[0]!r}; its options are {', '.join(parameters) or 'none'}")


for _environment in (BoyanChain, Bus, Gridworld, Mario, Maze, Taxi):
    register(_environment.name, _environment)
