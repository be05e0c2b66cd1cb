"""Counts and sums of long runs, in pairs of 32-bit numbers: JAX has no others unless it is asked for them."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax


class Count(NamedTuple):
    """A whole number below 2^64; uint32 scalars (or arrays of one shape)."""

    low: Array
    high: Array

    def plus(self, more: Array) -> "Count":
        """The count after `more` (uint32)."""
        low = self.low + more
        return Count(low, self.high + (low < more).astype(jnp.uint32))

    def minus(self, other: "Count") -> "Count":
        """What was added since the count was `other`."""
        borrow = (self.low < other.low).astype(jnp.uint32)
        return Count(self.low - other.low, self.high - other.high - borrow)

    def room(self, most: int) -> Array:
        """How much can be added until the low half is 0 again: from 1 to `most`, int32."""
        return lax.min(~self.low, np.uint32(most - 1)).astype(jnp.int32) + 1

    def reaches(self, number: int) -> Array:
        """Whether the count is at least `number` (bool)."""
        low, high = np.uint32(number % 2**32), np.uint32(number >> 32)
        return (self.high > high) | ((self.high == high) & (self.low >= low))

    def as_float(self) -> Array:
        """The nearest float32, or one beside it."""
        return self.high.astype(jnp.float32) * np.float32(2**32) + self.low.astype(jnp.float32)


def count(number: int = 0) -> Count:
    """A count that stands at `number`."""
    return Count(jnp.uint32(number % 2**32), jnp.uint32(number >> 32))


class Total(NamedTuple):
    """A sum of many float32 numbers that keeps what rounding would lose (Neumaier 1974); arrays of one shape.

    The sum is ``value + lost``.
    """

    value: Array  # float32: the sum, rounded after every number
    lost: Array  # float32: the sum of what rounding cut off

    def plus(self, more: Array) -> "Total":
        """The sum with `more` (float32) added; both parts are exact to the last bit of `lost`."""
        value = self.value + more
        of_more = value - self.value
        lost = (self.value - (value - of_more)) + (more - of_more)
        return Total(value, self.lost + lost)

    def rounded(self) -> Array:
        """The sum as float32."""
        return self.value + self.lost


def total(shape: tuple[int, ...] = ()) -> Total:
    """Sums of no numbers yet."""
    return Total(jnp.zeros(shape, jnp.float32), jnp.zeros(shape, jnp.float32))


def one_more(number: Array, period: int, learns: Array) -> Array:
    """``number + 1`` where `learns` (int32), of what counts the uses of `period` places in turn.

    At 2^30 it goes back by `period`: it stays large, and the place that it means, its remainder, is right.
    """
    more = number + learns.astype(jnp.int32)
    return more - (more >= np.int32(2**30)).astype(jnp.int32) * np.int32(period)
