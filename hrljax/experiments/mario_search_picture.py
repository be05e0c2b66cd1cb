"""A search drawn on the level: its tree, its plan, and where Mario really went (thesis Figure 4.3(b))."""

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import jax
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hrljax import plots
from hrljax.envs.mario.competition import PLAYING, Episode
from hrljax.envs.mario.drawing import picture
from hrljax.envs.mario.levels.tiles import TILE
from hrljax.envs.mario.play import Step
from hrljax.experiments.mario_hybrid import Agent
from hrljax.search.a_star import AStarResult
from hrljax.search.best_first import SearchResult
from hrljax.search.nodes import edges, to_nodes

_PIXELS = 32
"""Points per tile."""
_MARGIN = 2
"""Columns that are shown beyond everything that is drawn."""
_EDGE, _REAL = "0.1", plots.COLOURS[0]


class Looked(NamedTuple):
    """What is drawn of a search."""

    places: np.ndarray  # [N, 2]: of the nodes, in pixels of the game
    edges: np.ndarray  # [N - 1, 2]: parent and child
    values: Any  # [N]
    plan: list[int]  # the nodes from the root on
    title: str
    meaning: str  # of the values


def looked_at(result: SearchResult | AStarResult) -> Looked:
    """What is drawn of a search; of A* the nodes that were expanded."""
    result = cast(SearchResult | AStarResult, jax.tree.map(np.asarray, result))
    if isinstance(result, SearchResult):
        tree, count = result.tree, int(result.tree.num_nodes)
        plan = [node.index for node in to_nodes(tree)[int(result.node)].path()]
        title = f"{count - 1} nodes; the plan promises {float(result.value):+.2f}"
        return Looked(
            _places(tree.state, count), edges(tree), tree.value[:count], plan, title, "predicted return of a node"
        )
    nodes, count, plan = result.nodes, int(result.num_expanded), [0]
    for action in result.actions[: int(result.length)]:
        next_one = np.flatnonzero((nodes.parent[:count] == plan[-1]) & (nodes.action[:count] == action))
        plan += next_one[:1].tolist()  # the end of a plan is not expanded
    both = np.stack([nodes.parent[1:count], np.arange(1, count)], axis=1)
    title = f"{count} nodes expanded; the plan costs {float(result.cost):.1f} steps"
    return Looked(_places(nodes.state, count), both, nodes.cost[:count], plan, title, "steps to a node")


def _places(state: Any, count: int) -> np.ndarray:
    return np.stack([state.x, state.y], axis=1)[:count]


def largest_search(agent: Agent, game: Sequence[Step]) -> int:
    """The step of a game after which the search has the most nodes, the first of equals.

    Raises:
        ValueError: the game has no step after which it goes on.
    """
    sizes = {
        number: len(looked_at(agent.search(agent.tables, step.episode)).places)
        for number, step in enumerate(game)
        if int(step.episode.phase) == PLAYING
    }
    if not sizes:
        raise ValueError("the game must have a step after which it goes on")
    return max(sizes, key=sizes.__getitem__)


def search_picture(agent: Agent, game: Sequence[Step], step: int) -> Figure:
    """The search after a step of a game, its plan, and the steps that really followed, as many as the plan has."""
    episode = game[step].episode
    result = agent.search(agent.tables, episode)
    searched = looked_at(result)
    followed = [other.episode for other in game[step : step + 1 + int(result.length)]]
    really = np.array([[float(other.world.player.x), float(other.world.player.y)] for other in followed])
    columns = _columns(agent, episode, np.concatenate([searched.places, really])[:, 0])
    shown = picture.screen(agent.env.course, episode.world, _PIXELS, status=False, columns=columns)
    figure = Figure(figsize=(12, 12 * shown.shape[0] / shown.shape[1] + 0.9), layout="constrained")
    ax = figure.subplots()
    ax.imshow(shown)
    nodes = _points(searched.places, columns)
    ax.add_collection(LineCollection(list(nodes[searched.edges]), colors=_EDGE, linewidths=0.6, alpha=0.6))
    dots = ax.scatter(*nodes.T, c=searched.values, s=16, cmap="viridis", edgecolors=_EDGE, linewidths=0.3, zorder=3)
    ax.plot(*nodes[searched.plan].T, "o-", color=plots.COLOURS[1], lw=2.5, ms=6, zorder=5)
    ax.plot(*_points(really, columns).T, "s--", color=_REAL, lw=2, ms=5, mfc="none", zorder=6)
    ax.legend(
        handles=[
            Line2D([], [], color=plots.COLOURS[1], marker="o", lw=2.5, label="plan"),
            Line2D([], [], color=_REAL, marker="s", mfc="none", ls="--", lw=2, label="what followed"),
            Line2D([], [], color=_EDGE, marker=".", lw=0.6, label="searched"),
        ],
        loc="upper left",
    )
    figure.colorbar(dots, ax=ax, shrink=0.8, pad=0.01, label=searched.meaning)
    ax.set(xlim=(0, shown.shape[1]), ylim=(shown.shape[0], 0))
    ax.set_title(searched.title)
    ax.set_axis_off()
    return figure


def _points(places: np.ndarray, columns: tuple[int, int]) -> np.ndarray:
    """Places of the game (``[N, 2]``, pixels of the game) as points of the picture."""
    return (places - np.array([columns[0] * TILE, 0])) * (_PIXELS / TILE)


def _columns(agent: Agent, episode: Episode, places: np.ndarray) -> tuple[int, int]:
    """The columns to show: what the camera sees, and all places (pixels of the game)."""
    camera = float(episode.world.camera)
    least, most = min(camera, float(places.min())), max(camera + picture.SCREEN_WIDTH, float(places.max()))
    return max(0, int(least // TILE) - _MARGIN), min(agent.env.course.num_columns, int(most // TILE) + _MARGIN)
