"""Loops of runs that take their steps together: one condition for all, and what only some of them need."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from hrljax.core.lockstep import any_run, once_if, one_after_another

SIZES = (1, 31, 32, 33, 70)


def flags_of(size: int) -> np.ndarray:
    return np.random.default_rng(size).random(size) < 0.4


def test_any_run_is_one_number_for_all():
    """With `out_axes` None `vmap` refuses what differs from run to run."""
    together = jax.vmap(any_run, out_axes=None)
    assert together(np.array([False, True, False]))
    assert not together(np.zeros(3, np.bool_))
    assert any_run(jnp.bool_(True))
    assert not any_run(jnp.bool_(False))


def test_a_loop_whose_condition_is_that_of_any_run_selects_no_table():
    def run(table: jax.Array, turns: jax.Array) -> jax.Array:
        def turn(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            return carry[0] + 1, carry[1] + (carry[0] < turns).astype(jnp.float32)

        return lax.while_loop(lambda carry: any_run(carry[0] < turns), turn, (jnp.int32(0), table))[1]

    mapped = jax.vmap(run)
    tables, turns = np.zeros((3, 4), np.float32), np.array([2, 0, 5], np.int32)
    np.testing.assert_array_equal(mapped(tables, turns), np.repeat(turns[:, None], 4, 1))
    assert "select_n" not in str(jax.make_jaxpr(mapped)(tables, turns))


@pytest.mark.parametrize("all_at_once", [False, True])
@pytest.mark.parametrize("size", SIZES)
def test_some_of_many_are_updated(size: int, all_at_once: bool, monkeypatch: pytest.MonkeyPatch):
    """What the update reads may differ from run to run, or be the same; what it returns as it was is kept."""
    if all_at_once:  # as on an accelerator
        monkeypatch.setattr(lax, "platform_dependent", lambda *, cpu, default: default())
    rng, flags = np.random.default_rng(0), flags_of(size)
    table, kept, by_run, shared = (
        rng.integers(9, size=shape, dtype=np.int32) for shape in ((size, 5), (size, 2), (size,), (5,))
    )

    def run(flag: Any, table: Any, kept: Any, own: Any) -> tuple[jax.Array, dict[str, jax.Array]]:
        def update(value: Any) -> Any:
            table, other = value
            return table * 2 + own + shared + other["kept"].sum(), {"kept": other["kept"], "count": other["count"] + 1}

        return once_if(flag, update, (table, {"kept": kept, "count": jnp.int32(7)}))

    after, others = jax.jit(jax.vmap(run))(flags, table, kept, by_run)
    expected = table * 2 + by_run[:, None] + shared + kept.sum(1, keepdims=True)
    np.testing.assert_array_equal(after, np.where(flags[:, None], expected, table))
    np.testing.assert_array_equal(others["kept"], kept)
    np.testing.assert_array_equal(others["count"], 7 + flags)
    for i in (0, size - 1):
        alone = jax.jit(run)(flags[i], table[i], kept[i], by_run[i])
        jax.tree.map(np.testing.assert_array_equal, alone, (after[i], {k: v[i] for k, v in others.items()}))


@pytest.mark.parametrize("size", SIZES)
def test_on_a_cpu_only_those_that_need_it_are_computed(size: int):
    flags, computed = flags_of(size), []

    @jax.jit
    @jax.vmap
    def run(flag: Any, number: Any) -> Any:
        def update(value: Any) -> Any:
            jax.debug.callback(lambda number: computed.append(int(number)), number)
            return value + 1

        return once_if(flag, update, number)

    jax.block_until_ready(run(flags, np.arange(size, dtype=np.int32)))
    jax.effects_barrier()
    assert computed == np.flatnonzero(flags).tolist()


@pytest.mark.parametrize("all_at_once", [False, True])
def test_one_after_another_is_what_vmap_gives(all_at_once: bool, monkeypatch: pytest.MonkeyPatch):
    if all_at_once:  # as on an accelerator
        monkeypatch.setattr(lax, "platform_dependent", lambda *, cpu, default: default())
    shared, of_game = np.arange(3, dtype=np.int32), {"x": np.arange(12, dtype=np.int32).reshape(4, 3), "n": np.int32(5)}

    def function(shared: Any, of_game: dict[str, Any]) -> dict[str, Any]:
        return {"sum": (shared * of_game["x"]).sum() + of_game["n"], "n": of_game["n"]}

    axes = (None, {"x": 0, "n": None})
    actual = jax.jit(jax.vmap(one_after_another(function), axes))(shared, of_game)
    jax.tree.map(np.testing.assert_array_equal, actual, jax.vmap(function, axes)(shared, of_game))
    alone = one_after_another(function)(shared, {"x": of_game["x"][2], "n": jnp.int32(5)})
    assert alone["sum"] == actual["sum"][2]


def test_one_after_another_may_hold_arrays_inside_a_branch_that_differs_from_run_to_run():
    table = np.arange(7, dtype=np.float32)

    @one_after_another
    def looked_up(place: jax.Array) -> jax.Array:
        return jnp.asarray(table)[place] + jnp.asarray(table).sum()

    def run(place: jax.Array) -> jax.Array:
        return lax.cond(place > 2, lambda: looked_up(place), lambda: jnp.float32(-1))

    places = np.arange(7, dtype=np.int32)
    expected = np.where(places > 2, table[places] + table.sum(), -1)
    np.testing.assert_array_equal(jax.jit(jax.vmap(run))(places), expected)
