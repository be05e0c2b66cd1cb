"""What is near Mario, by hand in a small level."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.envs.mario.competition import unbegun
from hrljax.envs.mario.engine.state import World
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.nearby import dangers, nearest
from hrljax.learners.relational.concepts import NearestThings

WIDTH = 40


def level() -> str:
    """Ground with pits at columns 12 and 13, and 20; a wall of two at column 30."""
    rows = [["."] * WIDTH for _ in range(15)]
    for column in range(WIDTH):
        for row in (13, 14):
            rows[row][column] = "." if column in (12, 13, 20) else "#"
    rows[11][30] = rows[12][30] = "%"
    things = [["."] * WIDTH for _ in range(15)]
    things[12][38] = "!"
    return "\n".join(["type: overground", *map("".join, rows), "", *map("".join, things)])


ENV = Mario(levels=(level(),), preset="thesis")
START = unbegun(ENV.course, 0)
GOOMBA, MUSHROOM = 3, 6
STANDING = 13 * 16 - 1


def at(column: float, *things: tuple[int, float, float], y: float = STANDING) -> World:
    """Mario in the middle of a column; things by kind, columns ahead and rows above."""
    world = START.world
    x = 16 * column + 8
    sprites = world.sprites
    for i, (kind, dx, dy) in enumerate(things):
        values = {"kind": jnp.int32(kind), "x": jnp.float32(x + 16 * dx), "y": jnp.float32(y - 16 * dy)}
        sprites = sprites._replace(**{name: getattr(sprites, name).at[i].set(v) for name, v in values.items()})
    player = world.player._replace(x=jnp.float32(x), y=jnp.float32(y))
    return world._replace(player=player, sprites=sprites, num_sprites=jnp.int32(len(things)))


@jax.jit
def both(world: World):
    return dangers(ENV.course, world), nearest(ENV.course, world, 3)


@pytest.mark.parametrize(
    ("world", "wall", "pit", "monster"),
    [
        (at(3), False, False, False),
        (at(9), False, False, False),
        (at(10), False, True, False),
        (at(13), False, True, False),
        (at(14), False, False, False),
        (at(26), False, False, False),
        (at(27), True, False, False),
        (at(27, y=11 * 16 - 1), False, False, False),
        (at(3, (GOOMBA, 3.9, 0)), False, False, True),
        (at(3, (GOOMBA, 4, 0)), False, False, False),
        (at(3, (GOOMBA, -1, 0)), False, False, False),
        (at(3, (GOOMBA, 2, 2)), False, False, True),
        (at(3, (GOOMBA, 2, -3)), False, False, False),
        (at(3, (MUSHROOM, 1, 0)), False, False, False),
    ],
)
def test_dangers(world: World, wall: bool, pit: bool, monster: bool):
    seen, _ = both(world)
    assert (bool(seen.wall), bool(seen.pit), bool(seen.monster)) == (wall, pit, monster)
    assert bool(seen.any) == (wall or pit or monster)


def things(world: World) -> list[tuple[bool, int, int]]:
    _, seen = both(world)
    rows = zip(*(np.asarray(values).tolist() for values in seen), strict=True)
    return [(is_pit, dx, dy) for is_pit, dx, dy, holds in rows if holds]


def test_the_nearest_of_monsters_and_pits():
    """Pits begin at columns 12 and 20; the lowest row is 14, Mario stands in row 12."""
    assert things(at(3)) == [(True, 9, -2)]
    assert things(at(9)) == [(True, 3, -2), (True, 11, -2)]
    assert things(at(15)) == [(True, -3, -2), (True, 5, -2)]
    assert things(at(17)) == [(True, 3, -2)]
    world = at(9, (GOOMBA, 2, 0), (MUSHROOM, 0, 0), (GOOMBA, -1, 3), (GOOMBA, 13, 0))
    assert things(world) == [(False, 2, 0), (False, -1, 3), (True, 3, -2)]
    assert things(at(3, (GOOMBA, 12, 0))) == [(True, 9, -2), (False, 12, 0)]
    assert things(at(3, (GOOMBA, 11, 0))) == [(False, 11, 0), (True, 9, -2)]  # a tie


def test_concepts_of_the_nearest_things():
    """Number ((rank * 2 + is_pit) * 17 + dx + 4) * 31 + dy + 15."""
    concepts = NearestThings(3)
    episode = START._replace(world=at(9, (GOOMBA, 2, 0)))
    cells, count = concepts.held(ENV, episode)
    assert int(count) == 3
    expected = [(0 * 17 + 6) * 31 + 15, (3 * 17 + 7) * 31 + 13, (5 * 17 + 15) * 31 + 13]
    np.testing.assert_array_equal(cells, expected)
    assert concepts.num == 6 * 17 * 31
    assert concepts.most == 3
    assert int(concepts.held(ENV, START._replace(world=at(3)))[1]) == 1
    with pytest.raises(ValueError, match="count must be an integer from 1"):
        NearestThings(0)
