"""Checks of arguments: an error names the argument, what is allowed and what was given.

What is of the wrong kind raises TypeError, what is of the right kind but not allowed ValueError. Checks of numbers
return them plain: NumPy's scalars and arrays without dimensions are numbers too, ``True`` is not.
"""

import inspect
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

T = TypeVar("T")

LARGEST_INTEGER = 2**31 - 1
LARGEST_NUMBER = float(np.finfo(np.float32).max)
_ARRAYS = jax.Array | np.ndarray | np.generic
_OF_PYTHON = ((bool, np.dtype(np.bool_)), (int, np.dtype(np.int32)), (float, np.dtype(np.float32)))
_LONGEST_VALUE = 200
"""Characters of a value that a message shows."""


@dataclass(frozen=True)
class Interval:
    """An interval of numbers that are finite as float32."""

    low: float = -LARGEST_NUMBER
    high: float = LARGEST_NUMBER
    low_open: bool = False
    high_open: bool = False

    def __contains__(self, value: Any) -> bool:
        """Whether a number lies inside, and still does when it is rounded to float32."""
        try:
            numbers = (float(value), _single(value))
        except OverflowError:  # an integer that is too large for a float
            return False
        return all(
            (self.low < number if self.low_open else self.low <= number)
            and (number < self.high if self.high_open else number <= self.high)
            for number in numbers
        )

    def __str__(self) -> str:
        low, high = (f"{end:.2g}" if abs(end) == LARGEST_NUMBER else f"{end:g}" for end in (self.low, self.high))
        return f"{'(' if self.low_open else '['}{low}, {high}{')' if self.high_open else ']'}"


ANY_NUMBER = Interval()
NOT_NEGATIVE = Interval(0)
SHARE = Interval(0, 1)
PROPER_SHARE = Interval(0, 1, low_open=True, high_open=True)


def _single(value: Any) -> float:
    with np.errstate(over="ignore", under="ignore"):
        return float(np.float32(value))


def described(value: Any) -> str:
    """A value as one line of text, cut off where it is long; of traced values only type and shape."""
    if isinstance(value, np.number) or (isinstance(value, jax.Array) and not value.shape):
        value = value if isinstance(value, Tracer) else _Text(str(value))
    line = " ".join(part.strip() for part in repr(_without_traced(value)).splitlines())
    return line if len(line) <= _LONGEST_VALUE else line[:_LONGEST_VALUE] + "..."


def _without_traced(value: Any) -> Any:
    """The value with descriptions in the place of traced ones."""
    if isinstance(value, Tracer):
        return _Text(f"a traced {value.dtype}{list(value.shape)}")
    if isinstance(value, dict):
        return {key: _without_traced(entry) for key, entry in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_make"):
        return value._make(map(_without_traced, value))  # type: ignore[attr-defined]
    return type(value)(map(_without_traced, value)) if type(value) in (list, tuple) else value


class _Text:
    """Something that is represented by a text."""

    def __init__(self, text: str):
        self._text = text

    def __repr__(self) -> str:
        return self._text


def returned(value: object) -> str:
    """What a function gave, as text; of arrays only type and shape, because JAX traces them."""
    return f"{value.dtype}{list(value.shape)}" if isinstance(value, jax.Array | np.ndarray) else repr(value)


def type_in_words(value: object) -> str:
    """The type of an array, with its shape if it has one; what is short by its value, other objects by their class."""
    if isinstance(value, _ARRAYS):
        return f"{value.dtype.name} of shape {list(value.shape)}" if np.ndim(value) else value.dtype.name
    return repr(value) if value is None or isinstance(value, bool | int | float | str) else f"a {type(value).__name__}"


def dtype_of(value: object) -> np.dtype[Any] | None:
    """The type of an array of numbers or of one of Python's numbers, as JAX holds it; None of anything else."""
    if isinstance(value, _ARRAYS):
        return value.dtype if getattr(value.dtype, "kind", "O") not in "OSUMm" else None
    return next((dtype for kind, dtype in _OF_PYTHON if isinstance(value, kind)), None)


def dtype_of_scalar(value: object) -> np.dtype[Any] | None:
    """The same of one number; None of an array with dimensions too."""
    return dtype_of(value) if not isinstance(value, _ARRAYS) or value.shape == () else None


def is_number(value: Any, kind: Any = np.number) -> bool:
    """Whether a value is one real number (of a kind such as ``np.integer``)."""
    dtype = dtype_of_scalar(value)
    return dtype is not None and jnp.issubdtype(dtype, kind) and not jnp.issubdtype(dtype, np.complexfloating)


def _plain(value: Any) -> Any:
    """A number without an array around it."""
    is_array = isinstance(value, jax.Array | np.ndarray) and not isinstance(value, Tracer)
    return np.asarray(value)[()] if is_array else value


def integer(
    name: str,
    value: Any,
    least: int = 0,
    most: int = LARGEST_INTEGER,
    *,
    meaning: str = "",
    may_be_traced: bool = False,
) -> Any:
    """The value as an int, if it is an integer from `least` to `most`.

    Args:
        name: of the argument.
        value: what was given.
        least, most: what is allowed.
        meaning: what the message says of these numbers.
        may_be_traced: whether a traced integer passes, whatever it may be.
    """
    is_integer, is_traced = is_number(value, np.integer), isinstance(value, Tracer)
    if is_integer and is_traced and may_be_traced:
        return value
    if is_integer and not is_traced and least <= int(value) <= most:
        return int(value)
    explained = f" ({meaning})" if meaning else ""
    message = f"{name} must be an integer from {least} to {most}{explained}, got {described(value)}"
    if is_traced and not may_be_traced:
        raise TypeError(f"{message}; where jax.jit traces arguments, this one has to be static (static_argnames)")
    raise ValueError(message) if is_integer else TypeError(message)


def odd(name: str, value: Any, most: int = LARGEST_INTEGER) -> int:
    """The value as an int, if it is an odd integer from 1 to `most`."""
    message = f"{name} must be an odd integer from 1 to {most}, got {described(value)}"
    if not is_number(value, np.integer) or isinstance(value, Tracer):
        raise TypeError(message)
    if not 1 <= int(value) <= most or int(value) % 2 == 0:
        raise ValueError(message)
    return int(value)


def number(
    name: str, value: Any, interval: Interval = ANY_NUMBER, *, also: str = "", may_be_traced: bool = False
) -> Any:
    """The value, if it is a number in an interval.

    Args:
        name: of the argument.
        value: what was given.
        interval: what is allowed.
        also: what the message says is allowed too.
        may_be_traced: whether a traced number passes, whatever it may be.
    """
    if not is_number(value) or (isinstance(value, Tracer) and not may_be_traced):
        raise TypeError(f"{name} must be a number{also}, got {described(value)}")
    if not isinstance(value, Tracer) and value not in interval:
        finite = "finite " * math.isfinite(interval.high - interval.low)
        raise ValueError(f"{name} must be a {finite}number in {interval}, got {described(value)}")
    return _plain(value)


def choice(name: str, value: Any, allowed: Any) -> Any:
    """The value, if it is one of some, or of those of a literal type."""
    values = get_args(allowed) or tuple(allowed)
    if not (value is None or isinstance(value, str | bool | int | float | np.generic)) or value not in values:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, values))}, got {described(value)}")
    return value


def flag(name: str, value: Any) -> bool:
    """The value, if it is True or False."""
    return bool(choice(name, value, (False, True)))


def instance(name: str, value: Any, kind: type[T] | tuple[type[T], ...], allowed: str) -> T:
    """The value, if it is of a kind, of which `allowed` tells."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be {allowed}, got {described(value)}")
    return value


def text(name: str, value: Any, such_as: str) -> str:
    """The value, if it is a string."""
    return instance(name, value, str, f"a string such as {such_as}")


def sequence_of(name: str, values: Any, kind: type[T], what: str) -> tuple[T, ...]:
    """The values as a tuple, if they are of a kind, of which `what` tells, and not a single one."""
    is_sequence = isinstance(values, Iterable) and not isinstance(values, str | Mapping)
    entries = tuple(values) if is_sequence else (None,)
    if not all(isinstance(entry, kind) for entry in entries):
        raise TypeError(f"{name} must be a sequence of {what}, got {described(values)}")
    return entries  # type: ignore[return-value]


def names(name: str, values: Any) -> tuple[str, ...]:
    """The values as a tuple, if they are strings, and not a single one."""
    return sequence_of(name, values, str, "names")


def path(name: str, value: Any) -> Path:
    """The value as a path, if it is a string or a path."""
    return Path(instance(name, value, (str, PathLike), "a path: a string or a pathlib.Path"))


def function(name: str, value: Any, what: str, num_arguments: int = 1) -> Any:
    """The value, if it can be called with some arguments; `what` tells what it is a function of."""
    if not callable(value):
        raise TypeError(f"{name} must be a function {what}, got {described(value)}")
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):  # of some that are written in C
        return value
    try:
        signature.bind(*range(num_arguments))
    except TypeError:
        raise TypeError(f"{name} must be a function {what}, got one with the arguments {signature}") from None
    return value


def probabilities(name: str, value: Any, size: int) -> np.ndarray:
    """The values as float64 ``[size]``, if they are probabilities that sum to one."""
    array = as_array(name, value, np.floating, (size,), "probabilities").astype(np.float64)
    if not (array.min(initial=0) >= 0 and abs(array.sum() - 1) <= 1e-6):
        raise ValueError(f"{name} must have no negative entry and sum to one, got a sum of {array.sum():.6g}")
    return array


def as_array(
    name: str, value: Any, kind: Any, shape: tuple[int | None, ...], what: str, *, may_be_traced: bool = False
) -> Any:
    """The value as an array, if it has the right entries and shape.

    Args:
        name: of the argument.
        value: what was given.
        kind: NumPy's kind of the entries; integers pass as ``np.floating``.
        shape: where None is any length.
        what: what the message calls the entries.
        may_be_traced: whether a traced array passes, whatever its entries may be.
    """
    expected = f"{name} must be {what} of shape {_shape(shape)}"
    try:
        array = value if isinstance(value, Tracer) and may_be_traced else np.asarray(value)
    except (ValueError, TypeError, jax.errors.JAXTypeError):  # rows of different lengths, or traced
        raise TypeError(f"{expected}, got {described(value)}") from None
    allowed = [kind, np.integer] if kind is np.floating else [kind]
    if not any(jnp.issubdtype(array.dtype, one) for one in allowed):
        raise TypeError(f"{expected}, got {described(value) if array.ndim == 0 else array.dtype}")
    if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{expected}, got shape {_shape(array.shape)}")
    return array


def _shape(shape: tuple[int | None, ...]) -> str:
    lengths = ["any" if length is None else str(length) for length in shape]
    return f"({', '.join(lengths)}{',' * (len(shape) == 1)})"
