"""A search drawn on the level: its tree, its plan, and where Mario really went (thesis Figure 4.3(b))."""

from collections.abc import Sequence

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
from hrljax.search.best_first import SearchResult
from hrljax.search.nodes import edges, to_nodes

_PIXELS = 32
"""Points per tile."""
_MARGIN = 2
"""Columns that are shown beyond everything that is drawn."""
_EDGE, _REAL = "0.1", plots.COLOURS[0]


def largest_search(agent: Agent, game: Sequence[Step]) -> int:
    """The step of a game after which the search has the most nodes, the first of equals.

    Raises:
        ValueError: the game has no step after which it goes on.
    """
    sizes = {
        number: int(agent.search(agent.tables, step.episode).tree.num_nodes)
        for number, step in enumerate(game)
        if int(step.episode.phase) == PLAYING
    }
    if not sizes:
        raise ValueError("the game must have a step after which it goes on")
    return max(sizes, key=sizes.__getitem__)


def search_picture(agent: Agent, game: Sequence[Step], step: int) -> Figure:
    """The search after a step of a game, its plan, and the steps that really followed, as many as the plan has."""
    episode = game[step].episode
    searched = jax.device_get(agent.search(agent.tables, episode))
    followed = [other.episode for other in game[step : step + 1 + int(searched.length)]]
    places = np.stack([searched.tree.state.x, searched.tree.state.y], axis=1)[: int(searched.tree.num_nodes)]
    really = np.array([[float(other.world.player.x), float(other.world.player.y)] for other in followed])
    columns = _columns(agent, episode, np.concatenate([places, really])[:, 0])
    return _drawn(agent, episode, searched, places, really, columns)


def _drawn(
    agent: Agent,
    episode: Episode,
    searched: SearchResult,
    places: np.ndarray,
    really: np.ndarray,
    columns: tuple[int, int],
) -> Figure:
    shown = picture.screen(agent.env.course, episode.world, _PIXELS, status=False, columns=columns)
    figure = Figure(figsize=(12, 12 * shown.shape[0] / shown.shape[1] + 0.9), layout="constrained")
    ax = figure.subplots()
    ax.imshow(shown)
    nodes = _points(places, columns)
    ax.add_collection(LineCollection(list(nodes[edges(searched.tree)]), colors=_EDGE, linewidths=0.6, alpha=0.6))
    values = np.asarray(searched.tree.value)[: len(nodes)]
    dots = ax.scatter(*nodes.T, c=values, s=16, cmap="viridis", edgecolors=_EDGE, linewidths=0.3, zorder=3)
    plan = [node.index for node in to_nodes(searched.tree)[int(searched.node)].path()]
    ax.plot(*nodes[plan].T, "o-", color=plots.COLOURS[1], lw=2.5, ms=6, zorder=5)
    ax.plot(*_points(really, columns).T, "s--", color=_REAL, lw=2, ms=5, mfc="none", zorder=6)
    ax.legend(
        handles=[
            Line2D([], [], color=plots.COLOURS[1], marker="o", lw=2.5, label="plan"),
            Line2D([], [], color=_REAL, marker="s", mfc="none", ls="--", lw=2, label="what followed"),
            Line2D([], [], color=_EDGE, marker=".", lw=0.6, label="searched"),
        ],
        loc="upper left",
    )
    figure.colorbar(dots, ax=ax, shrink=0.8, pad=0.01, label="predicted return of a node")
    ax.set(xlim=(0, shown.shape[1]), ylim=(shown.shape[0], 0))
    ax.set_title(f"{len(nodes) - 1} nodes; the plan promises {float(searched.value):+.2f}")
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
