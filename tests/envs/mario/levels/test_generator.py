"""The level generator against recordings of the original, tile behaviour, and what a level must be."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.envs.mario.levels.generator import generate_level, generate_levels
from hrljax.envs.mario.levels.ground import level_type_of, with_edges, without_edges
from hrljax.envs.mario.levels.java_random import JavaRandom
from hrljax.envs.mario.levels.level import Level, check_level, stack_levels
from hrljax.envs.mario.levels.tiles import BEHAVIORS, SYMBOLS, TILES
from hrljax.envs.mario.recordings import read_levels
from tests.mario_data import EXCERPT, LEVEL_FILES, recording

SEEDS = st.integers(-(2**31), 2**31 - 1)
DIFFICULTIES = st.integers(0, 15)
TYPES = st.integers(0, 2)
THESIS_LEVEL = generate_level(1247, 0, 3)


def assert_same_level(level: Level, expected: Level):
    np.testing.assert_array_equal(level.tiles, expected.tiles)
    np.testing.assert_array_equal(level.spawns, expected.spawns)
    assert level.exit_column == expected.exit_column
    assert level.tiles.dtype == level.spawns.dtype == np.uint8


def assert_generator_matches(path: Path) -> int:
    """Checks every level of a file; returns how many."""
    recorded = read_levels(path)
    for case in recorded:
        level = generate_level(case.id.seed, case.id.level_type, case.id.difficulty, case.id.width)
        assert_same_level(level, case.level)
        assert level.exit_row == case.exit_row
        assert level_type_of(level.tiles) == case.id.level_type
    return len(recorded)


@pytest.mark.parametrize(
    ("name", "count"), [("mario_levels.npz", 34), ("mario_levels_w150.npz", 10), ("mario_levels_w620.npz", 10)]
)
def test_levels_of_the_excerpt_are_generated_tile_for_tile(name, count):
    assert assert_generator_matches(EXCERPT / name) == count


@pytest.mark.parametrize(("name", "count"), LEVEL_FILES.items())
def test_all_recorded_levels_are_generated_tile_for_tile(name, count):
    assert assert_generator_matches(recording(name)) == count


def test_tile_behaviour_is_the_recorded_one():
    recorded = np.load(EXCERPT / "mario_levels.npz")["tile_behaviors"]
    tiles = list(TILES)
    np.testing.assert_array_equal(BEHAVIORS[tiles], recorded[tiles])
    assert not np.delete(BEHAVIORS, tiles).any()


def test_symbols_of_tiles():
    drawn = {tile: chr(SYMBOLS[tile]) for tile in TILES}
    expected = dict.fromkeys(TILES, " ") | {tile: "7" for tile in TILES if BEHAVIORS[tile] & 2}
    expected |= dict.fromkeys((0x84, 0x85, 0x86, 0xB4, 0xB5, 0xB6), "1")
    expected |= {0x10: "b", 0x11: "b", 0x12: "7", 0x15: "?", 0x16: "?", 0x22: "$"}
    expected |= dict.fromkeys((0x0A, 0x0B, 0x1A, 0x1B), "|")
    assert drawn == expected


def test_random_numbers_are_those_of_java():
    # What nextInt() of Java's Random(42) prints first, as unsigned numbers of 32 bits.
    words = [word % 2**32 for word in (-1170105035, 234785527, -1360544799, 205897768)]
    draws = JavaRandom(42)
    assert [draws.below(100) for _ in words] == [(word >> 1) % 100 for word in words]
    draws = JavaRandom(42)
    assert [draws.below(16) for _ in words] == [word >> 28 for word in words]


def test_an_incomplete_stretch_of_random_numbers_is_drawn_again():
    bound = (1 << 30) + 1  # of the numbers below 2^31, only one stretch of this length is complete
    drawn_again = 0
    for seed in range(40):
        state, numbers = seed ^ 0x5DEECE66D, []
        while not numbers or numbers[-1] >= bound:
            state = (state * 0x5DEECE66D + 0xB) % 2**48
            numbers.append(state >> 17)
        assert JavaRandom(seed).below(bound) == numbers[-1]
        drawn_again += len(numbers) > 1
    assert drawn_again > 10


def test_the_thesis_level():
    assert THESIS_LEVEL.num_columns == 370
    assert THESIS_LEVEL.exit_column == 318
    assert THESIS_LEVEL.exit_row == 11
    # Its first monster is a goomba between the two hills, seen in the picture of the recordings.
    assert THESIS_LEVEL.spawns[72, 13] == 3
    assert np.count_nonzero(THESIS_LEVEL.spawns[:72]) == 0


@settings(deadline=None, max_examples=60)
@given(SEEDS, TYPES, DIFFICULTIES, st.integers(20, 700))
def test_any_seed_gives_a_level_that_passes_the_checks(seed, level_type, difficulty, width):
    level = generate_level(seed, level_type, difficulty, width)
    assert_same_level(check_level(level), level)
    assert level.num_columns == width + 50
    assert max(18, width - 6) <= level.exit_column <= max(22, width + 12)
    assert 11 <= level.exit_row <= 14
    assert level_type_of(level.tiles) == level_type
    assert (level.tiles[:10, 14] != 0).all()  # Mario lands on ground
    assert not level.spawns[:10].any()


@settings(deadline=None, max_examples=20)
@given(SEEDS, DIFFICULTIES)
def test_negative_and_positive_seeds_give_different_levels(seed, difficulty):
    level, other = generate_level(seed, 0, difficulty), generate_level(-seed - 1, 0, difficulty)
    assert not np.array_equal(level.tiles, other.tiles)


@settings(deadline=None, max_examples=20)
@given(SEEDS, TYPES, DIFFICULTIES)
def test_edges_of_the_ground_follow_from_where_it_is(seed, level_type, difficulty):
    tiles = generate_level(seed, level_type, difficulty, 60).tiles
    np.testing.assert_array_equal(with_edges(without_edges(tiles), level_type), tiles)


def test_a_block_of_ground_has_edges_corners_and_an_inside():
    tiles = np.zeros((20, 15), np.uint8)
    tiles[5:9, 10:14] = 0x91
    tiles[15, 12] = 0x91  # too thin for an edge
    drawn = with_edges(tiles, 2)
    expected = [[0x88, 0x89, 0x89, 0x8A], [0x98, 0x99, 0x99, 0x9A], [0x98, 0x99, 0x99, 0x9A], [0xA8, 0xA9, 0xA9, 0xAA]]
    np.testing.assert_array_equal(drawn[5:9, 10:14].T, expected)
    assert drawn[15, 12] == 0x91


def test_a_batch_of_levels_has_a_leading_axis():
    seeds = np.array([3, -4, 1247])
    batch = generate_levels(seeds, 2, 5, 150)
    assert batch.tiles.shape == batch.spawns.shape == (3, 200, 15)
    assert batch.num_columns == 200
    for i, seed in enumerate(seeds.tolist()):
        assert_same_level(Level(*(field[i] for field in batch)), generate_level(seed, 2, 5, 150))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1 << 31, 0, 0), "seed must be an integer from -2147483648 to 2147483647, got 2147483648"),
        ((1, 3, 0), r"level_type must be an integer from 0 to 2 \(overground, underground, castle\), got 3"),
        ((1, 0, -1), "difficulty must be an integer from 0 to 1000000, got -1"),
        ((1, 0, 0, 19), r"width must be an integer from 20 to 1000000 \(tiles, at least one screen\), got 19"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        generate_level(*arguments)


@pytest.mark.parametrize(("arguments", "name"), [((0.5, 0, 0), "seed"), ((1, True, 0), "level_type")])
def test_arguments_are_integers(arguments, name):
    with pytest.raises(TypeError, match=f"{name} must be an integer from "):
        generate_level(*arguments)


def changed(field: str, column: int, row: int, value: int) -> Level:
    array = getattr(THESIS_LEVEL, field).copy()
    array[column, row] = value
    return THESIS_LEVEL._replace(**{field: array})


@pytest.mark.parametrize(
    ("level", "message"),
    [
        (changed("tiles", 7, 3, 0x77), r"level.tiles at column 7, row 3 is 0x77; it must be a tile byte"),
        (changed("spawns", 7, 3, 21), r"level.spawns at column 7, row 3 is 0x15; it must be one of"),
        (changed("spawns", 0, 1, 6), r"level.spawns at column 0, row 1 is 0x06"),
        (THESIS_LEVEL._replace(exit_column=370), r"level.exit_column must lie in 1..369, got 370"),
        (THESIS_LEVEL._replace(exit_column=0), r"level.exit_column must lie in 1..369, got 0"),
        (THESIS_LEVEL._replace(tiles=THESIS_LEVEL.tiles[:19]), r"level.tiles must have shape \[W >= 20, 15\]"),
        (THESIS_LEVEL._replace(spawns=THESIS_LEVEL.spawns[:19]), r"level.spawns must have the shape of tiles"),
        (THESIS_LEVEL._replace(tiles=THESIS_LEVEL.tiles.astype(float)), r"level.tiles must hold integers"),
    ],
)
def test_levels_that_cannot_be_are_refused(level, message):
    with pytest.raises(ValueError, match=message):
        check_level(level)


def test_levels_of_different_widths_do_not_stack():
    with pytest.raises(ValueError, match=r"2 levels of widths \[200, 370\]"):
        stack_levels([THESIS_LEVEL, generate_level(1, 0, 0, 150)])
    with pytest.raises(ValueError, match="at least one, got 0"):
        stack_levels([])
