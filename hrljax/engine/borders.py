"""Checks while a run is traced: that a learner gives back what it was given, in shapes and dtypes."""

from typing import Any

import chex
import jax
import jax.numpy as jnp
from jax import Array

from hrljax.learners.base import AnyLearner, LearnerState, Reported


def check_learned(learner: AnyLearner, given: LearnerState, learned: Any) -> tuple[LearnerState, tuple[Array, ...]]:
    """What `learn` has returned: the learner's state, and what it reports of the step.

    Raises:
        TypeError: it is neither, or its arrays are not as they were given; names the class and the field.
    """
    method, names = f"{type(learner).__name__}: learn", learner.reports
    state, report = learned if isinstance(learned, Reported) else (learned, ())
    if not isinstance(state, LearnerState):
        raise TypeError(f"{method} must return a LearnerState, got a {type(state).__name__}")
    if len(report) != len(names):
        raise TypeError(f"{method} must report a number for each of {names}, got {len(report)}")
    check_given_back(method, given, state)
    for name, number in zip(names, report, strict=True):
        if jnp.shape(number):
            raise TypeError(f"{method} must report one number as {name!r}, got {_described(number)}")
    return state, tuple(jnp.asarray(number, jnp.float32) for number in report)


def check_given_back(method: str, given: chex.ArrayTree, returned: chex.ArrayTree) -> None:
    """Raises unless a method has returned a pytree as it was given, each array with its shape and dtype.

    Args:
        method: for messages, such as ``"MyLearner: learn"``.
        given: what the loop has carried up to now.
        returned: what it is to carry on.

    Raises:
        TypeError: names the method, the first field that differs, and how.
    """
    before, after = (_by_field(tree) for tree in (given, returned))
    for field in {**before, **after}:
        if field not in after or field not in before:
            fault = "is missing" if field not in after else "was not given"
            raise TypeError(f"{method} must return the same fields as it was given: {field} {fault}")
        was, now = _described(before[field]), _described(after[field])
        if was != now:
            raise TypeError(f"{method} must return arrays as they were given: {field} was {was}, now it is {now}")


def _by_field(tree: chex.ArrayTree) -> dict[str, Any]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path).lstrip(".") or "what it returns": leaf for path, leaf in leaves}


def _described(array: Any) -> str:
    return f"{jnp.result_type(array).name} {list(jnp.shape(array))}"
