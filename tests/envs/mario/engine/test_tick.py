"""What must hold in every game, and that a game is the same alone, in a batch and in pieces."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax

from hrljax.envs.mario.engine.course import (
    Course,
    make_course,
    start,
    template_word,
    templates_left_of,
    unpack_template,
)
from hrljax.envs.mario.engine.quantum import snapped
from hrljax.envs.mario.engine.state import JUMP, LEFT, RIGHT, SPEED
from hrljax.envs.mario.engine.tick import tick
from hrljax.envs.mario.levels.generator import generate_level
from hrljax.envs.mario.levels.tiles import BEHAVIORS, BLOCKS, HEIGHT, TILE
from hrljax.experiments.mario_fidelity import parity

NUM_LEVELS, TICKS = 12, 400
LEVELS = [generate_level(5000 + i, i % 3, (0, 3, 7, 10)[i % 4]) for i in range(NUM_LEVELS)]


@pytest.fixture(scope="module")
def course() -> Course:
    return jax.tree.map(jnp.asarray, make_course(*LEVELS))


def random_keys(seed: int, ticks: int = TICKS, hold: int = 5) -> np.ndarray:
    """Keys held for some ticks, mostly to the right."""
    rng = np.random.default_rng(seed)
    count = -(-ticks // hold)
    direction = rng.choice([RIGHT, LEFT, 0, LEFT | RIGHT], count, p=[0.7, 0.15, 0.1, 0.05])
    keys = direction + JUMP * (rng.random(count) < 0.5) + SPEED * (rng.random(count) < 0.6)
    return np.repeat(keys, hold)[:ticks].astype(np.int32)


@pytest.mark.slow
@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    st.integers(0, NUM_LEVELS - 1), st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 2]), st.sampled_from([1, 5, 20])
)
def test_laws_of_every_game(course: Course, level: int, seed: int, mode: int, hold: int):
    record = parity.play(course, level, random_keys(seed, hold=hold), mode=mode)
    player, sprites, counts = record.player, record.sprites, record.counts
    for values in (*player, *sprites):
        assert np.isfinite(values).all()
    assert not counts["overflow"].any()
    assert (np.diff(counts["coins"]) >= 0).all()
    assert (np.diff(counts["kills"]) >= 0).all()
    assert (np.diff(counts["active_tick"]) >= 0).all()
    assert (player.fire <= player.large).all()
    over = (player.death_time > 0) | (player.win_time > 0)
    assert (np.diff(over.astype(int)) >= 0).all()

    rests = (player.x == player.x_old) & (player.y == player.y_old) & player.on_ground & ~counts["paused"]
    column, row = (np.trunc(values / TILE).astype(int) for values in (player.x, player.y))
    inside = rests & (row >= 0) & (row < HEIGHT)
    foot = record.tiles[np.arange(TICKS), np.clip(column, 0, 369) * HEIGHT + np.clip(row, 0, HEIGHT - 1)]
    assert not (BEHAVIORS[foot[inside]] & BLOCKS).any()

    listed = np.arange(sprites.x.shape[1]) < counts["n_sprites"][:, None]
    assert ((sprites.kind >= 1) & (sprites.kind <= 9))[listed].all()
    for serials, in_use in zip(sprites.serial, listed, strict=True):
        assert (np.diff(serials[in_use]) != 0).all()


@pytest.mark.slow
def test_same_alone_and_in_a_batch(course: Course):
    levels = np.array([1, 3, 6, 11], np.int32)
    keys = np.stack([random_keys(seed, 160) for seed in range(len(levels))])

    @jax.jit
    @partial(jax.vmap, in_axes=(None, 0, 0))
    def together(course, level, keys):
        def step(world, keys):
            world = tick(course, world, keys)
            return world, (world.player, world.sprites, world.tiles)

        return lax.scan(step, start(course, level, True, True), keys)[1]

    player, sprites, tiles = together(course, levels, keys)
    for i, level in enumerate(levels):
        alone = parity.play(course, int(level), keys[i], mode=2)
        for ours, theirs in zip(alone.player, player, strict=True):
            np.testing.assert_array_equal(ours, np.asarray(theirs[i]))
        for ours, theirs in zip(alone.sprites, sprites, strict=True):
            listed = np.arange(ours.shape[1]) < alone.counts["n_sprites"][:, None]
            np.testing.assert_array_equal(ours[listed], np.asarray(theirs[i])[listed])
        np.testing.assert_array_equal(alone.tiles, np.asarray(tiles[i]))


def test_course_lists_templates_by_column():
    made = make_course(*LEVELS[:3])
    assert made.num_levels == 3
    assert made.num_columns == 370
    for i, level in enumerate(LEVELS[:3]):
        columns, rows = np.nonzero(level.spawns)
        for k, (column, row) in enumerate(zip(columns, rows, strict=True)):
            template = unpack_template(template_word(made, jnp.int32(i), jnp.int32(k)))
            assert tuple(map(int, template)) == (column, row, level.spawns[column, row])
        for column in (-3, 0, 17, 200, 370, 500):
            counted = templates_left_of(made, jnp.int32(i), jnp.int32(column))
            assert counted == np.sum(columns < column)


def test_levels_of_different_widths_make_no_course():
    with pytest.raises(ValueError, match=r"widths \[200, 370\]"):
        make_course(LEVELS[0], generate_level(1, 0, 0, 150))


def test_lattice_points():
    values = jnp.array([0.4, 0.5, 1.5, -0.2, -0.5, 2.75, -7.3], jnp.float32)
    np.testing.assert_array_equal(snapped(values, 1), np.array([0, 0, 2, 0, 0, 3, -7], np.float32))
    np.testing.assert_array_equal(snapped(values, 2), np.array([0.5, 0.5, 1.5, 0, -0.5, 3, -7.5], np.float32))
    assert not np.signbit(np.asarray(snapped(values, 1)))[3]
