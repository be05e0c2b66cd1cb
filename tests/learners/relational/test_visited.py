"""A table of what has been met."""

import jax
import jax.numpy as jnp
import numpy as np

from hrljax.learners.relational.visited import is_met, mark, nothing_met


def test_what_was_marked_is_met_and_hardly_anything_else():
    random = np.random.default_rng(0)
    rows = jnp.asarray(np.unique(random.integers(-40, 40, size=(4000, 12)), axis=0), jnp.int32)
    half = len(rows) // 2
    table, _ = jax.lax.scan(lambda table, row: (mark(table, row, True), None), nothing_met(), rows[:half])
    actual = np.asarray(jax.vmap(lambda row: is_met(table, row))(rows))
    assert actual[:half].all()
    assert actual[half:].mean() < 0.01  # 2,000 of two million places are taken


def test_rows_that_differ_in_one_entry_by_one_are_told_apart():
    row = jnp.arange(30, dtype=jnp.int32)
    table = mark(nothing_met(), row, True)
    neighbours = row[None] + jnp.eye(30, dtype=jnp.int32)
    assert not np.asarray(jax.vmap(lambda other: is_met(table, other))(neighbours)).any()


def test_nothing_is_marked_where_it_is_not_asked():
    row = jnp.ones(5, jnp.int32)
    assert not is_met(mark(nothing_met(), row, jnp.bool_(False)), row)
