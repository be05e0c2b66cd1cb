"""Checks while a run is traced: that a learner gives back what it was given, in shapes and dtypes."""

from typing import Any

import chex
import jax
import jax.numpy as jnp


def check_given_back(method: str, given: chex.ArrayTree, returned: chex.ArrayTree) -> None:
    """Raises unless a method has returned a pytree as it was given, each array with its shape and dtype.

    Args:
        method: for messages, such as ``"MyLearner: learn"``.
        given: what the loop has carried up to here.
        returned: what it is to carry on.

    Raises:
        TypeError: names the method, the first field that differs, and how.
    """
    before, after = (dict(jax.tree_util.tree_flatten_with_path(tree)[0]) for tree in (given, returned))
    for path in {**before, **after}:
        field = jax.tree_util.keystr(path).lstrip(".") or "the whole"
        if path not in after or path not in before:
            fault = "is missing" if path not in after else "was not given"
            raise TypeError(f"{method} must return the same fields as it was given: {field} {fault}")
        was, now = _described(before[path]), _described(after[path])
        if was != now:
            raise TypeError(f"{method} must return arrays as they were given: {field} was {was}, now it is {now}")


def _described(array: Any) -> str:
    dtype = jnp.result_type(array)
    return f"{dtype.name} {list(jnp.shape(array))}"
