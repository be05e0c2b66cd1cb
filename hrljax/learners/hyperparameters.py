"""Hyper-parameters: numbers and schedules that a frozen dataclass declares, checks and lets be swept."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, Self, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from hrljax.core import checks
from hrljax.core.numerics import take
from hrljax.core.tracing_errors import explain_tracing

Schedule: TypeAlias = Callable[[Any], Any]
"""A number as a function of the episode's number, such as those of optax."""
Hyperparameter: TypeAlias = "float | Schedule | Array"


def hyperparameter(
    default: Any,
    low: float = -math.inf,
    high: float = math.inf,
    low_open: bool = False,
    schedule: bool = False,
    settings: "type[Settings] | None" = None,
) -> Any:
    """A dataclass field that may be swept, with the interval that it must lie in, as a finite float32.

    `schedule` allows a function of the episode, `settings` an object of a class whose own fields may be swept.
    """
    largest = checks.LARGEST_NUMBER
    interval = checks.Interval(max(low, -largest), min(high, largest), low_open)
    metadata = {"sweepable": True, "interval": interval, "schedule": schedule, "settings": settings}
    return dataclasses.field(default=default, metadata=metadata)


def later_option(default: Any) -> Any:
    """A keyword-only dataclass field that came to a learner later.

    It is no setting while it has its default, so that stores from before it existed still continue.
    """
    return dataclasses.field(default=default, kw_only=True, metadata={"came_later": True})


def report_option() -> Any:
    """A keyword-only dataclass field, False at first, that adds a column to results and changes nothing else."""
    return later_option(False)


@dataclasses.dataclass(frozen=True)
class Settings:
    """A frozen dataclass of hyper-parameters (numbers, may be swept) and static options.

    Each hyper-parameter is checked when it is a concrete number. Subclasses are dataclasses.
    """

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if field.metadata.get("sweepable"):
                self._set(field.name, _checked(type(self).__name__, field, getattr(self, field.name)))

    def _check_integer(self, option: str, least: int, most: int = checks.LARGEST_INTEGER) -> None:
        """Raises unless a static option is an integer from `least` to `most`."""
        self._set(option, checks.integer(f"{type(self).__name__}: {option}", getattr(self, option), least, most))

    def _check_flag(self, option: str) -> None:
        """Raises TypeError unless a static option is True or False."""
        checks.flag(f"{type(self).__name__}: {option}", getattr(self, option))

    def _check_choice(self, option: str, allowed: Any) -> None:
        """Raises ValueError unless a static option is one of some values, or of those of a literal type."""
        checks.choice(f"{type(self).__name__}: {option}", getattr(self, option), allowed)

    def _set(self, option: str, value: Any) -> None:
        object.__setattr__(self, option, value)

    def replaced(self, values: Mapping[str, Any]) -> Self:
        """A copy with some fields replaced; ``"root.step_size"`` reaches into a field that has fields."""
        changed: dict[str, Any] = {}
        for name, value in values.items():
            head, _, rest = name.partition(".")
            changed[head] = changed.get(head, getattr(self, head)).replaced({rest: value}) if rest else value
        return dataclasses.replace(self, **changed)

    def settings(self) -> dict[str, Any]:
        """Every field by name, nested ones with a dot; of options that came later those that have not their default."""
        by_name: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.metadata.get("came_later") and value == field.default:
                continue
            if isinstance(value, Settings):
                by_name[field.name] = type(value).__name__
                by_name |= {f"{field.name}.{name}": inner for name, inner in value.settings().items()}
            else:
                by_name[field.name] = value
        return by_name

    def sweepable(self) -> dict[str, float]:
        """The hyper-parameters that are numbers now, by name: those that an axis of a sweep may name."""
        by_name: dict[str, float] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Settings):
                by_name |= {f"{field.name}.{name}": inner for name, inner in value.sweepable().items()}
            elif field.metadata.get("sweepable") and not callable(value):
                by_name[field.name] = value
        return by_name


def _checked(owner: str, field: "dataclasses.Field[Any]", value: Any) -> Any:
    """A hyper-parameter's value, if it is a number in its interval, or a schedule where that is allowed."""
    name, takes_schedule, settings = (f"{owner}: {field.name}", *map(field.metadata.get, ("schedule", "settings")))
    if settings and isinstance(value, settings):
        return value
    if not callable(value):
        also = " or a schedule" if takes_schedule else ""
        also += f" or {settings.__name__}(...)" if settings else ""
        return checks.number(name, value, field.metadata["interval"], also=also, may_be_traced=True)
    if not takes_schedule:
        raise TypeError(f"{name} must be a number, not a schedule")
    return checks.function(name, value, "of the episode's number")


S = TypeVar("S", bound="Settings")


def with_tabulated_schedules(learner: S, num_episodes: int, first_episode: Any = 0) -> S:
    """The learner with every schedule replaced by the float32 table of its values, one per episode.

    Schedules are evaluated once, outside of compiled code, so that every mapping sees the same bits.

    Args:
        learner: the learner.
        num_episodes: how many episodes it will learn from.
        first_episode: how many it has learned from before; they are in the table too.

    Raises:
        TypeError: a schedule does not return one number, or cannot be traced by JAX; or there is one, and
            `first_episode` is not known before compilation.
        ValueError: a schedule leaves the interval of its hyper-parameter; names the episode.
    """
    tables: dict[str, Any] = {}
    for field in dataclasses.fields(learner):
        schedule = getattr(learner, field.name)
        if field.metadata.get("schedule") and callable(schedule):
            if isinstance(first_episode, Tracer):
                raise TypeError(
                    f"{type(learner).__name__}: {field.name} is a schedule, so the episodes of what training starts "
                    "from must be a number that is known before compilation"
                )
            what, last = f"the schedule of {type(learner).__name__}: {field.name}", int(first_episode) + num_episodes
            values = _at_all_episodes(what, schedule, last)
            for episode in (values.argmin(), values.argmax(), 0):
                try:
                    _checked(type(learner).__name__, field, values[episode])
                except ValueError as error:
                    raise ValueError(f"{error} by its schedule at episode {episode}") from None
            tables[field.name] = Tabulated(values)
    return dataclasses.replace(learner, **tables) if tables else learner


def _at_all_episodes(what: str, schedule: Schedule, num_episodes: int) -> np.ndarray:
    """``[episodes]`` float32: the values of a schedule, which messages call `what`."""

    def at(episode: Array) -> Array:
        value = schedule(episode)
        if not checks.is_number(value):
            raise TypeError(f"{what} must return one number for an episode, not {checks.returned(value)}")
        return jnp.asarray(value)

    with explain_tracing(what), jax.ensure_compile_time_eval():
        return np.asarray(jax.vmap(at)(jnp.arange(num_episodes, dtype=jnp.int32)), np.float32)


class Tabulated:
    """A schedule as a table; behaves as a schedule."""

    def __init__(self, values: np.ndarray):
        self.values = values  # [episodes] float32

    def __call__(self, episode: Array) -> Array:
        return take(jnp.asarray(self.values), episode)


def at_episode(value: Any, episode: Array) -> Any:
    """A hyper-parameter's value (float32 scalar, a constant if it is a plain number) in an episode."""
    if isinstance(value, Tabulated):
        return value(episode)
    return np.float32(value) if isinstance(value, int | float) else jnp.asarray(value, jnp.float32)
