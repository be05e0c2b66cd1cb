"""The game as a planner's model: what it promises is what the engine does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.envs.mario.competition import Episode, begin, unbegun
from hrljax.envs.mario.engine.state import new_player
from hrljax.envs.mario.env import ALL_ACTIONS, Mario
from hrljax.envs.mario.levels.ascii import to_ascii
from hrljax.envs.mario.levels.generator import generate_level
from hrljax.envs.mario.simulator import Simulator, power
from hrljax.envs.mario.stretch import TOP_SPEED, TOP_STEP, reach

WIDTH = 130
RUN = ALL_ACTIONS.index((1, 0, 1))
PLAIN, HARD = range(2)


def plain() -> str:
    """Ground with nothing on it."""
    ground = ["." * WIDTH] * 13 + ["#" * WIDTH] * 2
    things = [["."] * WIDTH for _ in range(15)]
    things[12][55] = "!"
    return "\n".join(["type: overground", *ground, "", *map("".join, things)])


ENV = Mario(levels=(plain(), to_ascii(generate_level(3, 0, 5, width=WIDTH - 50))), preset="thesis", actions="all")
begun = jax.jit(lambda level: begin(ENV.course, level))


@jax.jit
def step(start: Episode, episode: Episode, action: jax.Array):
    """A step of the engine, and what the model says of it when it looks ahead from `start`."""
    simulator = Simulator(ENV, start, ENV.default_params.max_steps, horizon=20, damage_cost=20.0)
    after, _, terminated, info = ENV.transition(episode, action, (), ENV.default_params)
    foreseen, cost = simulator.model(episode, action)
    return after, terminated, info, foreseen, cost, simulator.estimate(after), reach(after.world.player)


@pytest.mark.slow
def test_what_is_foreseen_is_what_the_engine_does():
    """Bit for bit in every field of a game with monsters, to its end; a death alone has no price."""
    generator, deaths = np.random.default_rng(2), 0
    for _ in range(4):
        start = episode = begun(HARD)
        terminated = False
        while not terminated:
            action = jnp.int32(generator.choice([RUN, RUN, 11, 11, 9, 3, 0]))
            episode, terminated, _, foreseen, cost, *_ = step(start, episode, action)
            for leaf, expected in zip(jax.tree.leaves(foreseen), jax.tree.leaves(episode), strict=True):
                np.testing.assert_array_equal(leaf, expected)
            died = bool(episode.world.player.death_time > 0)
            assert float(cost) == (np.inf if died else 1)
            deaths += died and bool(terminated)
    assert deaths


@pytest.mark.slow
def test_a_run_in_the_open_costs_what_was_estimated_from_its_start():
    """The estimate falls by 1 in every step at full speed, at every velocity, and by less otherwise."""
    start = begun(PLAIN)
    for _ in range(3):  # until he has landed and the speed key is held
        start, *_ = step(start, start, jnp.int32(RUN))
    _, _, _, _, _, estimate, x = step(start, start, jnp.int32(RUN))
    assert float(estimate) == pytest.approx(20 * 16 / TOP_STEP - 1, abs=1e-3)
    episode = start
    for number in range(1, 6):
        before = float(reach(episode.world.player))
        episode, _, _, _, _, estimate, x = step(start, episode, jnp.int32(RUN))
        assert float(x) - before == pytest.approx(float(TOP_STEP), abs=1e-2)
        assert float(estimate) == pytest.approx(20 * 16 / TOP_STEP - number, abs=5e-3)
    for slower in ((1, 0, 0), (0, 0, 0), (-1, 0, 1)):
        before = float(reach(episode.world.player))
        *_, after = step(start, episode, jnp.int32(ALL_ACTIONS.index(slower)))
        assert float(after) - before < 40
    assert float(TOP_STEP) == pytest.approx(49.09, abs=0.01)
    assert float(TOP_SPEED) == pytest.approx(9.709, abs=0.001)


@pytest.mark.slow
def test_the_exit_is_a_goal():
    start = episode = begun(PLAIN)
    estimate, terminated, info = 1.0, False, {}
    while not terminated:
        assert float(estimate) > 0
        episode, terminated, info, _, _, estimate, _ = step(episode, episode, jnp.int32(RUN))
        if episode.world.player.win_time > 0:
            assert float(estimate) == 0
            break
    assert bool(info["win"]) or bool(episode.world.player.win_time > 0)
    assert start.world.player.x == 32


def test_power_is_what_a_change_leads_to():
    small = new_player()
    assert int(power(small)) == 0
    assert int(power(new_player(large=True))) == 1
    assert int(power(new_player(large=True, fire=True))) == 2
    shrinking = new_player(large=True)._replace(
        power_up_time=jnp.int32(-9), large_after=jnp.bool_(False), fire_after=jnp.bool_(False)
    )
    assert int(power(shrinking)) == 0
    assert int(power(shrinking._replace(large_after=jnp.bool_(True), large=jnp.bool_(False)))) == 1


def test_places_tell_cells_and_depths_apart():
    start = unbegun(ENV.course, PLAIN)
    simulator = Simulator(ENV, start, 1000, horizon=20, damage_cost=20.0)
    rows, columns = 36, 48  # 288 pixels from top to bottom, 384 from left to right, in cells of 8

    def place(dx: float, dy: float, depth: int) -> int:
        player = start.world.player
        moved = player._replace(x=player.x + np.float32(dx), y=jnp.float32(dy))
        return int(simulator.place(start._replace(world=start.world._replace(player=moved)), jnp.int32(depth)))

    assert simulator.num_places(3) == 4 * rows * columns
    assert place(0, 0, 0) == 8 * rows + 4
    assert place(7.9, 7.9, 0) == place(0, 0, 0)
    assert place(8, 0, 0) - place(0, 0, 0) == rows
    assert place(0, 8, 0) - place(0, 0, 0) == 1
    assert place(0, 0, 2) - place(0, 0, 0) == 2 * rows * columns
    assert place(-1000, -1000, 0) == 0
    assert place(9999, 9999, 3) == simulator.num_places(3) - 1
