"""Task graphs as pictures and as text. Figures are made without pyplot: no display, no global state."""

from collections.abc import Mapping

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Patch
from matplotlib.path import Path

from hrljax.core import checks
from hrljax.core.figures import ShownFigure, new_axes
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.leaf_cover import TotalLeafCover

Added = Mapping[str, tuple[str, ...]]
"""Children that were added to subtasks, by subtask."""

_SUBTASK, _COVER, _ACTION = "#ffffff", "#cfe3f1", "#eeeeee"
_HIERARCHY = "a Hierarchy such as env.hierarchy()"
_EDGE, _ADDED_EDGE = "#777777", "#D55E00"


def text(hierarchy: Hierarchy, added: Added | None = None) -> str:
    """One line for each subtask: its children, those that were added after a plus; * marks the leaf cover."""
    checks.instance("hierarchy", hierarchy, Hierarchy, _HIERARCHY)
    cover, added = hierarchy.leaf_cover(), added or {}
    labels = [task.name + ("*" if task.name in cover else "") for task in hierarchy.subtasks]
    width = max(map(len, labels))
    lines = []
    for task, label in zip(hierarchy.subtasks, labels, strict=True):
        new = [child for child in task.children if child in added.get(task.name, ())]
        old = [child for child in task.children if child not in new]
        lines.append(" ".join([f"{label:{width}} ->", ", ".join(old), *(f"+ {child}" for child in new)]))
    return "\n".join(lines)


def draw(hierarchy: Hierarchy, added: Added | None = None, *, title: str = "", ax: Axes | None = None) -> Axes:
    """Draws a task graph: subtasks in layers by their distance from the root, actions below them.

    Args:
        hierarchy: the task graph.
        added: children that were added, whose edges are highlighted.
        title: above the picture.
        ax: where to draw; a new figure, as wide as the graph needs, if None.

    Returns:
        The axes; ``ax.figure.savefig`` saves the picture.
    """
    checks.instance("hierarchy", hierarchy, Hierarchy, _HIERARCHY)
    layers = _layers(hierarchy)
    if ax is None:
        ax = new_axes(*figure_size(hierarchy))
    cover, new = hierarchy.leaf_cover(), added or {}
    place = {
        name: ((slot + 0.5) / len(layer), -depth)
        for depth, layer in enumerate(layers)
        for slot, name in enumerate(layer)
    }
    for task in hierarchy.subtasks:
        for child in task.children:
            is_new = child in new.get(task.name, ())
            ax.add_patch(
                FancyArrowPatch(
                    path=Path(_route(place[task.name], place[child], layers, figure_size(hierarchy)[0])),
                    arrowstyle="-|>",
                    mutation_scale=10,
                    color=_ADDED_EDGE if is_new else _EDGE,
                    lw=1.8 if is_new else 0.9,
                    zorder=2 if is_new else 1,
                )
            )
    for name, (x, y) in place.items():
        primitive = hierarchy.is_primitive(name)
        colour = _ACTION if primitive else _COVER if name in cover else _SUBTASK
        box = {
            "boxstyle": "round,pad=0.35" if primitive else "square,pad=0.4",
            "fc": colour,
            "ec": "#444444",
            "lw": 0.8,
        }
        ax.text(x, y, name, ha="center", va="center", fontsize=9, bbox=box, zorder=3)
    handles: list[Artist] = [
        Patch(fc=_COVER, ec="#444444", label="subtask of the leaf cover"),
        Patch(fc=_SUBTASK, ec="#444444", label="other subtask"),
        Patch(fc=_ACTION, ec="#444444", label="primitive action"),
    ]
    if any(new.values()):
        handles.append(Line2D([], [], color=_ADDED_EDGE, lw=1.8, label="added child"))
    ax.legend(handles=handles, loc="upper right", fontsize="x-small", frameon=False)
    ax.set(xlim=(0, 1), ylim=(-len(layers) + 0.5, 0.5), title=title)
    ax.axis("off")
    return ax


def draw_completion(before: Hierarchy, total: TotalLeafCover) -> Figure:
    """A task graph without and with what its total leaf cover adds, one above the other."""
    checks.instance("before", before, Hierarchy, _HIERARCHY)
    checks.instance("total", total, TotalLeafCover, "what hrljax.total_leaf_cover returned")
    width, height = figure_size(total.hierarchy)
    figure = ShownFigure(figsize=(width, 2 * height), layout="constrained")
    upper, lower = figure.subplots(2)
    draw(before, title="As given", ax=upper)
    draw(total.hierarchy, total.added, title="With a total leaf cover", ax=lower)
    return figure


def figure_size(hierarchy: Hierarchy) -> tuple[float, float]:
    """Width and height in inches that a task graph needs."""
    layers = _layers(hierarchy)
    widest = max(sum(map(_inches, layer)) for layer in layers)
    return float(np.clip(widest, 5, 24)), 1.1 * len(layers) + 0.4


def _inches(name: str) -> float:
    return 0.09 * len(name) + 0.45


def _route(
    start: tuple[float, float], end: tuple[float, float], layers: list[list[str]], width: float
) -> list[tuple[float, float]]:
    """An edge's corners: straight, but past a box in between through the nearest gap of that layer."""
    (x, y), (to_x, to_y) = start, end
    corners = [(x, y - 0.17)]
    for depth in range(int(-y) + 1, int(-to_y)):
        layer = layers[depth]
        straight = x + (to_x - x) * (y + depth) / (y - to_y)
        slots = (np.arange(len(layer)) + 0.5) / len(layer)
        if np.any(np.abs(slots - straight) < np.array([_inches(name) for name in layer]) / 2 / width):
            gaps = np.arange(len(layer) + 1) / len(layer) if len(layer) > 1 else np.array([0.25, 0.75])
            gap = float(gaps[np.argmin(np.abs(gaps - straight))])
            corners += [(gap, 0.2 - depth), (gap, -0.2 - depth)]
    return [*corners, (to_x, to_y + 0.14)]


def _layers(hierarchy: Hierarchy) -> list[list[str]]:
    """Names by distance (longest path) from the root, the actions last; neighbours placed near each other."""
    depth = {task.name: 0 for task in hierarchy.subtasks}
    for task in sorted(hierarchy.subtasks, key=lambda task: -hierarchy.height(task.name)):
        for child in task.children:
            if not hierarchy.is_primitive(child):
                depth[child] = max(depth[child], depth[task.name] + 1)
    layers = [[name for name, at in depth.items() if at == level] for level in range(max(depth.values()) + 1)]
    layers.append(list(hierarchy.actions))
    callers = {
        name: [t.name for t in hierarchy.subtasks if name in t.children] for name in [*depth, *hierarchy.actions]
    }
    place: dict[str, float] = {}
    for layer in layers:
        mean = {name: np.mean([place[c] for c in callers[name]]) if callers[name] else 0.5 for name in layer}
        layer.sort(key=mean.__getitem__)
        place |= {name: (slot + 0.5) / len(layer) for slot, name in enumerate(layer)}
    return layers
