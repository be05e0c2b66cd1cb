"""How good a test of a classification tree is, from counts of classes, to the same bits under every mapping.

With n rows in a node, of which n_1 pass the test and n_0 do not, and n_c and n_ic of them of class c.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product

LOG_BITS = 10
_MANTISSA_BITS = 23


def gather(table: Array, index: Array) -> Array:
    """``table[index]`` of a vector, for indices (int32, any shape) that are inside."""
    return table.at[index].get(mode="promise_in_bounds")


def share_of(count: Array, rows: Array, zero: Array) -> Array:
    """``count / rows`` of whole numbers, 0 of no rows: times the reciprocal, as which XLA computes some divisions."""
    reciprocal = np.float32(1) / lax.max(rows, jnp.int32(1)).astype(jnp.float32)
    return exact_product(count.astype(jnp.float32), reciprocal, zero)


def gain_ratio(passing: Array, total: Array, n_1: Array, n: Array, zero: Array) -> Array:
    """Information that a test gives of the class, for each bit of its own (Quinlan 1993).

    ``[H(n_c) - H(n_1c) - H(n_0c)] / H(n_1, n_0)`` with ``H(m_1, m_2, ...) = sum_i m_i log2(m / m_i)``.

    Args:
        passing: ``[C]`` int32, the n_1c.
        total: ``[C]`` int32, the n_c.
        n_1, n: int32 scalars, ``0 < n_1 < n``.
        zero: see `hrljax.core.numerics.opaque_zero`.
    """

    def entropy(parts: Array, whole: Array) -> Array:
        """``sum_i m_i log2(m / m_i)``."""
        return n_log_n(whole, zero) - _in_order(n_log_n(parts, zero))

    failing, n_0 = total - passing, n - n_1
    gain = entropy(total, n) - entropy(passing, n_1) - entropy(failing, n_0)
    return gain / entropy(jnp.stack([n_1, n_0]), n)


def chi_squared(passing: Array, total: Array, n_1: Array, n: Array, zero: Array) -> Array:
    """How sure it is that test and class depend on each other: ``sum_ic (n_ic - n_i n_c / n)^2 / (n_i n_c / n)``.

    Arguments as of `gain_ratio`.
    """

    def expected(rows: Array) -> Array:
        share = share_of(rows, n, zero)
        return exact_product(jnp.broadcast_to(share, total.shape), total.astype(jnp.float32), zero)

    of_passing = expected(n_1)
    off = passing.astype(jnp.float32) - of_passing
    squared = exact_product(off, off, zero)
    terms = squared / of_passing + squared / expected(n - n_1)
    return _in_order(jnp.where(total > 0, terms, np.float32(0)))


def _in_order(values: Array) -> Array:
    """The sum of a short vector, number by number: in one order under every mapping."""
    total = values[0]
    for i in range(1, len(values)):
        total = total + values[i]
    return total


def n_log_n(n: Array, zero: Array) -> Array:
    """``n log2 n`` of whole numbers, float32, 0 for 0; of powers of two exact, and to the same bits everywhere.

    The logarithm of the mantissa is taken from a table, between two of whose entries it is nearly a straight line.
    """
    steps = 1 << LOG_BITS
    logs = np.log2(1 + np.arange(steps + 1) / steps).astype(np.float32)
    number = n.astype(jnp.float32)
    bits = lax.bitcast_convert_type(number, jnp.int32)
    exponent = (bits >> np.int32(_MANTISSA_BITS)) - np.int32(127)
    rest = _MANTISSA_BITS - LOG_BITS
    entry = (bits >> np.int32(rest)) & np.int32(steps - 1)
    beyond = (bits & np.int32((1 << rest) - 1)).astype(jnp.float32) * np.float32(2.0**-rest)
    slope = gather(jnp.asarray(np.diff(logs)), entry)
    log = exponent.astype(jnp.float32) + (gather(jnp.asarray(logs[:-1]), entry) + exact_product(beyond, slope, zero))
    return jnp.where(n > 0, exact_product(number, log, zero), np.float32(0))
