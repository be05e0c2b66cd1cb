"""A search drawn on the level, of a made-up model whose every node is known."""

from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from matplotlib.collections import LineCollection, PathCollection

from hrljax.envs.mario.competition import OBSERVED, PLAYING, Episode
from hrljax.envs.mario.engine.course import start
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.play import Step
from hrljax.experiments.mario_hybrid import Agent
from hrljax.experiments.mario_search_picture import largest_search, search_picture
from hrljax.search.a_star import AStarResult, a_star_search
from hrljax.search.best_first import SearchResult, best_first_search

POINTS = 2
"""Points of the picture to a pixel of the game."""


class Place(NamedTuple):
    x: Array
    y: Array


def model(place: Place, action: Array) -> tuple[Place, Array]:
    """Action 0 goes up a tile, action 1 goes three to the right."""
    right = action.astype(jnp.float32)
    return Place(place.x + 48 * right, place.y - 16 * (1 - right)), 3 * right


def search(nodes: Any, episode: Episode) -> SearchResult:
    player = episode.world.player
    max_nodes = int(player.x) // 10
    return best_first_search(model, Place(player.x, player.y), 2, depth=3, max_nodes=max_nodes, stop_reward=100.0)


def a_star(nodes: Any, episode: Episode) -> AStarResult:
    """Up costs one step and right two; of the six tiles to the goal every three are estimated at one."""
    player = episode.world.player

    def costly(place: Place, action: Array) -> tuple[Place, Array]:
        return model(place, action)[0], jnp.float32(1) + action.astype(jnp.float32)

    def estimate(place: Place) -> Array:
        return jnp.maximum((player.x + 96 - place.x) / 48, 0)

    return a_star_search(costly, Place(player.x, player.y), 2, estimate, depth=3, max_expansions=10)


ENV = Mario(preset="thesis")
AGENT = cast(Agent, SimpleNamespace(env=ENV, tables=(), search=search))


def step(x: float, y: float, phase: int = PLAYING) -> Step:
    world = start(ENV.course)
    world = world._replace(player=world.player._replace(x=jnp.float32(x), y=jnp.float32(y)))
    none = jnp.int32(0)
    return Step((1, 0, 1), 0.0, phase == OBSERVED, [], Episode(world, none, jnp.int32(phase), none, none))


GAME = [step(100, 150), step(40, 190), step(60, 180), step(80, 160), step(300, 150, OBSERVED)]


@pytest.mark.slow
def test_the_largest_search_is_of_a_moment_that_goes_on():
    assert largest_search(AGENT, GAME) == 0
    assert largest_search(AGENT, GAME[1:]) == 2
    with pytest.raises(ValueError, match="goes on"):
        largest_search(AGENT, GAME[4:])


def test_the_picture_has_the_tree_the_plan_and_what_followed():
    figure = search_picture(AGENT, GAME, 1)
    axes = figure.axes[0]
    plan, really = (np.asarray(line.get_xydata()) for line in axes.get_lines())
    # Two expansions, so the plan goes right twice; the picture begins at the level's left end.
    np.testing.assert_allclose(plan, POINTS * np.array([[40, 190], [88, 190], [136, 190]]))
    np.testing.assert_allclose(really, POINTS * np.array([[40, 190], [60, 180], [80, 160]]))
    (lines,) = (artist for artist in axes.collections if isinstance(artist, LineCollection))
    (dots,) = (artist for artist in axes.collections if isinstance(artist, PathCollection))
    segments = lines.get_segments()
    assert len(segments) == 4
    assert {tuple(end) for _, end in segments} == {tuple(dot) for dot in np.asarray(dots.get_offsets())[1:]}
    assert axes.get_title() == "4 nodes; the plan promises +6.00"


def test_the_picture_of_a_star_has_the_nodes_that_were_looked_on_from():
    agent = cast(Agent, SimpleNamespace(env=ENV, tables=(), search=a_star))
    axes = search_picture(agent, GAME, 1).axes[0]
    plan, really = (np.asarray(line.get_xydata()) for line in axes.get_lines())
    # Of equal f, that of the way which was generated first comes first: up, right, up up, up right, right up.
    expanded = [[40, 190], [40, 174], [88, 190], [40, 158], [88, 174], [88, 174]]
    parents = [0, 0, 1, 1, 2]
    # The plan is to go right twice; its end is not looked on from. Two steps followed.
    np.testing.assert_allclose(plan, POINTS * np.array([expanded[0], expanded[2]]))
    np.testing.assert_allclose(really, POINTS * np.array([[40, 190], [60, 180], [80, 160]]))
    (lines,) = (artist for artist in axes.collections if isinstance(artist, LineCollection))
    (dots,) = (artist for artist in axes.collections if isinstance(artist, PathCollection))
    np.testing.assert_allclose(np.asarray(dots.get_offsets()), POINTS * np.array(expanded))
    ends = [(expanded[parent], expanded[i]) for i, parent in enumerate(parents, start=1)]
    np.testing.assert_allclose(np.asarray(lines.get_segments()), POINTS * np.array(ends))
    np.testing.assert_allclose(np.asarray(dots.get_array()), [0, 1, 2, 2, 3, 3])
    assert axes.get_title() == "6 nodes expanded; the plan costs 4.0 steps"


@pytest.mark.slow
def test_the_picture_is_wide_enough_for_everything():
    shapes = {}
    for number in (0, 3):
        axes = search_picture(AGENT, GAME, number).axes[0]
        picture = axes.get_images()[0].get_array()
        assert picture is not None
        shapes[number] = picture.shape
        places = np.concatenate([np.asarray(line.get_xydata()) for line in axes.get_lines()])
        assert places.min() >= 0
        assert places[:, 0].max() <= picture.shape[1]
    assert shapes[0] == shapes[3] == (480, 22 * 32, 3)
    far = [step(310, 150), *GAME]
    array = search_picture(AGENT, far, 0).axes[0].get_images()[0].get_array()
    assert array is not None
    assert array.shape == (480, 30 * 32, 3)  # 310 and three times 48 is in column 28
