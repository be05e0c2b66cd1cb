"""Random words from keys: Threefry-2x32, unrolled, so that a native loop computes them in registers.

A *word* is a ``uint32`` that holds ``WORD_BITS`` random bits. Environments and learners receive
words instead of keys, which makes them deterministic functions: the same code is simulated with
random words and enumerated with chosen ones (`hrljax.envs.base`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.counting import Count
from hrljax.core.numerics import take

WORD_BITS = 24
WORD_RANGE = 1 << WORD_BITS

_MOST_WORDS = 256 * 64 // WORD_BITS
"""Random words of one position: its Threefry blocks are numbered by 8 bits."""
_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PARITY = np.uint32(0x1BD11BDA)


def threefry_2x32(key: tuple[Array, Array], counter: tuple[Array, Array]) -> tuple[Array, Array]:
    """Encrypts a counter of two words with a key of two words (Salmon et al. 2011, 20 rounds).

    The bits are those of JAX's own default generator. All arguments are ``uint32`` of one shape.
    """
    schedule = (key[0], key[1], key[0] ^ key[1] ^ _PARITY)
    x0, x1 = counter[0] + schedule[0], counter[1] + schedule[1]
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            x0 = x0 + x1
            x1 = (x1 << np.uint32(rotation)) | (x1 >> np.uint32(32 - rotation))
            x1 = x1 ^ x0
        x0 = x0 + schedule[(group + 1) % 3]
        x1 = x1 + schedule[(group + 2) % 3] + np.uint32(group + 1)
    return x0, x1


def key_words(key: Array) -> tuple[Array, Array]:
    """The two ``uint32`` words of one Threefry key.

    Raises:
        TypeError: `key` is not a new-style key (`jax.random.key`) or not of the Threefry kind.
        ValueError: `key` is an array of keys.
    """
    check_key(key)
    data = jax.random.key_data(key)
    return data[0], data[1]


def check_key(key: object) -> None:
    """Raises unless `key` is one new-style Threefry key."""
    if not isinstance(key, jax.Array) or not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        raise TypeError(f"key must be a new-style key such as jax.random.key(0), got {checks.described(key)}")
    if "fry" not in str(key.dtype):
        raise TypeError(f"key must be a threefry2x32 key (the default of jax.random.key), got {key.dtype}")
    if key.ndim:
        raise ValueError(f"key must be a single key, got an array of keys of shape {key.shape}; map over it")


def as_key(key: object) -> Array:
    """A new-style key: the one that is given, or that of an integer, as ``jax.random.key`` makes it.

    Raises:
        TypeError, ValueError: it is neither.
    """
    if checks.is_number(key, np.integer):
        return jax.random.key(checks.integer("key", key, 0, 2**32 - 1))
    check_key(key)
    assert isinstance(key, jax.Array)
    return key


def num_blocks(num_words: int) -> int:
    """How many Threefry blocks (64 bits each) hold `num_words` words.

    Raises:
        ValueError: a position has no more than `_MOST_WORDS`.
    """
    if num_words > _MOST_WORDS:
        raise ValueError(f"a step may use at most {_MOST_WORDS} random words, got {num_words}")
    return -(-num_words * WORD_BITS // 64)


def _pack(halves: list[Array], num_words: int) -> tuple[Array, ...]:
    """Cuts 32-bit halves into words: the high 24 bits of each, then triples of their low bytes."""
    low_byte, shift = np.uint32(0xFF), np.uint32(32 - WORD_BITS)
    words = [half >> shift for half in halves]
    for i in range(0, len(halves) - 2, 3):
        a, b, c = (half & low_byte for half in halves[i : i + 3])
        words.append((a << np.uint32(16)) | (b << np.uint32(8)) | c)
    return tuple(words[:num_words])


def words(
    key: tuple[Array, Array], index: Array, num_words: int, stream: int = 0, high: Array | None = None
) -> tuple[Array, ...]:
    """`num_words` words for a position of one of 128 streams of a key.

    The position is ``high * 2^32 + index``, uint32 scalars; 2^48 positions have words of their own.
    """
    halves: list[Array] = []
    for lane in range(num_blocks(num_words)):
        second = np.uint32(stream << 24 | lane)
        halves += threefry_2x32(key, (index, jnp.uint32(second) if high is None else _with_high(second, high)))
    return _pack(halves, num_words)


def _with_high(second: Array | np.uint32, high: Array) -> Array:
    """The second word of a counter, from bit 0: 8 bits of lane, 16 of the high word of a position, 7 of stream."""
    return second | (high & np.uint32(0xFFFF)) << np.uint32(8)


@partial(jax.tree_util.register_dataclass, data_fields=["pairs"], meta_fields=["length", "num_words"])
@dataclass(frozen=True)
class WordBlock:
    """The words of successive positions of stream 0; made by `word_block`."""

    pairs: Array  # [blocks * length] complex64: the two halves of each Threefry block, as bits
    length: int
    num_words: int

    def __getitem__(self, i: Array) -> tuple[Array, ...]:
        """The words of position `i` (int32 scalar), scalars."""
        return self._packed(lambda first: take(self.pairs, i + np.int32(first)))

    def positions(self) -> "WordBlock":
        """A block of one position for each of them, on a leading axis ``[length]``."""
        return WordBlock(self.pairs.reshape(-1, self.length).T, 1, self.num_words)

    def columns(self) -> tuple[Array, ...]:
        """Each word at all positions, ``[length]``."""
        return self._packed(lambda first: self.pairs[first : first + self.length])

    def _packed(self, read: Callable[[int], Array]) -> tuple[Array, ...]:
        halves = []
        for pair in map(read, range(0, len(self.pairs), self.length)):
            halves += [lax.bitcast_convert_type(part, jnp.uint32) for part in (lax.real(pair), lax.imag(pair))]
        return _pack(halves, self.num_words)


def word_block(key: tuple[Array, Array], start: Count, length: int, num_words: int) -> WordBlock:
    """The words of `length` successive positions, computed at once as short vectors.

    ``word_block(key, start, length, n)[i]`` equals the `words` of position ``start + i``, up to the
    next multiple of 2^32 (`Count.room`); a vector of positions costs little more than one, so a loop
    takes its words from a block.
    """
    lanes = num_blocks(num_words)
    index = start.low + np.tile(np.arange(length, dtype=np.uint32), lanes)
    lane = _with_high(jnp.asarray(np.repeat(np.arange(lanes, dtype=np.uint32), length)), start.high)
    # XLA would compute every round once for each of the two results. As one array of pairs,
    # for which complex64 is the only type, they are computed once; no arithmetic touches them.
    x0, x1 = threefry_2x32(key, (index, lane))
    as_float = partial(lax.bitcast_convert_type, new_dtype=jnp.float32)
    return WordBlock(lax.complex(as_float(x0), as_float(x1)), length, num_words)


def below(word: Array, probability: Array | float) -> Array:
    """True with `probability`, decided by one word."""
    if isinstance(probability, int | float | np.floating) and probability >= 1:
        return jnp.bool_(True)
    return word < threshold(probability)


def threshold(probability: Array | float) -> Array | np.uint32:
    """The number of words, out of ``WORD_RANGE``, below a probability (uint32).

    Constants are rounded to float32 first, so that they mean the same as arrays.
    """
    if isinstance(probability, int | float | np.floating):
        return np.uint32(math.ceil(float(np.float32(probability)) * WORD_RANGE))
    scaled = lax.ceil(probability.astype(jnp.float32) * np.float32(WORD_RANGE))
    return scaled.astype(jnp.uint32)


def uniform_index(word: Array, n: Array) -> Array:
    """A uniform index in ``[0, n)``, int32, from one word; `n` (int32) is at most 255."""
    return ((word * n.astype(jnp.uint32)) >> np.uint32(WORD_BITS)).astype(jnp.int32)


def uniform_cuts(n: int) -> tuple[float, ...]:
    """The probabilities at which the meaning of a word changes for ``uniform_index(word, n)``, exactly."""
    return tuple(math.ceil(i * WORD_RANGE / n) / WORD_RANGE for i in range(1, n))


def count_below(word: Array, cuts: tuple[Array | float, ...]) -> Array:
    """How many of the probabilities `cuts` lie above the word (int32)."""
    count = jnp.int32(0)
    for cut in cuts:
        count += below(word, cut).astype(jnp.int32)
    return count
