"""The axes of a sweep: names of hyper-parameters, and the values along each, or combinations of values."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence, Set
from typing import TypeAlias, TypeVar

import numpy as np
from jax.core import Tracer

from hrljax.core import checks
from hrljax.core.environment import Numbers
from hrljax.envs.base import concrete_params
from hrljax.learners.base import AnyLearner

Axes: TypeAlias = "dict[str, list[float]]"
"""By the name of a hyper-parameter: its values."""
Value = TypeVar("Value")

POINT = "point"
"""The dimension of combinations that form no grid."""
_OF_ENV = "env."


@dataclasses.dataclass(frozen=True)
class Points:
    """Combinations of hyper-parameters that form no grid, for `axes` of `hrljax.sweep`. Made by `points`.

    Attributes:
        values: by the name of a hyper-parameter, its value in each combination; all of one length.
    """

    values: Mapping[str, Sequence[float]]

    def __post_init__(self) -> None:
        checks.instance("values", self.values, Mapping, "a mapping such as {'step_size': [0.1, 0.2]}")
        lengths = {name: len(_numbers(name, values)) for name, values in self.values.items()}
        if len(set(lengths.values())) != 1:
            described = ", ".join(f"{name!r} {length}" for name, length in lengths.items()) or "none"
            raise ValueError(f"points: every hyper-parameter must have as many values as the others, got {described}")


def points(values: Mapping[str, Sequence[float]]) -> Points:
    """Combinations of hyper-parameters that form no grid: the first values of all, the second ones, and so on.

    For combinations that were drawn at random, from a Sobol sequence (`scipy.stats.qmc`), or that another program
    proposes. The result of `hrljax.sweep` then has a dimension ``point`` in place of one for each hyper-parameter, and
    the hyper-parameters are coordinates along it.

    Args:
        values: by the name of a hyper-parameter, its value in each combination, at least one.

    Raises:
        TypeError, ValueError: no mapping, no numbers, or lists of different lengths.
    """
    return Points(values)


def env_name(number: str) -> str:
    """The name in a sweep of one of the environment's numbers or options, such as ``"env.slip_probability"``."""
    return _OF_ENV + number


def is_of_env(name: str) -> bool:
    """Whether a hyper-parameter is one of the environment's numbers."""
    return name.startswith(_OF_ENV)


def of_learner(values: Mapping[str, Value]) -> dict[str, Value]:
    """Of values by the names of hyper-parameters, those of the learner."""
    return {name: value for name, value in values.items() if not is_of_env(name)}


def of_env(values: Mapping[str, Value]) -> dict[str, Value]:
    """Of values by the names of hyper-parameters, those of the environment, by the names that it has for them."""
    return {name.removeprefix(_OF_ENV): value for name, value in values.items() if is_of_env(name)}


def checked_axes(learner: AnyLearner, params: Numbers, axes: Mapping[str, Sequence[float]] | Points | None) -> Axes:
    """The axes as lists of floats, each value checked as the hyper-parameter would be.

    Args:
        learner: what learns.
        params: numbers of the environment.
        axes: as of `hrljax.sweep`.

    Raises:
        TypeError, ValueError: an axis that cannot be swept, or a value that is not allowed.
    """
    are_points = isinstance(axes, Points)
    given = axes.values if isinstance(axes, Points) else {} if axes is None else axes
    checks.instance("axes", given, Mapping, "a mapping such as {'step_size': [0.1, 0.2]}, or hrljax.points")
    names_of_learner = learner.sweepable()
    names_of_env = [env_name(field) for field in params._asdict() if field != "max_steps"]
    checked: Axes = {}
    for name, values in given.items():
        if name not in names_of_learner and name not in names_of_env:
            known = ", ".join([*names_of_learner, *names_of_env])
            is_limit = name == env_name("max_steps")
            why = ", for it only says where episodes are cut off: sweep once for each, with params" if is_limit else ""
            raise ValueError(f"axes: {name!r} cannot be swept{why}; sweepable are {known}")
        checked[name] = _numbers(name, values)
        if not checked[name] or (not are_points and len(set(checked[name])) < len(checked[name])):
            raise ValueError(f"axes: the values of {name!r} must be at least one and different, got {values!r}")
        for value in checked[name]:
            learner.replaced(of_learner({name: value}))
            concrete_params(params._replace(**of_env({name: value})))
    combinations = list(zip(*checked.values(), strict=True)) if are_points else []
    if len(set(combinations)) < len(combinations):
        raise ValueError("axes: the combinations of hrljax.points must be different, got one of them twice")
    return checked


def _numbers(name: str, values: object) -> list[float]:
    """The values of an axis, if they are numbers in an order."""
    if hasattr(values, "__array__") and not isinstance(values, Tracer):
        values = np.asarray(values)
    try:
        numbers = [None] if isinstance(values, str | bytes | Set | Mapping) else list(values)  # type: ignore[call-overload]
    except TypeError:  # it has no elements
        numbers = [None]
    if not all(checks.is_number(number) and not isinstance(number, Tracer) for number in numbers):
        described = checks.described(values)
        raise TypeError(f"axes: the values of {name!r} must be a sequence of numbers, got {described}")
    return [float(checks.number(f"axes: {name}", number)) for number in numbers]
