"""Scalar building blocks: zeros that nobody folds, products that never fuse, reads and writes of rows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax

from hrljax.core.numerics import exact_product, opaque_zero, put_row, put_rows, stage, take, take_row

TRIPLES = np.random.default_rng(0).standard_normal((3, 100_000)).astype(np.float32)


@given(word=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=200)
def test_opaque_zero_is_zero(word: int):
    zero = opaque_zero(jnp.uint32(word))
    assert zero == 0
    assert zero.dtype == jnp.uint32


def test_opaque_zero_is_zero_of_many_words():
    words = jnp.arange(0, 2**32, 9973, dtype=jnp.uint32)
    assert not jnp.any(opaque_zero(words))


def test_opaque_zero_is_not_folded_to_a_constant():
    compiled = jax.jit(opaque_zero).lower(jnp.uint32(3)).compile()
    assert "multiply" in compiled.as_text()


def test_triples_tell_a_fused_multiply_add_from_two_roundings():
    a, b, c = TRIPLES
    fused = (a.astype(np.float64) * b + c).astype(np.float32)
    assert np.mean(fused != a * b + c) > 0.1


def test_an_exact_product_is_rounded_before_it_is_added():
    add = jax.jit(lambda a, b, c, word: exact_product(a, b, opaque_zero(word)) + c)
    a, b, c = TRIPLES
    np.testing.assert_array_equal(add(*map(jnp.asarray, TRIPLES), jnp.uint32(12345)), a * b + c)


def test_an_exact_product_of_words_in_registers_is_rounded_before_it_is_added():
    """LLVM knows more of numbers that it has made itself than of numbers that it has read."""

    def add(a: jax.Array, b: jax.Array, c: jax.Array) -> jax.Array:
        words = jax.lax.iota(jnp.uint32, len(a)) ^ (a > b).astype(jnp.uint32)
        return exact_product(a, b, opaque_zero(words)) + c

    a, b, c = TRIPLES[:, :2_000]
    np.testing.assert_array_equal(jax.jit(add)(*map(jnp.asarray, (a, b, c))), a * b + c)


def test_an_exact_product_in_a_loop_of_scalars_is_rounded_before_it_is_added():
    """The training loop's shape: a recurrence whose last bits depend on every rounding before."""
    a, b, _ = TRIPLES[:, :2_000]

    def body(total: jax.Array, triple: tuple[jax.Array, ...]) -> tuple[jax.Array, None]:
        x, y, word = triple
        return exact_product(x, total, opaque_zero(word)) + y, None

    words = np.arange(2_000, dtype=np.uint32) * np.uint32(2654435761)
    looped, _ = jax.jit(lambda *xs: jax.lax.scan(body, jnp.float32(0.5), xs))(*map(jnp.asarray, (a, b, words)))
    expected = np.float32(0.5)
    for x, y in zip(a, b, strict=True):
        expected = x * expected + y
    assert looped == expected


def test_an_exact_product_in_double_precision_is_rounded_before_it_is_added():
    a, b, c = np.random.default_rng(1).standard_normal((3, 10_000))
    with jax.enable_x64(True):
        add = jax.jit(lambda a, b, c, word: exact_product(a, b, opaque_zero(word)) + c)
        result = np.asarray(add(jnp.asarray(a), jnp.asarray(b), jnp.asarray(c), jnp.uint32(9)))
    assert result.dtype == np.float64
    np.testing.assert_array_equal(result, a * b + c)


def test_the_product_with_the_constant_one_is_the_other_factor():
    b = jnp.float32(1.7)
    assert exact_product(np.float32(1), b, jnp.uint32(0)) is b
    assert exact_product(np.float32(0.5), b, jnp.uint32(0)) == np.float32(0.85)


@given(size=st.just(9), index=st.integers(0, 8), dtype=st.sampled_from([np.int32, np.uint32]))
@settings(deadline=None, max_examples=30)
def test_take_reads_one_entry(size: int, index: int, dtype: type):
    table = np.arange(size, dtype=np.float32) ** 2
    assert take(jnp.asarray(table), jnp.asarray(index, dtype)) == table[index]


def test_take_beyond_the_end_reads_the_last_entry():
    assert take(jnp.arange(4.0), jnp.int32(4)) == 3
    assert take(jnp.arange(4.0), jnp.uint32(2**32 - 1)) == 3


@given(start=st.integers(0, 9), length=st.just(3))
@settings(deadline=None, max_examples=20)
def test_rows_are_read_and_replaced_in_place(start: int, length: int):
    table = np.random.default_rng(start).standard_normal(12).astype(np.float32)
    row = np.array([1, 2, 3], np.float32)
    np.testing.assert_array_equal(take_row(jnp.asarray(table), jnp.int32(start), length), table[start : start + length])
    expected = table.copy()
    expected[start : start + length] = row
    np.testing.assert_array_equal(put_row(jnp.asarray(table), jnp.int32(start), jnp.asarray(row)), expected)


BATCHED = [(True, True), (True, False), (False, True)]


@pytest.mark.parametrize(("tables", "starts"), BATCHED)
def test_rows_of_many_tables_are_those_of_each(tables: bool, starts: bool):
    """Beyond the end the last row is read, and replaced."""
    table = np.random.default_rng(0).normal(size=(5, 9)).astype(np.float32)
    start, row = np.array([0, 3, 7, 6, 2**31 - 1], np.int32), np.arange(15, dtype=np.float32).reshape(5, 3)
    arguments, axes = (table if tables else table[1], start if starts else start[1]), (0 if tables else None, 0)
    axes = (axes[0], 0 if starts else None)
    read = jax.jit(jax.vmap(lambda t, s: take_row(t, s, 3), axes))(*arguments)
    written = jax.jit(jax.vmap(put_row, (*axes, 0)))(*arguments, row)
    for run in range(5):
        one, first = table[run if tables else 1], min(start[run if starts else 1], 6)
        np.testing.assert_array_equal(read[run], one[first : first + 3])
        np.testing.assert_array_equal(written[run], np.concatenate([one[:first], row[run], one[first + 3 :]]))


def test_of_rows_that_are_replaced_one_after_the_other_the_last_stays():
    table, rows = np.zeros((3, 6), np.float32), [np.full((3, 2), 1, np.float32), np.full((3, 3), 2, np.float32)]
    starts = [np.array([0, 1, 9], np.int32), np.array([1, 3, 0], np.int32)]
    expected = [[1, 2, 2, 2, 0, 0], [0, 1, 1, 2, 2, 2], [2, 2, 2, 0, 1, 1]]
    np.testing.assert_array_equal(jax.jit(jax.vmap(put_rows))(table, starts, rows), expected)
    for run in range(3):
        alone = put_rows(jnp.asarray(table[run]), [jnp.asarray(of[run]) for of in starts], [of[run] for of in rows])
        np.testing.assert_array_equal(alone, expected[run])


def test_an_accelerator_writes_all_rows_at_once(monkeypatch: pytest.MonkeyPatch):
    expected = jax.vmap(put_row)(np.zeros((3, 6), np.float32), np.array([0, 4, 9]), np.ones((3, 2), np.float32))
    monkeypatch.setattr(lax, "platform_dependent", lambda *, cpu, default: default())
    actual = jax.vmap(put_row)(np.zeros((3, 6), np.float32), np.array([0, 4, 9]), np.ones((3, 2), np.float32))
    np.testing.assert_array_equal(actual, expected)


@pytest.mark.parametrize("under_jit", [False, True])
def test_a_stage_changes_no_result(under_jit: bool):
    def function(a: jax.Array, b: jax.Array) -> dict[str, jax.Array]:
        return {"sum": a + b, "difference": a - b}

    staged = stage(function)
    staged = jax.jit(staged) if under_jit else staged
    assert staged.__wrapped__ is not None
    assert staged(jnp.int32(5), b=jnp.int32(3)) == {"sum": 8, "difference": 2}
