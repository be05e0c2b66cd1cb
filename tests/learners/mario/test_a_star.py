"""Mario by A* on the game itself: plans come true, and levels are finished."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.mario.competition import Episode, begin, unbegun
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.levels.ascii import to_ascii
from hrljax.envs.mario.levels.generator import generate_level
from hrljax.envs.mario.stretch import TOP_STEP
from hrljax.learners.base import Transition
from hrljax.learners.mario.a_star import MarioAStar
from hrljax.search.a_star import AStarResult, Nodes
from tests.contexts import learning

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


def result(actions: list[int], estimate: float) -> AStarResult:
    none = jnp.int32(0)
    nodes = Nodes((), jnp.zeros(1), none[None], none[None], none[None])
    row = jnp.array(actions, jnp.int32)
    return AStarResult(row, none, row[0], jnp.float32(0), jnp.float32(estimate), none, nodes)


class Scripted(MarioAStar):
    """Its searches give what an episode's `time` says."""

    def search(self, env: Mario, episode: Episode) -> AStarResult:
        return (result([3, 4, -1], 0.0), result([5, -1, -1], 2.0), result([6, 7, 8], -0.5))[int(episode.time)]


@pytest.mark.parametrize(
    ("searches", "actions"),
    [
        ([0, 0, 0], [3, 3, 3]),  # a new plan that arrives is followed
        ([0, 1, 1], [3, 4, 5]),  # one that does not is not, as long as the last one that did has steps left
        ([2, 1, 1, 1], [6, 7, 8, 5]),
        ([1, 1, 0, 1], [5, 5, 3, 4]),
        ([0, 1, 2, 1], [3, 4, 6, 7]),
    ],
)
def test_the_last_plan_is_kept_where_a_new_search_does_not_arrive(searches: list[int], actions: list[int]):
    agent, episode = Scripted(depth=3), unbegun(ENV.course, 0)
    at = [episode._replace(time=jnp.int32(number)) for number in searches]
    state = agent.init(ENV, ENV)
    assert int(agent.action(state.control)) == 0
    state = state._replace(control=agent.begin(ENV, (), at[0], (), learning()))
    taken = [int(agent.action(state.control))]
    for before, after in zip(at, at[1:], strict=False):
        told = Transition(before, jnp.int32(0), jnp.float32(0), after, jnp.bool_(False))
        state = agent.learn(ENV, state, told, (), learning())
        taken.append(int(agent.action(state.control)))
    assert taken == actions


def test_another_environment_and_bad_numbers_are_refused():
    with pytest.raises(TypeError, match="env must be Mario"):
        PLANNER.prepare(hrl.make("Bus"))
    with pytest.raises(ValueError, match="depth must be an integer from 1 to"):
        MarioAStar(depth=0)
    with pytest.raises(ValueError, match="MarioAStar: weight must be a finite number in"):
        MarioAStar(weight=-1.0)
