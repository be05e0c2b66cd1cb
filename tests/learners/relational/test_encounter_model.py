"""What is learned of meeting things: against plain Python and against games of the engine."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.mario.competition import begin, unbegun
from hrljax.envs.mario.engine.state import Player, World
from hrljax.envs.mario.env import Mario
from hrljax.learners.base import Transition
from hrljax.learners.relational.encounter_model import (
    COLUMNS,
    NUM_ENCOUNTERS,
    ROWS,
    Encounters,
    MarioEncounters,
    encounter,
)
from hrljax.learners.relational.given_model import MarioDynamics

WIDTH, MODEL = 60, MarioEncounters()


def goombas() -> str:
    """Ground, and goombas that come towards Mario."""
    ground = ["." * WIDTH] * 13 + ["#" * WIDTH] * 2
    things = [["."] * WIDTH for _ in range(15)]
    for column in (10, 14, 19):
        things[12][column] = "o"
    things[12][55] = "!"
    return "\n".join(["type: overground", *ground, "", *map("".join, things)])


ENV = Mario(levels=(goombas(),), preset="thesis")
RIGHT_SPEED = ENV.action_names.index("right speed")
START = unbegun(ENV.course, 0)


def world_with(*things: dict[str, float]) -> World:
    sprites = START.world.sprites
    for i, thing in enumerate(things):
        for name, value in thing.items():
            values = getattr(sprites, name)
            sprites = sprites._replace(**{name: values.at[i].set(jnp.asarray(value, values.dtype))})
    return START.world._replace(sprites=sprites, num_sprites=jnp.int32(len(things)))


def mario_at(x: float, y: float, y_old: float | None = None, on_ground: bool = True) -> Player:
    before = y if y_old is None else y_old
    return START.world.player._replace(
        x=jnp.float32(x), y=jnp.float32(y), y_old=jnp.float32(before), on_ground=jnp.bool_(on_ground)
    )


def goomba(x: float, y: float, dx: float = 0, dy: float = 0, **others: float) -> dict[str, float]:
    return {"x": x, "y": y, "x_old": x - dx, "y_old": y - dy, "kind": 3, "flags": 0, **others}


def number(kind: int, winged: int, moves: int, falls: int, row: int, column: int) -> int:
    return ((((kind - 1) * 2 + winged) * 3 + moves) * 2 + falls) * ROWS * COLUMNS + row * COLUMNS + column


def met(world: World, player: Player, ticks: float = 0) -> int:
    return int(encounter(world, player, jnp.float32(ticks)))


def test_encounters_by_hand():
    """A thing 13 pixels ahead at the height of Mario's feet lies in column 3 + 2 and row 6."""
    mario = mario_at(100, 207)
    assert met(world_with(goomba(113, 207)), mario) == number(3, 0, 0, 0, 6, 5)
    assert met(world_with(goomba(87, 206)), mario) == number(3, 0, 0, 0, 5, 0)
    assert met(world_with(goomba(113, 207, flags=2, dy=-3)), mario) == number(3, 1, 1, 0, 6, 5)
    assert met(world_with(goomba(113, 207, dy=3)), mario) == number(3, 0, 2, 0, 6, 5)
    assert met(world_with(goomba(113, 207)), mario_at(100, 190, y_old=180, on_ground=False)) == number(3, 0, 0, 1, 8, 5)
    assert met(world_with(goomba(113, 207, kind=5)), mario) == number(5, 0, 0, 0, 6, 5)
    for far in (goomba(118, 207), goomba(81, 207), goomba(100, 243), goomba(100, 170)):
        assert met(world_with(far), mario) == -1
    assert met(world_with(), mario) == -1
    # The closer of two, wherever it is in the list.
    for things in ((goomba(113, 207), goomba(94, 207)), (goomba(94, 207), goomba(113, 207))):
        assert met(world_with(*things), mario) == number(3, 0, 0, 0, 6, 2)
    # It goes on as it moved in the last tick.
    assert met(world_with(goomba(133, 207, dx=-2)), mario, ticks=10) == number(3, 0, 0, 0, 6, 5)


def test_what_an_encounter_is_worth_by_hand():
    """Of the kind itself -50 and 0 were missed, of another kind at the same place -20."""
    places = 2 * ROWS * COLUMNS
    own, other, untried = 5, 5 + places, 5 + 2 * places
    kinds, at = np.zeros(NUM_ENCOUNTERS, np.float32), np.zeros(places, np.float32)
    missed, times, missed_at, times_at = kinds.copy(), kinds.copy(), at.copy(), at.copy()
    missed[own], times[own], missed[other], times[other], missed_at[5], times_at[5] = -50, 2, -20, 1, -70, 3
    sums, numbers, sums_at, numbers_at = map(jnp.asarray, (missed, times, missed_at, times_at))
    tables = Encounters(sums, numbers, sums_at, numbers_at, jnp.int32(-1))

    def worth(cell: int, trust: float = 1.0) -> float:
        return float(MarioEncounters(trust=trust).worth(tables, jnp.int32(cell)))

    assert worth(own) == pytest.approx((-50 - 17.5) / 3)
    assert worth(other) == pytest.approx((-20 - 17.5) / 2)
    assert worth(untried) == pytest.approx(-17.5)
    assert worth(untried, trust=4) == pytest.approx(-17.5)
    assert worth(own, trust=4) == pytest.approx((-50 - 4 * 17.5) / 6)
    assert worth(6) == 0
    assert worth(-1) == 0


@jax.jit
def observed(tables: Encounters, transition: Transition, learns: Any = True) -> Encounters:
    return MODEL.observe(ENV, tables, transition, jnp.asarray(learns))


@jax.jit
def step(state: Any, action: jax.Array) -> Any:
    after, reward, terminated, _ = ENV.transition(state, action, (), ENV.default_params)
    return after, reward, terminated


@jax.jit
def promises(tables: Encounters, episode: Any, action: jax.Array) -> Any:
    model, start = MODEL.planned(ENV, tables, episode)
    given, runner = MarioDynamics().planned(ENV, (), episode)
    after, reward, ended = model(start, action)
    alone, of_given = given(runner, action)
    return after.runner, reward, ended, alone, of_given


@pytest.mark.slow
def test_a_death_is_learned_and_foreseen():
    """Mario runs into a goomba; after it was learned, the model promises the death in that step, and no other."""
    tables, state, terminated, states = MODEL.init(ENV), begin(ENV.course, 0), False, []
    while not terminated:
        after, reward, terminated = step(state, jnp.int32(RIGHT_SPEED))
        states.append(state)
        unlearned = observed(tables, Transition(state, jnp.int32(RIGHT_SPEED), reward, after, terminated), False)
        for leaf, old in zip(jax.tree.leaves(unlearned), jax.tree.leaves(tables), strict=True):
            np.testing.assert_array_equal(leaf, old)
        tables = observed(tables, Transition(state, jnp.int32(RIGHT_SPEED), reward, after, terminated))
        state = after
    assert int(state.world.player.death_time) > 0
    assert float(tables.missed.min()) < -45
    assert float(tables.times.sum()) == float(tables.times_at.sum()) >= 1
    fresh = MODEL.init(ENV)
    foreseen = []
    for at in states:
        if at.phase == 0:
            runner, reward, ended, alone, of_given = promises(tables, at, jnp.int32(RIGHT_SPEED))
            for leaf, expected in zip(jax.tree.leaves(runner), jax.tree.leaves(alone), strict=True):
                np.testing.assert_array_equal(leaf, expected)
            foreseen.append((bool(ended), float(reward) - float(of_given)))
            _, without, is_over, *_ = promises(fresh, at, jnp.int32(RIGHT_SPEED))
            assert not bool(is_over)
            assert float(without) == float(of_given)
    assert foreseen[-1][0]
    assert foreseen[-1][1] < -20
    assert not any(ended for ended, _ in foreseen[:-2])


def test_bad_numbers_are_refused():
    with pytest.raises(ValueError, match="MarioEncounters: trust must be a finite number in"):
        MarioEncounters(trust=0.0)
    root = hrl.SearchRoot(model=MarioEncounters(), answer="leaf")
    assert hrl.RelationalHORDQ(root).root == root
