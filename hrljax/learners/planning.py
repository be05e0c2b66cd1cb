"""Value iteration on a model that a learner has made."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import Array, lax


def settled(sweep: Callable[[Array], Array], start: Array, tolerance: Array, most: Array | int) -> Array:
    """Values after sweeps until one changes none by more than a tolerance.

    Args:
        sweep: from values to new ones.
        start: float32, where sweeps begin.
        tolerance: float32.
        most: sweeps at most, int32.
    """

    def again(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        values, _, count = carry
        new = sweep(values)
        return new, jnp.abs(new - values).max(), count + 1

    begin = start, jnp.float32(np.inf), jnp.int32(0)
    return lax.while_loop(lambda carry: (carry[1] > tolerance) & (carry[2] < most), again, begin)[0]
