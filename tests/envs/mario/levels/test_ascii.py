"""Levels as text: the round trip, the legend, and errors that name the place."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.envs.mario.levels.ascii import THING_CHARACTERS, TILE_CHARACTERS, LevelTextError, from_ascii, to_ascii
from hrljax.envs.mario.levels.generator import generate_level
from hrljax.envs.mario.levels.level import Level
from hrljax.envs.mario.recordings import read_levels
from tests.maps import written_over
from tests.mario_data import EXCERPT, LEVEL_FILES, recording

SMALL = """\
; a level made by hand
type: castle

......................
......................
......................
......................
......................
......................
......................
........b?Qqcu........
......................
............/---\\.....
.......$$$../<+>\\.....
......[]....(:::).....
......{}..%.(:::).....
############(:::)..###
####################.#

......................
......................
......................
......................
......................
......................
......................
......................
.............G........
......................
......................
......p......r......!.
...S..........o.......
......................
......................
"""


def changed(row: int, column: int, new: str, text: str = SMALL) -> str:
    return written_over(text, row, column, new)


def assert_round_trip(level: Level):
    read = from_ascii(to_ascii(level))
    np.testing.assert_array_equal(read.tiles, level.tiles)
    np.testing.assert_array_equal(read.spawns, level.spawns)
    assert read.exit_column == level.exit_column


@settings(deadline=None, max_examples=60)
@given(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2), st.integers(0, 15), st.integers(20, 400))
def test_generated_levels_survive_the_round_trip(seed, level_type, difficulty, width):
    assert_round_trip(generate_level(seed, level_type, difficulty, width))


@pytest.mark.parametrize("name", LEVEL_FILES)
def test_all_recorded_levels_survive_the_round_trip(name):
    for case in read_levels(recording(name)):
        assert_round_trip(case.level)


def test_recorded_levels_of_the_excerpt_survive_the_round_trip():
    for case in read_levels(EXCERPT / "mario_levels.npz"):
        assert_round_trip(case.level)


def test_a_level_made_by_hand():
    level = from_ascii(SMALL)
    assert level.tiles.shape == level.spawns.shape == (22, 15)
    assert level.tiles[8:14, 7].tolist() == [0x10, 0x15, 0x16, 0x12, 0x11, 0x04]
    assert level.tiles[6:8, 11:13].T.tolist() == [[0x0A, 0x0B], [0x1A, 0x1B]]
    assert level.tiles[12:17, 10].tolist() == [0x84, 0xB4, 0xB5, 0xB6, 0x86]
    assert level.tiles[12:17, 11].tolist() == [0x94, 0x95, 0x95, 0x95, 0x96]
    assert level.tiles[7:10, 10].tolist() == [0x22] * 3
    assert level.tiles[10, 12] == 0x09
    assert level.tiles[0:4, 13].tolist() == [0x89, 0x89, 0x89, 0x89]  # castle ground goes on beyond the border
    things = {(column, row): int(level.spawns[column, row]) for column, row in np.argwhere(level.spawns).tolist()}
    assert things == {(13, 8): 18, (6, 11): 5, (13, 11): 1, (3, 12): 20, (14, 12): 3}
    assert level.exit_column == 20
    assert_round_trip(level)


def test_text_is_the_same_for_every_place_of_the_exit_in_its_column():
    moved = changed(31, 21, ".", changed(25, 21, "!"))
    assert to_ascii(from_ascii(moved)) == to_ascii(from_ascii(SMALL))


def test_the_legend_says_every_tile_and_monster_once():
    assert len(set(TILE_CHARACTERS.values())) == len(TILE_CHARACTERS) == 23
    assert sorted(THING_CHARACTERS.values()) == [0, 1, 2, 3, 4, 5, 17, 18, 19, 20]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "row 1, column 1: no type"),
        (SMALL.replace("type", "kind"), "row 2, column 1: no type; the first line is 'type: NAME'"),
        (SMALL.replace("castle", "moon"), "row 2, column 7: unknown type 'moon'; known are overground, underground"),
        (changed(8, 5, "X"), "row 8, column 5: unknown character 'X'; a tile is one of . # % [ ] { }"),
        (changed(30, 5, "#"), "row 30, column 5: unknown character '#'; a thing is one of . r g o s p R G O S !"),
        (changed(30, 5, "P"), "row 30, column 5: unknown character 'P'"),
        (changed(6, 22, " "), "row 6, column 22: 21 characters; the first line of tiles has 22"),
        (changed(33, 23, ".."), "row 33, column 23: 24 characters; the first line of tiles has 22"),
        (changed(10, 1, " " * 22), "row 10, column 1: a blank line; a level has 15 lines of tiles"),
        (changed(19, 1, "." * 22), "row 19, column 1: a blank line must stand here"),
        ("\n".join(SMALL.splitlines()[:20]), "row 21, column 1: the text ends here"),
        (SMALL + "." * 22, "row 35, column 1: a line too many"),
        (changed(31, 21, "."), "row 20, column 1: no exit; mark one cell of the things with !"),
        (changed(33, 4, "!"), "row 33, column 4: a second exit !"),
        (changed(31, 21, ".", changed(33, 1, "!")), "row 33, column 1: the exit is in the first column"),
        (
            re.sub(r"(?m)^([^;t\n].{18}).*$", r"\1", SMALL),
            "row 4, column 20: 19 columns; a level has at least one screen",
        ),
    ],
)
def test_malformed_text_is_refused_with_its_place(text, message):
    with pytest.raises(LevelTextError, match=re.escape(message)):
        from_ascii(text)


def test_a_level_that_text_cannot_say_is_refused():
    level = generate_level(1, 0, 3)
    other = level.tiles.copy()
    other[0, 14] = 0x82
    with pytest.raises(ValueError, match=r"column 0, row 14 is 0x82, which text cannot say"):
        to_ascii(level._replace(tiles=other))
    crowded = level.spawns.copy()
    crowded[int(level.exit_column)] = 3
    with pytest.raises(ValueError, match="no room for the exit's mark"):
        to_ascii(level._replace(spawns=crowded))
