"""What a training loop counts from step to step, in as few numbers as can be.

A native loop pays for every number that it carries from one step to the next. A *tally* is a tuple
of them, to which a step adds its change. The first is an int32 cut into fields: the position in a
block of random words, and whether the episode has terminated. The rest counts events.
"""

from collections.abc import Sequence
from typing import TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array

BLOCK = 32
"""Positions in a block of random words; a power of two. No tally goes on over the end of its block."""

_WIDTH = BLOCK.bit_length()
_FIELD = (1 << _WIDTH) - 1
_FIELDS = 30 // _WIDTH

Tally: TypeAlias = tuple[Array, ...]


def position(tally: Tally) -> Array:
    """Where in the block of random words the next step is (int32), while the tally `goes_on`."""
    return tally[0] & (BLOCK - 1)


def goes_on(tally: Tally, limit: Array) -> Array:
    """Whether the episode has not terminated and the position is below `limit` (int32, at most `BLOCK`)."""
    # The termination is the field above the position; no limit reaches up to there.
    return (tally[0] & ((1 << 2 * _WIDTH) - 1)) < limit


def add(tally: Tally, change: Tally) -> Tally:
    """The tally after a step with this change."""
    return tuple(a + b for a, b in zip(tally, change, strict=True))


class Flags:
    """Events that happen or do not: counted in fields, so that a step adds a number or two."""

    def __init__(self, num_events: int):
        # Which flags, the termination first, each number holds; the first begins with the position.
        ends = [*range(_FIELDS - 1, 1 + num_events, _FIELDS), 1 + num_events]
        self._held = [range(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]

    def change(self, flags: Array) -> Tally:
        """What a step adds, from its flags (int32): bit 0, it terminated; bit i, event i - 1 happened."""
        first, *others = self._held
        rest = (_spread((flags >> held.start) & _ones(len(held)), len(held), 0) for held in others)
        return (_spread(flags & _ones(len(first)), len(first), 1) + 1, *rest)

    def start(self, position: Array, events: Array) -> Tally:
        """A tally at a position, where a bin has seen `events` (``[events]`` float32)."""
        return (position, *(jnp.int32(0) for _ in self._held[1:]))

    def read(self, tally: Tally, events: Array) -> tuple[Array, Array, Array]:
        """Position, whether the episode terminated, and the events of the bin, which were `events` at the start."""
        counts = []
        for number, held in enumerate(self._held):
            shift = _WIDTH * (number == 0)
            counts += [(tally[number] >> (shift + _WIDTH * i)) & _FIELD for i in range(len(held))]
        terminated, *happened = counts
        seen = jnp.stack(happened).astype(jnp.float32) if happened else jnp.zeros(0, jnp.float32)
        return tally[0] & _FIELD, terminated > 0, events + seen


class Amounts:
    """Events that happen to some amount (float32): counted in a vector. Methods as those of `Flags`."""

    _clock = Flags(0)

    def change(self, terminated: Array, amounts: Sequence[Array]) -> Tally:
        """What a step adds: whether it terminated (bool), and how much of each event it was."""
        stacked = jnp.stack([a.astype(jnp.float32) for a in amounts]) if amounts else jnp.zeros(0, jnp.float32)
        return (*self._clock.change(terminated.astype(jnp.int32)), stacked)

    def start(self, position: Array, events: Array) -> Tally:
        return (position, events)

    def read(self, tally: Tally, events: Array) -> tuple[Array, Array, Array]:
        now, terminated, _ = self._clock.read(tally, jnp.zeros(0, jnp.float32))
        return now, terminated, tally[1]


def _ones(count: int) -> int:
    return (1 << count) - 1


def _spread(flags: Array, count: int, first: int) -> Array:
    """Neighbouring flags (int32) in fields of their own: bit i in the lowest bit of field ``first + i``.

    By one product, which adds up copies of all flags, and a mask. The copies lie a bit less than a
    field apart, so that no two of them overlap.
    """
    targets = [_WIDTH * (first + i) for i in range(count)]
    factor, mask = sum(1 << (t - i) for i, t in enumerate(targets)), sum(1 << t for t in targets)
    return (flags * np.int32(factor)) & np.int32(mask)
