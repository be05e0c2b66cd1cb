"""What learners see: windows, objects and Mario's own state, by hand and against what the competition showed."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import Array

from hrljax.envs.mario import features
from hrljax.envs.mario.engine.course import make_course, start
from hrljax.envs.mario.engine.state import KIND_NAMES, MAX_SPRITES, WINGED, World
from hrljax.envs.mario.features import NUM_OBJECT_CELLS, REACH, SYMBOL_NAMES
from hrljax.envs.mario.levels.ascii import from_ascii
from hrljax.envs.mario.levels.tiles import BEHAVIORS

WIDTH = 40
LEVEL = from_ascii(
    "type: overground\n"
    + ("." * WIDTH + "\n") * 11
    + "...b?$[]/-\\" + "." * (WIDTH - 11) + "\n"
    + "...qQc{}(:)" + "." * (WIDTH - 11) + "\n"
    + ("#" * WIDTH + "\n") * 2 + "\n"
    + ("." * WIDTH + "\n") * 14
    + "." * 8 + "!" + "." * (WIDTH - 9) + "\n"
)  # fmt: skip
COURSE = make_course(LEVEL)
GAME = start(COURSE)
NUMBER = {name: i for i, name in enumerate(SYMBOL_NAMES)}


def game(x: float, y: float, sprites: tuple[tuple[int, float, float], ...] = (), **player: Array) -> World:
    """A game with Mario at (x, y) and sprites (kind, x, y), oldest first, the first of them winged."""
    fields = {"kind": np.int32, "x": np.float32, "y": np.float32}
    columns = {name: np.zeros(MAX_SPRITES, dtype) for name, dtype in (*fields.items(), ("flags", np.int32))}
    for i, sprite in enumerate(sprites):
        for name, value in zip(fields, sprite, strict=True):
            columns[name][i] = value
    columns["flags"][0] = WINGED
    moved = GAME.player._replace(x=jnp.float32(x), y=jnp.float32(y), **player)
    placed = GAME.sprites._replace(**{name: jnp.asarray(column) for name, column in columns.items()})
    return GAME._replace(player=moved, sprites=placed, num_sprites=jnp.int32(len(sprites)))


@partial(jax.jit, static_argnums=1)
def seen(world: World, size: int = 5) -> Array:
    return features.window(COURSE, world, size)


def names(cells: Array) -> list[list[str]]:
    return [[SYMBOL_NAMES[i] for i in row] for row in cells.tolist()]


def test_symbols_are_numbered_without_gaps():
    assert features.NUM_SYMBOLS == 22
    assert SYMBOL_NAMES[features.SYMBOL_OF_KIND + 5] == KIND_NAMES[5] == "piranha"
    assert SYMBOL_NAMES[:5] == ("empty", "coin", "brick", "question block", "pipe")
    assert SYMBOL_NAMES[11:13] == ("solid", "exit")


def test_the_window_shows_the_tiles_around_mario():
    cells = names(seen(game(5 * 16 + 3.0, 13 * 16 - 1.0)))
    assert cells[0] == ["empty"] * 5
    assert cells[1] == ["brick", "question block", "coin", "pipe", "pipe"]
    assert cells[2] == ["solid", "question block", "brick", "pipe", "pipe"]
    assert cells[3] == ["solid"] * 5  # the inside of overground ground is empty only below its first row
    assert cells[4] == ["empty"] * 5


def test_the_exit_hides_its_column():
    cells = names(seen(game(8 * 16 + 8.0, 13 * 16 - 1.0), 3))
    assert [row[1] for row in cells] == ["exit"] * 3
    assert [row[2] for row in cells] == ["blocking 1", "empty", "solid"]


def test_the_level_goes_on_beyond_its_ends_and_is_empty_above():
    corner = seen(game(2.0, 20.0), 7)
    np.testing.assert_array_equal(corner[:, :3], np.repeat(corner[:, 3:4], 3, axis=1))
    assert not corner[:2].any()
    below = names(seen(game(2.0, 16 * 15 + 10.0), 3))
    assert below == [["empty"] * 3] * 3
    right = names(seen(game(WIDTH * 16 - 1.0, 13 * 16 - 1.0), 3))
    assert right[2] == ["solid"] * 3


def test_sprites_are_painted_over_tiles_and_newer_ones_over_older():
    world = game(88.0, 207.0, ((1, 84.0, 191.0), (7, 70.0, 208.0), (3, 81.0, 185.0), (9, 200.0, 207.0)))
    cells = names(seen(world))
    assert cells[1][2] == "goomba"  # over the red koopa in the same cell
    assert cells[2][1] == "fire flower"  # exactly on the border of two rows, it is in the upper one
    assert sum(name in KIND_NAMES for row in cells for name in row) == 2


@pytest.mark.slow
def test_a_window_can_lie_anywhere():
    world = game(88.0, 207.0, ((3, 300.0, 207.0),))
    cells = features.window(COURSE, world, 3, jnp.int32(18), jnp.int32(12))
    assert names(cells) == [["empty"] * 3, ["empty", "goomba", "empty"], ["solid"] * 3]
    np.testing.assert_array_equal(features.window(COURSE, world, 5, 5, 12), seen(world))


@settings(deadline=None, max_examples=60)
@given(st.floats(0, WIDTH * 16 - 1, width=32), st.floats(-30, 256, width=32), st.sampled_from((1, 5, 9)))
def test_windows_of_all_sizes_agree_with_a_plain_look_at_the_level(x, y, size):
    cells = np.asarray(seen(game(x, y), size))
    column, row = int(np.float32(x) / 16), 15 - int(16 - np.float32(y) / np.float32(16))
    for down in range(size):
        for right in range(size):
            x_tile, height = column + right - size // 2, row + down - size // 2
            tile = int(LEVEL.tiles[np.clip(x_tile, 0, WIDTH - 1), np.clip(height, 0, 14)]) if height >= 0 else 0
            if x_tile == 8:
                assert cells[down, right] == NUMBER["exit"]
            elif tile in (0x22, 0x10, 0x11, 0x15, 0x16, 0x0A, 0x0B, 0x1A, 0x1B):
                assert SYMBOL_NAMES[cells[down, right]] in ("coin", "brick", "question block", "pipe")
            else:
                solid, from_above = BEHAVIORS[tile] & 2 > 0, BEHAVIORS[tile] & 1 > 0
                assert SYMBOL_NAMES[cells[down, right]] == (
                    "solid" if solid else "blocking 1" if from_above else "empty"
                )


def test_objects_are_rounded_from_mario_and_far_ones_masked():
    things = ((1, 124.0, 175.0), (9, 72.0, 207.5), (3, 100.0, 240.0), (5, 100.0 + 21.6 * 16, 207.0), (6, 100.0, -57.1))
    seen_objects = jax.jit(features.objects)(*_parts(game(100.0, 207.0, things)))
    assert seen_objects.type[:5].tolist() == [0, 8, 2, 4, 5]
    assert seen_objects.dx[:4].tolist() == [2, -2, 0, 22]  # 1.5 tiles and -1.75
    assert seen_objects.dy[:5].tolist() == [2, 0, -2, 0, 17]
    assert seen_objects.mask.tolist() == [True] * 3 + [False] * (MAX_SPRITES - 3)
    assert seen_objects.winged.tolist() == [True] + [False] * (MAX_SPRITES - 1)


def _parts(world: World):
    return world.player, world.sprites, world.num_sprites


def test_object_cells_number_every_triple_once():
    numbers = []
    for kind in range(9):
        dx, dy = np.meshgrid(np.arange(-REACH[0], REACH[0] + 1), np.arange(-REACH[1], REACH[1] + 1))
        flat = [jnp.asarray(values.ravel(), jnp.int32) for values in (np.full_like(dx, kind), dx, dy)]
        on = jnp.ones(dx.size, jnp.bool_)
        numbers.append(features.object_cells(features.Objects(flat[0], on, flat[1], flat[2], on)))
    assert sorted(np.concatenate(numbers).tolist()) == list(range(NUM_OBJECT_CELLS)) == list(range(9 * 43 * 33))


def test_own_state():
    walking = game(105.0, 200.0, x_old=jnp.float32(96.0), y_old=jnp.float32(193.5), on_ground=jnp.bool_(True))
    assert [int(part) for part in features.own_state(walking.player)] == [0, 1, 0, 2, -1]  # 1.8 and -1.3
    assert [int(part) for part in features.own_state(walking.player, 4)] == [0, 1, 0, 7, -5]
    shooting = walking.player._replace(large=jnp.bool_(True), fire=jnp.bool_(True), x_old=jnp.float32(0))
    assert [int(part) for part in features.own_state(shooting)] == [2, 1, 0, 4, -1]


def test_own_states_have_different_numbers():
    grid = [np.arange(3), np.arange(2), np.arange(2), np.arange(-8, 9), np.arange(-8, 9)]
    size, ground, jump, dx, dy = (jnp.asarray(axis.ravel(), jnp.int32) for axis in np.meshgrid(*grid, indexing="ij"))
    numbers = features.own_number(features.OwnState(size, ground > 0, jump > 0, dx, dy), 2)
    assert sorted(numbers.tolist()) == list(range(features.num_own_states(2)))


@pytest.mark.parametrize(
    ("size", "error"), [(4, ValueError), (0, ValueError), (-1, ValueError), (2.0, TypeError), (True, TypeError)]
)
def test_even_sizes_of_windows_are_refused(size, error):
    with pytest.raises(error, match=f"size must be an odd integer from 1 to 2147483647, got {size}"):
        features.window(COURSE, GAME, size)


@pytest.mark.parametrize(("per_unit", "error"), [(0, ValueError), (1.5, TypeError), (True, TypeError)])
def test_bad_units_of_velocity_are_refused(per_unit, error):
    with pytest.raises(error, match=f"per_unit must be an integer from 1 to 2147483647, got {per_unit}"):
        features.own_state(GAME.player, per_unit)


def test_everything_is_the_same_in_a_batch():
    worlds = [game(40.0 * i, 200.0, ((3, 30.0 * i + 20, 207.0), (9, 90.0, 180.0))) for i in range(4)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *worlds)
    windows = jax.vmap(lambda world: features.window(COURSE, world))(batch)
    for world, cells in zip(worlds, windows, strict=True):
        np.testing.assert_array_equal(cells, seen(world))
