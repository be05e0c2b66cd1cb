"""Random words: the bits are JAX's, every position and stream its own, and what they decide has the right shares."""

import math
from fractions import Fraction
from functools import partial

import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.core import random
from hrljax.core.counting import Count, count
from hrljax.core.random import WORD_BITS, WORD_RANGE, word_block

KEY = jax.random.key(7)
POSITIONS = 20_000
WORDS_PER_POSITION = 5  # two blocks of 64 bits: four words of high bits and one of low bytes


@partial(jax.jit, static_argnums=(0, 1, 2, 3))
def words_at(start: int, length: int, num_words: int, stream: int = 0) -> jax.Array:
    """``[length, num_words]`` words of successive positions of KEY."""
    positions = start + np.arange(length, dtype=np.int64)
    low, high = jnp.asarray(positions % 2**32, jnp.uint32), jnp.asarray(positions >> 32, jnp.uint32)
    key = random.key_words(KEY)
    return jnp.stack(jax.vmap(lambda i, j: jnp.stack(random.words(key, i, num_words, stream, j)))(low, high))


@pytest.fixture(scope="module")
def sample() -> np.ndarray:
    return np.asarray(words_at(0, POSITIONS, WORDS_PER_POSITION))


def test_threefry_has_the_bits_of_jax():
    generator = np.random.default_rng(0)
    keys = jnp.asarray(generator.integers(0, 2**32, (50, 2), np.uint32))
    counters = jnp.asarray(generator.integers(0, 2**32, (50, 2), np.uint32))
    ours = jnp.stack(random.threefry_2x32((keys[:, 0], keys[:, 1]), (counters[:, 0], counters[:, 1])), -1)
    theirs = jax.vmap(jax.extend.random.threefry_2x32)(keys, counters)
    np.testing.assert_array_equal(ours, theirs)


def test_threefry_agrees_with_the_published_known_answer():
    zero, ones = jnp.uint32(0), jnp.uint32(0xFFFFFFFF)
    assert [hex(x) for x in random.threefry_2x32((zero, zero), (zero, zero))] == ["0x6b200159", "0x99ba4efe"]
    assert [hex(x) for x in random.threefry_2x32((ones, ones), (ones, ones))] == ["0x1cb996fc", "0xbb002be7"]


@pytest.mark.parametrize("num_words", range(1, 21))
def test_words_gives_as_many_words_as_asked_for_and_no_spare_block(num_words: int):
    drawn = jax.eval_shape(lambda: random.words((jnp.uint32(1), jnp.uint32(2)), jnp.uint32(3), num_words))
    assert [(word.shape, word.dtype) for word in drawn] == [((), jnp.uint32)] * num_words
    assert 64 * (random.num_blocks(num_words) - 1) < WORD_BITS * num_words <= 64 * random.num_blocks(num_words)


@pytest.mark.slow
@pytest.mark.parametrize("num_words", range(1, 10))
def test_a_word_block_holds_the_words_of_its_positions(num_words: int):
    length = 40

    @jax.jit
    def from_block(start: Count) -> jax.Array:
        block = word_block(random.key_words(KEY), start, length, num_words)
        return jnp.stack(jax.vmap(lambda i: jnp.stack(block[i]))(jnp.arange(length, dtype=jnp.int32)))

    for start in (0, 1, 12_345, 2**32 - length, 3 * 2**32 + 5):
        np.testing.assert_array_equal(from_block(count(start)), words_at(start, length, num_words))


def test_positions_beyond_32_bits_have_words_of_their_own():
    drawn = [words_at(start, 10, 3) for start in (0, 2**32, 2**33, 2**47)]
    assert len(np.unique(drawn)) == 4 * 10 * 3


def test_more_words_than_a_position_has_are_refused():
    with pytest.raises(ValueError, match="at most 682 random words, got 683"):
        random.num_blocks(683)


def test_a_word_block_keeps_bits_that_are_no_number():
    """The block passes words through floats; signalling NaNs, infinities and subnormals must survive."""
    length = 20_000
    read = jax.jit(
        lambda start: jax.vmap(word_block(random.key_words(KEY), start, length, 2).__getitem__)(
            jnp.arange(length, dtype=jnp.int32)
        )
    )
    drawn = np.stack(read(count()), -1)
    exponent = (drawn >> 15) & 0xFF
    assert np.sum(exponent == 255) > 50
    assert np.sum(exponent == 0) > 50
    np.testing.assert_array_equal(drawn, words_at(0, length, 2))


def test_words_lie_in_their_range(sample: np.ndarray):
    assert sample.dtype == np.uint32
    assert sample.max() < WORD_RANGE


def test_words_are_uniform_bit_by_bit(sample: np.ndarray):
    assert sample.size == 100_000
    for slot in range(WORDS_PER_POSITION):
        column = sample[:, slot]
        deviation = WORD_RANGE / np.sqrt(12 * POSITIONS)
        assert abs(column.mean() - (WORD_RANGE - 1) / 2) < 4.5 * deviation
        for bit in range(WORD_BITS):
            share = np.mean((column >> bit) & 1)
            assert abs(share - 0.5) < 4.5 * 0.5 / np.sqrt(POSITIONS), (slot, bit)


def test_bits_of_one_position_are_uncorrelated(sample: np.ndarray):
    """The packed word of low bytes included: no random bit serves twice."""
    bits = (sample[:, :, None] >> np.arange(WORD_BITS, dtype=np.uint32) & 1).reshape(POSITIONS, -1)
    correlation = np.corrcoef(bits.T) - np.eye(bits.shape[1])
    assert np.abs(correlation).max() < 5 / np.sqrt(POSITIONS)


def test_streams_positions_and_keys_give_different_words():
    first = np.asarray(words_at(0, 200, 5))
    streams = [np.asarray(words_at(0, 200, 5, stream)) for stream in (1, 2, 127)]
    later = np.asarray(words_at(200, 200, 5))
    whole = np.concatenate([first, *streams, later])
    assert len(np.unique(whole, axis=0)) == len(whole)
    for other in (*streams, later):
        assert np.mean(first == other) < 0.01
    of_one_key, of_another = (random.words(random.key_words(jax.random.key(k)), jnp.uint32(0), 5) for k in (0, 1))
    assert all(a != b for a, b in zip(of_one_key, of_another, strict=True))


@pytest.mark.parametrize("probability", [0.0, 0.025, 1 / 3, 0.9, 1.0])
def test_below_holds_with_its_probability(sample: np.ndarray, probability: float):
    words = jnp.asarray(sample.ravel())
    share = float(jnp.mean(random.below(words, probability) | jnp.zeros(words.shape, jnp.bool_)))
    traced = float(jnp.mean(jax.jit(random.below)(words, jnp.float32(probability))))
    bound = 4.5 * np.sqrt(probability * (1 - probability) / words.size)
    assert abs(share - probability) <= bound
    assert abs(traced - probability) <= bound


@given(probability=st.floats(0, 1, width=32))
@settings(deadline=None, max_examples=100)
def test_the_threshold_counts_the_words_below_a_probability(probability: float):
    """Exactly, and the same for a constant and for a swept number, where both can hold it."""
    expected = math.ceil(Fraction(probability) * WORD_RANGE)
    assert int(random.threshold(probability)) == expected
    assert int(random.threshold(jnp.float32(probability))) == expected or probability < np.finfo(np.float32).tiny


uniform_indices = jax.jit(jax.vmap(random.uniform_index, (0, None)))


@given(n=st.integers(1, 255))
@settings(deadline=None, max_examples=100)
def test_uniform_index_gives_every_index_its_share(n: int):
    """Index i belongs to the words from ceil(i * range / n) up to the next such boundary."""
    first = np.array([-(-i * WORD_RANGE // n) for i in range(n + 1)], np.int64)
    assert np.ptp(np.diff(first)) <= 1
    ends = np.zeros((2, 255), np.uint32)
    ends[:, :n] = first[:-1], first[1:] - 1
    index = np.asarray(uniform_indices(jnp.asarray(ends.ravel()), jnp.int32(n))).reshape(2, 255)[:, :n]
    assert index.dtype == np.int32
    np.testing.assert_array_equal(index, np.tile(np.arange(n), (2, 1)))


@pytest.mark.parametrize("n", [1, 2, 3, 7, 25, 49, 255])
def test_uniform_cuts_are_where_the_index_changes(n: int):
    """To the word, which ``i / n`` misses for some n: rounded to float32, 13 / 25 lies below the change."""
    cuts = random.uniform_cuts(n)
    first = np.array([random.threshold(cut) for cut in cuts], np.uint32)
    assert len(first) == n - 1
    np.testing.assert_array_equal(uniform_indices(first, np.int32(n)), np.arange(1, n))
    np.testing.assert_array_equal(uniform_indices(first - 1, np.int32(n)), np.arange(n - 1))


def test_count_below_counts_cuts():
    cuts, words = (0.5, 0.25, jnp.float32(0.75), 0.0, 1.0), (0, WORD_RANGE // 4, WORD_RANGE // 2, WORD_RANGE - 1)
    assert [int(random.count_below(jnp.uint32(word), cuts)) for word in words] == [4, 3, 2, 1]
    assert random.count_below(jnp.uint32(0), ()).dtype == jnp.int32


def test_key_words_are_the_data_of_the_key():
    np.testing.assert_array_equal(jnp.stack(random.key_words(KEY)), jax.random.key_data(KEY))


@pytest.mark.parametrize(
    ("key", "error", "message"),
    [
        (lambda: jax.random.PRNGKey(0), TypeError, "new-style key"),
        (lambda: 0, TypeError, "new-style key.*got 0"),
        (lambda: jax.random.key(0, impl="rbg"), TypeError, "threefry2x32.*rbg"),
        (lambda: jax.random.split(jax.random.key(0), 3), ValueError, r"single key.*\(3,\)"),
    ],
    ids=["old-style", "int", "rbg", "array"],
)
def test_anything_but_one_threefry_key_is_refused(key, error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        random.check_key(key())
    with pytest.raises(error, match=message):
        random.key_words(key())
