"""A* on Mario's own dynamics: what steps cost, what is not taken, and what is learned of meeting things."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.mario.competition import begin
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.stretch import TOP_STEP
from hrljax.learners.relational.encounter_model import MarioEncounters
from hrljax.search.a_star import AStarResult

WIDTH, FLAT, PIT, ABYSS = 70, 0, 1, 2
RUN, RUN_AND_JUMP = 6, 8


def level(pit: range, *goombas: int) -> str:
    """Ground, with a pit and goombas in some columns."""
    ground = "".join("." if column in pit else "#" for column in range(WIDTH))
    things = [["."] * WIDTH for _ in range(15)]
    for column in goombas:
        things[12][column] = "o"
    things[12][WIDTH - 5] = "!"
    return "\n".join(["type: overground", *["." * WIDTH] * 13, ground, ground, "", *map("".join, things)])


ENV = Mario(levels=(level(range(0), 12), level(range(14, 18)), level(range(8, 60))), preset="thesis")
ALONE = hrl.AStarRoot(model=hrl.MarioDynamics(), horizon=12, max_expansions=96)
LEARNS = hrl.AStarRoot(horizon=12, max_expansions=96)


@jax.jit
def step(episode: Any, action: jax.Array) -> Any:
    return ENV.transition(episode, action, (), ENV.default_params)[:2]


@jax.jit
def search(tables: Any, episode: Any) -> AStarResult:
    root = LEARNS if tables else ALONE
    return root.search(ENV, tables, episode)


def landed(number: int, steps: int) -> Any:
    """A moment of a run to the right."""
    assert ENV.action_names[RUN] == "right speed"
    episode = begin(ENV.course, number)
    for _ in range(steps):
        episode, _ = step(episode, jnp.int32(RUN))
    return episode


@pytest.mark.slow
def test_a_step_costs_one_and_what_it_loses_beside_the_distance():
    """On flat ground the thesis's rewards lose a hundredth a step, whatever the action."""
    result = search((), landed(FLAT, 3))
    count = int(result.num_expanded)
    lost = 0.01 / (float(TOP_STEP) / 16)
    costs, depths = (np.asarray(values)[:count] for values in (result.nodes.cost, result.nodes.depth))
    np.testing.assert_allclose(costs, depths * (1 + lost), atol=1e-4)
    assert float(result.cost) == pytest.approx(int(result.length) * (1 + lost), abs=1e-3)
    assert float(result.estimate) <= 0
    run = [int(action) for action in result.actions[: int(result.length)]]
    assert set(run) <= {RUN, RUN_AND_JUMP}  # he runs as fast in the air


@pytest.mark.slow
def test_no_way_leads_into_a_pit():
    episode = landed(PIT, 3)
    result = search((), episode)
    assert float(result.estimate) <= 0
    assert int(result.length) >= 4
    for action in result.actions[: int(result.length)]:
        episode, reward = step(episode, action)
        assert float(reward) > -10
        assert int(episode.world.player.death_time) == 0
    assert float(episode.world.player.x) > 17 * 16


@pytest.mark.slow
def test_a_death_is_no_way_even_where_there_is_no_other():
    result = search((), landed(ABYSS, 4))
    count = int(result.num_expanded)
    assert count < ALONE.max_expansions  # it looked everywhere
    assert not np.asarray(result.nodes.state.player.death_time)[:count].any()


@pytest.mark.slow
def test_what_is_learned_of_an_encounter_bends_the_way():
    """The model of Mario alone runs into the goomba; once it was learned that this is fatal, no plan does."""
    start = landed(FLAT, 2)
    fresh = LEARNS.init(ENV)
    through = search(fresh, start)
    assert [*through.actions] == [*search((), start).actions]
    nowhere = fresh._replace(missed_at=jnp.full_like(fresh.missed_at, -1e6))
    around = search(nowhere, start)
    model, state = MarioEncounters().planned(ENV, nowhere, start)
    step_of_model = jax.jit(model)
    for action in around.actions[: int(around.length)]:
        state, reward, ended = step_of_model(state, action)
        assert not bool(ended)
        assert float(reward) > -10
    assert [*around.actions] != [*through.actions]


@pytest.mark.slow
def test_it_is_a_root(quick_compiler: None):
    learner = hrl.RelationalHORDQ(LEARNS, pseudo_reward=1e6)
    assert learner.planning_interval == 1
    curves = hrl.sweep(ENV, learner, seeds=1, num_episodes=1, num_steps=1, axes={"root.weight": [1.0, 2.0]})
    assert curves["return"].shape == (2, 1, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": hrl.MarioModel()}, "AStarRoot: model must be a MarioDynamics, MarioEncounters or MarioMemory"),
        ({"horizon": 0}, "AStarRoot: horizon must be"),
        ({"max_expansions": 0}, "AStarRoot: max_expansions must be"),
        ({"depth": 0}, "AStarRoot: depth must be"),
        ({"weight": -1.0}, "AStarRoot: weight must be"),
        ({"follow": "never"}, "AStarRoot: follow must be one of"),
    ],
)
def test_bad_options_are_refused(options: dict[str, Any], message: str):
    with pytest.raises((TypeError, ValueError), match=message):
        hrl.AStarRoot(**options)
