"""Levels as the 2009 competition's program generates them, from a seed, a type and a difficulty.

Runs on the host, a few milliseconds a level. The same arguments give the same tiles, monsters and
exit as the original program, so every draw below stands in the original's order, which is told in
docs/mario_engine.md, "Level generation".
"""

from collections.abc import Sequence

import numpy as np

from hrljax.core import checks
from hrljax.envs.mario.levels.ground import with_edges
from hrljax.envs.mario.levels.java_random import JavaRandom
from hrljax.envs.mario.levels.level import GOOMBA, MIN_COLUMNS, PIRANHA, RED_KOOPA, WINGED, Level, stack_levels
from hrljax.envs.mario.levels.tiles import (
    BRICK,
    BRICK_COIN,
    BRICK_POWER_UP,
    COIN,
    EMPTY,
    GROUND_INTERIOR,
    HEIGHT,
    HILL_BODIES,
    HILL_TOPS,
    HILL_TOPS_JOINED,
    OVERGROUND,
    PIPE_BODY,
    PIPE_MOUTH,
    QUESTION_COIN,
    QUESTION_POWER_UP,
    STAIR,
)

_EXTRA_COLUMNS = 50
_LAST_STRETCH = 64
"""No section begins in so many columns at the end."""
_EXIT_DISTANCE = 8
_MOST = 10**6
"""Largest difficulty and width: weights of sections and tiles stay far from overflow."""


def generate_level(seed: int, level_type: int = OVERGROUND, difficulty: int = 0, width: int = 320) -> Level:
    """The level of a seed, tile for tile that of the original program.

    Args:
        seed: any signed number of 32 bits.
        level_type: 0 overground, 1 underground, 2 castle.
        difficulty: 0 (no pits, only goombas) and up; the competition used 0 to 15.
        width: nominal width in tiles, at least one screen (20); the competition's is 320. The level
            has 50 columns more. Its exit lies between columns ``width - 6`` and ``width + 12``, and
            not before column 18, where the safe first section ends.

    Returns:
        Level of ``W = width + 50`` columns.

    Raises:
        TypeError, ValueError: an argument is no integer, or outside what is said above.
    """
    seed = checks.integer("seed", seed, -(2**31))
    level_type = checks.integer("level_type", level_type, 0, 2, meaning="overground, underground, castle")
    difficulty = checks.integer("difficulty", difficulty, 0, _MOST)
    width = checks.integer("width", width, MIN_COLUMNS, _MOST, meaning="tiles, at least one screen")
    return _Draft(seed, level_type, difficulty, width + _EXTRA_COLUMNS).level()


def generate_levels(
    seeds: Sequence[int] | np.ndarray, level_type: int = OVERGROUND, difficulty: int = 0, width: int = 320
) -> Level:
    """The levels of several seeds as one `Level` with a leading axis; arguments as `generate_level`."""
    return stack_levels([generate_level(int(seed), level_type, difficulty, width) for seed in seeds])


class _Draft:
    """A level while it is being drawn, section by section from left to right."""

    def __init__(self, seed: int, level_type: int, difficulty: int, columns: int):
        self.level_type = level_type
        self.difficulty = difficulty
        self.columns = columns
        self.below = JavaRandom(seed).below
        self.tiles = bytearray(columns * HEIGHT)
        self.spawns = bytearray(columns * HEIGHT)

    def level(self) -> Level:
        start = self._sections()
        floor = self._floor()
        for x in range(start, self.columns):
            self._ground(x, floor)
        if self.level_type != OVERGROUND:
            self._ceiling()
        shape = (self.columns, HEIGHT)
        tiles = with_edges(np.frombuffer(self.tiles, np.uint8).reshape(shape), self.level_type)
        spawns = np.frombuffer(bytes(self.spawns), np.uint8).reshape(shape)
        return Level(tiles, spawns, np.int32(start + _EXIT_DISTANCE))

    def _sections(self) -> int:
        """Draws sections until the last stretch; returns the column behind them."""
        kinds = (self._straight, self._hills, self._tubes, self._jump, self._cannons)
        hills = 10 if self.level_type == OVERGROUND else 0
        weights = (20, hills, 2 + self.difficulty, 2 * self.difficulty, max(0, 5 * self.difficulty - 10))
        starts = np.cumsum((0, *weights)).tolist()
        length = self._straight(0, self.columns, safe=True)
        while length < self.columns - _LAST_STRETCH:
            drawn = self.below(starts[-1])
            kind = max(i for i in range(len(kinds)) if starts[i] <= drawn)
            length += kinds[kind](length, self.columns - length)
        return length

    def _cannons(self, left: int, longest: int) -> int:
        """No columns: the competition turned cannons off."""
        return 0

    def _floor(self) -> int:
        return HEIGHT - 1 - self.below(4)

    def _put(self, x: int, y: int, tile: int) -> None:
        if 0 <= x < self.columns and 0 <= y < HEIGHT:
            self.tiles[x * HEIGHT + y] = tile

    def _get(self, x: int, y: int) -> int:
        return self.tiles[x * HEIGHT + y] if 0 <= x < self.columns and 0 <= y < HEIGHT else EMPTY

    def _spawn(self, x: int, y: int, monster: int) -> None:
        if 0 <= x < self.columns and 0 <= y < HEIGHT:
            self.spawns[x * HEIGHT + y] = monster

    def _ground(self, x: int, floor: int) -> None:
        for y in range(floor, HEIGHT):
            self._put(x, y, GROUND_INTERIOR)

    def _straight(self, left: int, longest: int, safe: bool = False) -> int:
        length = self.below(10) + 2
        if safe:
            length = 10 + self.below(5)
        length = min(length, longest)
        floor = self._floor()
        for x in range(left, left + length):
            self._ground(x, floor)
        if not safe and length > 5:
            self._decorate(left, left + length, floor)
        return length

    def _enemies(self, left: int, right: int, y: int) -> None:
        for x in range(left, right):
            if self.below(35) < self.difficulty + 1:
                kind = RED_KOOPA + self.below(4)
                if self.difficulty < 1:
                    kind = GOOMBA
                elif self.difficulty < 3:
                    kind = RED_KOOPA + self.below(3)
                winged = self.below(35) < self.difficulty
                self._spawn(x, y, kind + (WINGED if winged else 0))

    def _decorate(self, left: int, right: int, floor: int) -> None:
        """Monsters, a row of coins and a row of blocks over flat ground."""
        if floor < 1:
            return
        below = self.below
        self._enemies(left + 1, right - 1, floor - 1)
        first, end = left + 1 + below(4), right - 1 - below(4)
        if floor - 2 > 0 and end - first > 1:
            for x in range(first, end):
                self._put(x, floor - 2, COIN)
        first, end = left + 1 + below(4), right - 1 - below(4)
        if floor - 4 > 0 and end - first > 2:
            for x in range(first, end):
                if x != left + 1 and x != right - 2 and below(3) == 0:
                    tile = QUESTION_POWER_UP if below(4) == 0 else QUESTION_COIN
                elif below(4) == 0:
                    tile = BRICK_POWER_UP if below(4) == 0 else BRICK_COIN
                else:
                    tile = BRICK
                self._put(x, floor - 4, tile)

    def _hills(self, left: int, longest: int) -> int:
        """Ground with hills on it, each higher than the one before and none beside another's edge."""
        length = min(self.below(10) + 10, longest)
        floor = self._floor()
        for x in range(left, left + length):
            self._ground(x, floor)
        self._enemies(left + 1, left + length - 1, floor - 1)
        top, last = floor, False
        edges: set[int] = set()
        while not last:
            top -= 2 + self.below(3)
            if top <= 0:
                break
            hill = self.below(5) + 3
            first = self.below(length - hill - 2) + left + 1
            if edges & {first - 1, first, first + hill, first + hill + 1}:
                break
            edges |= {first, first + hill}
            self._enemies(first, first + hill, top - 1)
            if self.below(4) == 0:
                self._decorate(first - 1, first + hill + 1, top)
                last = True
            for x in range(first, first + hill):
                self._hill_column(x, top, floor, 0 if x == first else 2 if x == first + hill - 1 else 1)
        return length

    def _hill_column(self, x: int, top: int, floor: int, place: int) -> None:
        for y in range(top, floor):
            tile = self._get(x, y)
            if tile == EMPTY:
                self._put(x, y, (HILL_TOPS if y == top else HILL_BODIES)[place])
            elif tile in (HILL_TOPS[0], HILL_TOPS[2]):
                self._put(x, y, HILL_TOPS_JOINED[HILL_TOPS.index(tile)])

    def _tubes(self, left: int, longest: int) -> int:
        below = self.below
        length = min(below(10) + 5, longest)
        floor = self._floor()
        pipe = left + 1 + below(4)
        top = floor - below(2) - 2
        for x in range(left, left + length):
            if x > pipe + 1:
                pipe += 3 + below(4)
                top = floor - below(2) - 2
            if pipe >= left + length - 2:
                pipe += 10
            if x == pipe and below(11) < self.difficulty + 1:
                self._spawn(x, top, PIRANHA)
            self._ground(x, floor)
            if x in (pipe, pipe + 1):
                for y in range(top, floor):
                    self._put(x, y, (PIPE_MOUTH if y == top else PIPE_BODY)[x - pipe])
        return length

    def _jump(self, left: int, longest: int) -> int:
        """A pit between two banks, which may rise as stairs; may be longer than `longest`."""
        bank = self.below(4) + 2
        pit = self.below(2) + 2
        length = 2 * bank + pit
        stairs = self.below(3) == 0
        floor = self._floor()
        for x in range(left, left + length):
            if bank <= x - left < bank + pit:
                continue
            self._ground(x, floor)
            if stairs:
                rise = x - left - 1 if x < left + bank else left + length - x - 2
                for y in range(floor - rise, floor):
                    self._put(x, y, STAIR)
        return length

    def _ceiling(self) -> None:
        depth, run = 0, 0
        for x in range(self.columns):
            turn = run <= 0 and x > 4
            run -= 1
            if turn:
                depth = self.below(4)
                run = self.below(4) + 4
            rows = depth + 1 if x > 4 else HEIGHT if x < 1 else 0
            for y in range(rows):
                self._put(x, y, GROUND_INTERIOR)
