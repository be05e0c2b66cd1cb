"""Conditions of which some are known before compilation: bool scalars or Python's own True and False.

Where a condition is a Python constant, nothing of it is left in the compiled program.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

Flag = Array | bool


def both(a: Flag, b: Flag) -> Flag:
    if isinstance(a, bool):
        return b if a else False
    return a & b if not isinstance(b, bool) else both(b, a)


def either(a: Flag, b: Flag) -> Flag:
    if isinstance(a, bool):
        return True if a else b
    return a | b if not isinstance(b, bool) else either(b, a)


def choose(condition: Flag, these: Any, those: Any) -> Any:
    """`these` where a flag holds, else `those`; pytrees of arrays."""
    if isinstance(condition, bool):
        return these if condition else those
    return jax.tree.map(lambda a, b: lax.select(jnp.broadcast_to(condition, jnp.shape(a)), a, b), these, those)


def opposite(flag: Flag) -> Flag:
    return not flag if isinstance(flag, bool) else ~flag
