"""Mario by A* on the game itself: plans come true, and levels are finished."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.mario.competition import Episode, begin
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.levels.ascii import to_ascii
from hrljax.envs.mario.levels.generator import generate_level
from hrljax.envs.mario.stretch import TOP_STEP
from hrljax.learners.mario.a_star import MarioAStar
from hrljax.search.a_star import AStarResult

ENV = Mario(levels=(to_ascii(generate_level(7, 1, 3, width=80)),), preset="thesis", actions="all")
PLANNER = MarioAStar(max_expansions=64)


@pytest.mark.slow
def test_plans_come_true_and_lead_to_the_exit():
    """Every game that was looked on from is the one that the engine leads to by the actions on the way there."""

    @jax.jit
    def plan(episode: Episode):
        return PLANNER.search(ENV, episode)

    @jax.jit
    def step(episode: Episode, action: jax.Array):
        return ENV.transition(episode, action, (), ENV.default_params)

    episode, terminated, info, steps = begin(ENV.course, 0), False, {}, 0
    while not terminated:
        result = plan(episode)
        assert 1 <= int(result.num_expanded) <= 64
        if steps == 5:
            _check_tree(result, episode, step)
        episode, _, terminated, info = step(episode, result.action)
        steps += 1
    assert bool(info["win"])
    exit_column = int(ENV.course.exit_column[0])
    assert exit_column * 16 / TOP_STEP < steps < 100


def _check_tree(result: AStarResult, episode: Episode, step: Callable[..., Any]) -> None:
    nodes, count = result.nodes, int(result.num_expanded)
    assert count > 3
    games = {0: episode}
    for number in range(1, count):
        parent = int(nodes.parent[number])
        after, _, terminated, _ = step(games[parent], nodes.action[number])
        games[number] = after
        assert not bool(terminated)
        assert int(nodes.depth[number]) == int(nodes.depth[parent]) + 1
        for rows, leaf in zip(jax.tree.leaves(nodes.state), jax.tree.leaves(after), strict=True):
            np.testing.assert_array_equal(rows[number], leaf)


def test_another_environment_and_bad_numbers_are_refused():
    with pytest.raises(TypeError, match="env must be Mario"):
        PLANNER.prepare(hrl.make("Bus"))
    with pytest.raises(ValueError, match="depth must be an integer from 1 to"):
        MarioAStar(depth=0)
    with pytest.raises(ValueError, match="MarioAStar: weight must be a finite number in"):
        MarioAStar(weight=-1.0)
    assert int(PLANNER.action(jnp.int32(3))) == 3
