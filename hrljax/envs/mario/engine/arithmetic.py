"""Exact float32 arithmetic where XLA's own would differ from IEEE's.

The original multiplies three times in float64 and rounds to float32, and its velocities decay into
the subnormal numbers, which XLA on a CPU flushes to zero: Mario, standing still for 20 seconds,
would then leave the ground for one tick (a landed Mario's ya only decays; being above zero is what
keeps him on the ground). So decay is computed on the bits, in integers (docs/mario_engine.md, "Exact arithmetic").
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

_SIGN = np.uint32(0x80000000)
_FRACTION_BITS = 53


class Factor(NamedTuple):
    """A constant in [0.5, 1) as ``(high * 2**32 + low) / 2**53``; uint32 scalars."""

    high: Array | np.uint32
    low: Array | np.uint32


def factor(value: float | np.float32) -> Factor:
    """A float64 or float32 constant, exactly.

    Raises:
        ValueError: `value` is not in [0.5, 1).
    """
    if not 0.5 <= value < 1:
        raise ValueError(f"value must be in [0.5, 1), got {value!r}")
    scaled = int(float(value) * 2**_FRACTION_BITS)
    return Factor(np.uint32(scaled >> 32), np.uint32(scaled & 0xFFFFFFFF))


def select_factor(condition: Array, this: Factor, that: Factor) -> Factor:
    """`this` where `condition` holds, else `that`."""
    return Factor(*(lax.select(condition, jnp.uint32(a), jnp.uint32(b)) for a, b in zip(this, that, strict=True)))


def decayed(value: Array, by: Factor) -> Array:
    """``float32(float64(value) * by)``: rounded twice, to nearest even, subnormal numbers included.

    The 77-bit product is built from bytes of the factor, lowest first, so that every partial
    product fits into 32 bits. A float32 factor makes the first rounding exact, and then the result
    is that of a multiplication in float32.

    Args:
        value: float32 scalar, finite.
        by: from `factor` or `select_factor`.
    """
    bits = lax.bitcast_convert_type(value, jnp.uint32)
    exponent = (bits >> np.uint32(23)) & np.uint32(0xFF)
    significand = bits & np.uint32(0x7FFFFF)
    normal = exponent > 0
    significand = lax.select(normal, significand | np.uint32(1 << 23), significand)
    exponent = lax.select(normal, exponent, jnp.uint32(1))
    leading_zeros = lax.clz(significand) - np.uint32(8)
    significand = lax.shift_left(significand, leading_zeros)

    total, dropped = jnp.uint32(0), []
    for i in range(7):
        byte = (jnp.uint32(by.low if i < 4 else by.high) >> np.uint32(8 * (i % 4))) & np.uint32(0xFF)
        dropped.append(total & np.uint32(0xFF))
        total = (total >> np.uint32(8)) + significand * byte
    low, middle = (a | (b << np.uint32(8)) | (c << np.uint32(16)) for a, b, c in (dropped[1:4], dropped[4:7]))
    # The product is total << 48 | middle << 24 | low. First rounding: to 53 bits.
    short = (total < np.uint32(1 << 28)).astype(jnp.uint32)
    cut = np.uint32(24) - short
    middle = lax.shift_left(middle, short) | lax.shift_right_logical(low, cut)
    middle = middle + _round_up(lax.shift_left(low, short) & np.uint32(0xFFFFFF), jnp.uint32(1 << 23), middle)
    total = total + lax.shift_right_logical(middle, short + np.uint32(24))
    inexact = (lax.shift_left(middle, np.uint32(8) - short) != 0).astype(jnp.uint32)
    # Second rounding: to 24 bits, or to the places that a subnormal number has.
    finer = short & (exponent > np.uint32(1)).astype(jnp.uint32)
    shift = np.uint32(5) - finer + leading_zeros
    upper = lax.shift_right_logical(total, shift)
    rest = ((total - lax.shift_left(upper, shift)) << np.uint32(1)) | inexact
    upper = upper + _round_up(rest, lax.shift_left(jnp.uint32(1), shift), upper)
    result = ((exponent - finer - np.uint32(1)) << np.uint32(23)) + upper
    return lax.bitcast_convert_type(result | (bits & _SIGN), jnp.float32)


def _round_up(rest: Array, half: Array, upper: Array) -> Array:
    """1 if what is cut off, `rest`, calls for the next larger number, else 0; ties go to the even one."""
    return ((rest > half) | ((rest == half) & ((upper & np.uint32(1)) == 1))).astype(jnp.uint32)


def is_positive(value: Array) -> Array:
    """``value > 0``, true of subnormal numbers too."""
    return lax.bitcast_convert_type(value, jnp.int32) > 0


def is_negative(value: Array) -> Array:
    """``value < 0``, true of subnormal numbers too, not of -0."""
    return lax.bitcast_convert_type(value, jnp.uint32) > _SIGN


def truncated(value: Array) -> Array:
    """The integer part (int32), towards zero."""
    return lax.convert_element_type(value, jnp.int32)


def tile_of(value: Array) -> Array:
    """Column or row of a coordinate (int32): division by 16, towards zero."""
    return truncated(value * np.float32(1 / 16))
