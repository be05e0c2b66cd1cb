"""What is checked of the rows that trees are grown from."""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from hrljax.core import checks
from hrljax.trees.inputs import MAX_INPUTS

MAX_ROWS = 1 << 20
"""More would leave too few bits for a target (`hrljax.trees.growth.quantise`)."""


def check_categories(categories: tuple[int, ...], most: int) -> None:
    """Raises TypeError or ValueError unless the kinds of the inputs are such, of at most so many categories."""
    checks.instance("categories", categories, tuple, "a tuple of integers")
    if not 1 <= len(categories) <= MAX_INPUTS:
        raise ValueError(f"categories must describe 1 to {MAX_INPUTS} inputs, got {len(categories)}")
    for i, size in enumerate(categories):
        checks.integer(f"categories[{i}]", size, 0, most)


def check_rows(
    categories: tuple[int, ...],
    inputs: Array,
    targets: Array,
    group: Array,
    num_groups: int,
    count: Array,
    weights: Array | None = None,
) -> None:
    """Raises ValueError unless shapes, and values that are known, are those of rows for trees."""
    num_rows = len(inputs) if inputs.ndim else 0
    if inputs.shape != (num_rows, len(categories)) or not 1 <= num_rows <= MAX_ROWS:
        raise ValueError(
            f"inputs must have shape [N, {len(categories)}] with 1 to {MAX_ROWS} rows, got {list(inputs.shape)}"
        )
    if targets.ndim != 2 or len(targets) != num_rows or not targets.shape[1]:
        raise ValueError(f"targets must have a value for each of {num_rows} rows, got shape {list(targets.shape)}")
    for name, values in (("inputs", inputs), ("targets", targets)):
        if values.dtype != jnp.float32:
            raise ValueError(f"{name} must be float32, got {values.dtype}")
    if group.shape != (num_rows,) or group.dtype != jnp.int32:
        raise ValueError(f"group must be int32 of shape [{num_rows}], got {group.dtype} of {list(group.shape)}")
    checks.integer("num_groups", num_groups, 1, MAX_ROWS)
    if count.shape != () or not jnp.issubdtype(count.dtype, jnp.integer):
        raise ValueError(f"count must be one integer, got {count.dtype} of shape {list(count.shape)}")
    if weights is not None and (weights.shape != (num_rows,) or weights.dtype != jnp.float32):
        raise ValueError(f"weights must be float32 of shape [{num_rows}], got {weights.dtype} of {list(weights.shape)}")
    if any(isinstance(values, Tracer) for values in (inputs, targets, group, count, weights)):
        return
    if not 0 <= int(count) <= num_rows:
        raise ValueError(f"count must be in 0..{num_rows}, got {int(count)}")
    used = slice(0, int(count))
    if weights is not None and not (np.asarray(weights)[used] > 0).all():
        raise ValueError(f"weights must be above 0, got {np.asarray(weights)[used].min()}")
    _check_values(categories, np.asarray(inputs)[used], np.asarray(targets)[used], np.asarray(group)[used], num_groups)


def _check_values(
    categories: tuple[int, ...], inputs: np.ndarray, targets: np.ndarray, group: np.ndarray, num_groups: int
) -> None:
    for name, values in (("inputs", inputs), ("targets", targets)):
        if not np.isfinite(values).all():
            raise ValueError(f"{name} must be finite, got {values[~np.isfinite(values)][0]}")
    for i, size in enumerate(categories):
        wrong = inputs[:, i][~np.isin(inputs[:, i], np.arange(size))] if size else inputs[:0, i]
        if len(wrong):
            raise ValueError(f"inputs[:, {i}] must be whole numbers in 0..{size - 1}, got {wrong[0]:g}")
    if len(group) and not (group.min() >= 0 and group.max() < num_groups):
        raise ValueError(f"group must be in 0..{num_groups - 1}, got {group.min()}..{group.max()}")
