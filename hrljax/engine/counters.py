"""What a training loop counts from step to step, in as few numbers as can be.

A native loop pays for every number that it carries from one step to the next. A *tally* is a tuple
of them, to which a step adds its change. The first is an int32 cut into fields. From the lowest bit:
the position in a block of random words; up to `_FIRST_EVENTS` counts of events; the steps left; and
in the sign, whether the episode has terminated. Further numbers count further events.
"""

from collections.abc import Sequence
from typing import TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array

BLOCK = 64
"""Positions in a block of random words; a power of two. No tally goes on over the end of its block."""

_WIDTH = BLOCK.bit_length()
_FIELD = (1 << _WIDTH) - 1
_LEFT = 31 - _WIDTH - 1
"""Lowest bit of the steps left; the bit between them and the sign is never set."""
_FIRST_EVENTS = _LEFT // _WIDTH - 1
_FURTHER_EVENTS = 31 // _WIDTH
_ONE_STEP = 1 - (1 << _LEFT)

Tally: TypeAlias = tuple[Array, ...]


def position(tally: Tally) -> Array:
    """Where in the block of random words the next step is (int32), while the tally `goes_on`."""
    return tally[0] & (BLOCK - 1)


def goes_on(tally: Tally) -> Array:
    """Whether the episode has not terminated and there are steps left."""
    return tally[0] >= (1 << _LEFT)


def add(tally: Tally, change: Tally) -> Tally:
    """The tally after a step with this change."""
    return tuple(a + b for a, b in zip(tally, change, strict=True))


class Flags:
    """Events that happen or do not: counted in fields, so that a step adds a number or two."""

    def __init__(self, num_events: int):
        ends = [*range(_FIRST_EVENTS, num_events, _FURTHER_EVENTS), num_events]
        # Which events each number holds, and in which bits.
        held = [range(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]
        self._bits = [[_WIDTH * (i + (number == 0)) for i in range(len(h))] for number, h in enumerate(held)]
        self._firsts = [h.start for h in held]

    def change(self, flags: Array) -> Tally:
        """What a step adds, from its flags (int32): bit 0, it terminated; bit i, event i - 1 happened."""
        first = _spread(flags, [31, *self._bits[0]]) + np.int32(_ONE_STEP)
        further = zip(self._firsts[1:], self._bits[1:], strict=True)
        return (first, *(_spread(flags >> (1 + event), bits) for event, bits in further))

    def start(self, position: Array, left: Array, events: Array) -> Tally:
        """A tally at a position, with steps left to take, where a bin has seen `events` (``[events]`` float32)."""
        return (position + (left << _LEFT), *(jnp.int32(0) for _ in self._bits[1:]))

    def read(self, tally: Tally, events: Array) -> tuple[Array, Array, Array]:
        """Position, whether the episode terminated, and the events of the bin, which were `events` at the start."""
        counts = [(number >> bit) & _FIELD for number, bits in zip(tally, self._bits, strict=True) for bit in bits]
        seen = jnp.stack(counts).astype(jnp.float32) if counts else jnp.zeros(0, jnp.float32)
        return tally[0] & _FIELD, tally[0] < 0, events + seen


class Amounts:
    """Events that happen to some amount (float32): counted in a vector. Methods as those of `Flags`."""

    _clock = Flags(0)

    def change(self, terminated: Array, amounts: Sequence[Array]) -> Tally:
        """What a step adds: whether it terminated (bool), and how much of each event it was."""
        stacked = jnp.stack([a.astype(jnp.float32) for a in amounts]) if amounts else jnp.zeros(0, jnp.float32)
        return (*self._clock.change(terminated.astype(jnp.int32)), stacked)

    def start(self, position: Array, left: Array, events: Array) -> Tally:
        return (*self._clock.start(position, left, events), events)

    def read(self, tally: Tally, events: Array) -> tuple[Array, Array, Array]:
        now, terminated, _ = self._clock.read(tally[:1], jnp.zeros(0, jnp.float32))
        return now, terminated, tally[1]


def _spread(flags: Array, bits: list[int]) -> Array:
    """The lowest of some flags (int32) at bits far apart: flag i at ``bits[i]``.

    By one product, which adds up copies of all flags, and a mask. Copies do not overlap if flags are
    fewer than there are bits between two of them.
    """
    lowest = flags & np.int32((1 << len(bits)) - 1)
    copies, targets = sum(1 << (bit - i) for i, bit in enumerate(bits)), sum(1 << bit for bit in bits)
    return (lowest * _int32(copies)) & _int32(targets)


def _int32(bits: int) -> np.int32:
    return np.uint32(bits % (1 << 32)).astype(np.int32)
