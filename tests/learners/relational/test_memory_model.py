"""A memory of steps above a given model: what was met comes again, bit for bit, and all else is the model's."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.mario.competition import ENDED, OBSERVED, begin
from hrljax.envs.mario.env import Mario
from hrljax.learners.base import Transition
from hrljax.learners.relational.memory_model import Memories

WIDTH, RUN, RUN_AND_JUMP = 60, 6, 8


def goombas() -> str:
    """Ground, goombas that come towards Mario, and coins."""
    sky = ["." * WIDTH] * 11 + ["." * 6 + "c" * 8 + "." * (WIDTH - 14)] + ["." * WIDTH]
    things = [["."] * WIDTH for _ in range(15)]
    for column in (14, 19):
        things[12][column] = "o"
    things[12][55] = "!"
    return "\n".join(["type: overground", *sky, *["#" * WIDTH] * 2, "", *map("".join, things)])


ENV = Mario(levels=(goombas(),), preset="thesis")
MODEL = hrl.MarioMemory(model=hrl.MarioDynamics(), rows=40)


@jax.jit
def step(state: Any, action: jax.Array) -> Any:
    return ENV.transition(state, action, (), ENV.default_params)[:3]


@jax.jit
def observed(tables: Memories, transition: Transition, learns: jax.Array) -> Memories:
    return MODEL.observe(ENV, tables, transition, learns)


@jax.jit
def promises(tables: Memories, episode: Any, action: jax.Array) -> Any:
    model, start = MODEL.planned(ENV, tables, episode)
    given, runner = MODEL.model.planned(ENV, (), episode)
    return model(start, action), given(runner, action)


def played(actions: list[int]) -> list[Transition]:
    """A game of these actions, the last of them again and again."""
    state, terminated, transitions = begin(ENV.course, 0), False, []
    while not terminated:
        action = jnp.int32(actions[min(len(transitions), len(actions) - 1)])
        after, reward, terminated = step(state, action)
        transitions.append(Transition(state, action, reward, after, terminated))
        state = after
    return transitions


@pytest.mark.slow
def test_what_was_met_comes_again():
    games = [played([RUN]), played([RUN, RUN_AND_JUMP, RUN])]
    tables = MODEL.init(ENV)
    for transition in (transition for game in games for transition in game):
        unlearned = observed(tables, transition, jnp.bool_(False))
        assert int(unlearned.filled) == int(tables.filled)
        tables = observed(tables, transition, jnp.bool_(True))
    told = [t for game in games for t in game if int(t.state.phase) != ENDED]
    before = [(*map(float, t.state.world.player), int(t.state.keys), int(t.action)) for t in told]
    assert int(tables.filled) == len(set(before)) < len(told)  # the games begin with the same steps
    differs = 0
    for transition in told:
        after, real = transition.next_state, transition.next_state.world.player
        (runner, reward, ended), (alone, of_given) = promises(tables, transition.state, transition.action)
        for leaf, expected in zip(jax.tree.leaves(runner), jax.tree.leaves((real, after.keys)), strict=True):
            np.testing.assert_array_equal(leaf, expected)
        assert bool(ended) == (int(after.phase) in (ENDED, OBSERVED)) == bool(real.death_time > 0)
        if int(after.phase) != ENDED:
            assert float(reward) == pytest.approx(float(transition.reward), abs=1e-5)
        else:
            assert float(reward) < -40
        differs += (
            any(
                bool(jnp.any(one != other))
                for one, other in zip(jax.tree.leaves(runner.player), jax.tree.leaves(alone.player), strict=True)
            )
            or abs(float(reward) - float(of_given)) > 0.5
        )
    assert differs >= 2
    # Another action was not met.
    other = (told[3].action + 1) % ENV.num_actions
    (runner, reward, _), (alone, of_given) = promises(tables, told[3].state, other)
    for leaf, expected in zip(jax.tree.leaves(runner), jax.tree.leaves(alone), strict=True):
        np.testing.assert_array_equal(leaf, expected)
    assert float(reward) == float(of_given)


@pytest.mark.slow
def test_a_full_memory_keeps_what_it_has():
    game = played([RUN])
    tables, small = MODEL.init(ENV), MODEL.init(ENV)._replace(filled=jnp.int32(MODEL.rows - 2))
    for transition in game[:4]:
        tables, small = (observed(t, transition, jnp.bool_(True)) for t in (tables, small))
    assert int(small.filled) == MODEL.rows
    for number, transition in enumerate(game[:4]):
        (_, reward, _), (_, of_given) = promises(small, transition.state, transition.action)
        expected = transition.reward if number < 2 else of_given
        assert float(reward) == pytest.approx(float(expected), abs=1e-6)


@pytest.mark.slow
def test_a_planner_with_it_does_not_die_the_same_death_for_ever(quick_compiler: None):
    """Mario's own dynamics know nothing of goombas; a planner that went by them alone would repeat its first game."""
    root = hrl.AStarRoot(model=replace(MODEL, rows=400), max_expansions=32, horizon=8)
    learner = hrl.RelationalHORDQ(root, pseudo_reward=1e6, epsilon=0.0)
    run = jax.jit(lambda key: hrl.train(ENV, learner, key, 4, bin_size=1))(jax.random.key(0))
    np.testing.assert_array_equal(run.metrics["death"], 1)
    assert float(run.metrics["return"][1]) > float(run.metrics["return"][0])
    # Every later game ends with a step that was in none before: another way, or another key in vain.
    assert int(run.learned.root.filled) >= int(run.metrics["length"][0]) + 3


def test_bad_options_are_refused():
    with pytest.raises(TypeError, match="MarioMemory: model must be a MarioDynamics or MarioEncounters"):
        hrl.MarioMemory(model=hrl.MarioModel())  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="MarioMemory: rows must be"):
        hrl.MarioMemory(rows=0)
