"""JAX's errors about values that are not known while a program is compiled, as one sentence each."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import PurePath

import jax

_NOT_KNOWN = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.NonConcreteBooleanIndexError,
)
_INTERNAL = ("jax", "jaxlib", "numpy", "contextlib")
"""Packages whose lines say nothing to the one who wrote the code that failed."""


@contextmanager
def explain_tracing(what: str) -> Iterator[None]:
    """Raises JAX's errors about traced arrays as a TypeError of one sentence that says what to write instead.

    Args:
        what: whose code runs inside, for example ``"Bus: transition"``; the sentence begins with it.
    """
    try:
        yield
    except Exception as error:
        advice = _advice(error)
        if advice is None:
            raise
        raise TypeError(f"{what} {advice}{_place(error)}") from None


def _advice(error: Exception) -> str | None:
    """What to tell of `error`; None unless it is about a traced array."""
    if isinstance(error, jax.errors.TracerBoolConversionError):
        return (
            "decides in Python by an array whose value is not known while the program is compiled: "
            "use jnp.where in place of if, and &, | and ~ in place of and, or and not"
        )
    if isinstance(error, jax.errors.UnexpectedTracerError):
        return (
            "uses an array that an earlier call left behind while it was compiled, in a cached property for example: "
            "keep NumPy arrays from call to call"
        )
    if isinstance(error, _NOT_KNOWN) or (isinstance(error, TypeError) and "Tracer" in str(error)):
        return (
            "gives Python or NumPy an array whose value is not known while the program is compiled: "
            "use jax.numpy, such as jnp.asarray(table)[index] in place of table[index] and jnp.where in place of if"
        )
    return None


def _place(error: Exception) -> str:
    """The line of the user's code that failed, in parentheses."""
    for frame, line in reversed(list(traceback.walk_tb(error.__traceback__))):
        if frame.f_globals.get("__name__", "").partition(".")[0] not in _INTERNAL:
            summary = traceback.FrameSummary(frame.f_code.co_filename, line, frame.f_code.co_name)
            return f" ({PurePath(summary.filename).name}, line {line}: {summary.line})"
    return ""
