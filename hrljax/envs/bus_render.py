"""Pictures of the Bus domain: text, the map, and policies and values on it.

The drawing functions need matplotlib, but neither a display nor pyplot. Without `ax` they draw on
a new figure, which is ``ax.figure``. Passengers are numbered from 0 in the map's reading order.

A policy or a value is drawn for all cells at once, with the rest of the state given: `picked` (bit
i: passenger i is on board), `road` (0: no construction, i: the i-th site is under construction) and
`damaged` (0 or 1). Cells where no such state occurs stay empty: those of waiting passengers, those
that cannot be reached past them and, with every passenger on board, the start.

All functions raise ValueError where an argument has the wrong shape or type or is out of range.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle, Rectangle
from numpy.typing import ArrayLike

from hrljax.envs.bus import Bus, BusState
from hrljax.envs.bus_map import MOVES, BusMap

_AREA_COLOURS = ("#BBCCEE", "#CCDDAA", "#EEEEBB", "#FFCCCC", "#CCEEFF", "#DDDDDD")  # "pale" of Paul Tol
_VALUE_COLOURS = ListedColormap(colormaps["YlGnBu_r"](np.linspace(0.45, 1.0, 256))).with_extremes(bad="#E4E4E4")
_INK, _FAINT, _ALARM, _BUS, _PASSENGER = "#222222", "#777777", "#CC3311", "#DDAA33", "#004488"


class _Scene(NamedTuple):
    """What a picture shows, in integers that have been checked."""

    damaged: int = 0
    picked: int = 0
    road: int = 0
    cell: int = -1  # of the bus; -1: no bus


def text(env: Bus, state: BusState | None = None) -> str:
    """The map as text, which `hrljax.envs.bus_map.parse` reads if there is no `state`.

    With a state, the bus stands in front of the area's name, as ``@`` or, if damaged, ``!``;
    passengers on board are gone from the map, and a last line tells the rest of the state.
    """
    layout = env.layout
    lines = [list(line.rstrip()) for line in env.map.splitlines()[: 2 * layout.height + 1]]
    if state is not None:
        scene = _scene_of(env, state)
        on_board = set(layout.passengers) - set(_waiting(layout, scene).values())
        for cell, offset, mark in [*((c, 3, " ") for c in on_board), (scene.cell, 1, "!" if scene.damaged else "@")]:
            lines[2 * (cell // layout.width) + 1][4 * (cell % layout.width) + offset] = mark
        lines.append(list(_status(layout, scene)))
    return "".join("".join(line) + "\n" for line in lines)


def draw_map(env: Bus, ax: Axes | None = None, state: BusState | None = None) -> Axes:
    """Draws the map and, with a `state`, the bus, the waiting passengers and the construction."""
    scene = _Scene() if state is None else _scene_of(env, state)
    axes = _draw_ground(env, ax, scene).axes
    axes.title.set_text("" if state is None else _status(env.layout, scene))
    return axes


def draw_policy(
    env: Bus, policy: ArrayLike, ax: Axes | None = None, *, picked: int = 0, road: int = 0, damaged: int = 0
) -> Axes:
    """Draws the actions of an ``[S]`` policy as arrows, one in each cell where such a state occurs."""
    scene = _scene(env, damaged, picked, road)
    actions = _slice(env, scene, "policy", policy, "iu", "integers")
    if not np.isin(actions, range(env.num_actions)).all():
        raise ValueError(f"policy must have actions 0 to {env.num_actions - 1}, got {actions.min()} to {actions.max()}")
    axes = _draw_ground(env, ax, scene).axes
    row, column = np.nonzero(_occurs(env.layout, scene))
    down, right = 0.56 * np.array(MOVES)[actions[row, column]].T
    axes.quiver(
        *(column, row, right, down), pivot="mid", angles="xy", units="xy", scale_units="xy", scale=1, color=_INK,
        width=0.065, headwidth=3.6, headlength=3.4, headaxislength=3.1, zorder=4,
    )  # fmt: skip
    return axes


def draw_value(
    env: Bus, value: ArrayLike, ax: Axes | None = None, *, picked: int = 0, road: int = 0, damaged: int = 0
) -> Axes:
    """Draws an ``[S]`` value function as a heat map with numbers, and a colour bar beside `ax`."""
    scene = _scene(env, damaged, picked, road)
    values = _slice(env, scene, "value", value, "fiu", "real numbers").astype(np.float64)
    occurs = _occurs(env.layout, scene)
    coloured = np.ma.masked_array(values, ~(occurs & np.isfinite(values)))
    image = _draw_ground(env, _new_axes(env.layout, beside=1.1) if ax is None else ax, scene, coloured)
    decimals = int(np.clip(2 - np.floor(np.log10(max([1e-9, *np.abs(coloured.compressed())]))), 0, 3))
    for row, column in np.argwhere(occurs).tolist():
        _write(image.axes, column, row, f"{values[row, column]:z.{decimals}f}", 0.22)
    bar = image.axes.inset_axes((1 + 0.25 / values.shape[1], 0.0, 0.3 / values.shape[1], 1.0))
    image.axes.figure.colorbar(image, cax=bar, label="expected return")
    return image.axes


def rgb_array(env: Bus, state: BusState) -> np.ndarray:
    """The picture of a state as ``[H, W, 3]`` uint8; its size depends on the map only."""
    canvas = FigureCanvasAgg(draw_map(env, state=state).figure)  # type: ignore[arg-type]
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _integer(argument: str, value: ArrayLike, largest: int, meaning: str) -> int:
    array = np.asarray(value)
    if array.ndim or array.dtype.kind not in "iub" or not 0 <= array <= largest:
        raise ValueError(f"{argument} must be an integer from 0 to {largest} ({meaning}), got {array.tolist()!r}")
    return int(array)


def _scene(env: Bus, damaged: ArrayLike, picked: ArrayLike, road: ArrayLike, prefix: str = "") -> _Scene:
    roads = ", ".join(f"{i}: {name}" for i, name in enumerate(("no construction", *env.layout.site_names)))
    count = len(env.layout.passengers)
    return _Scene(
        damaged=_integer(f"{prefix}damaged", damaged, 1, "0: sound, 1: damaged"),
        picked=_integer(f"{prefix}picked", picked, 2**count - 1, "bit i: passenger i is on board"),
        road=_integer(f"{prefix}road", road, env.num_sites, roads),
    )


def _scene_of(env: Bus, state: BusState) -> _Scene:
    scene = _scene(env, state.damaged, state.picked, state.road, "state.")
    return scene._replace(cell=_integer("state.cell", state.cell, env.layout.num_cells - 1, "row * width + column"))


def _slice(env: Bus, scene: _Scene, argument: str, table: ArrayLike, kinds: str, meaning: str) -> np.ndarray:
    """``[height, width]``: the entries of an ``[S]`` table for the flags of a scene."""
    array = np.asarray(table)
    if array.shape != (env.num_states,) or array.dtype.kind not in kinds:
        allowed = f"{meaning} of shape ({env.num_states},)"
        raise ValueError(f"{argument} must be {allowed}, got {array.dtype} of shape {array.shape}")
    damaged, picked, road, time = map(jnp.int32, (scene.damaged, scene.picked, scene.road, 0))
    state = BusState(jnp.arange(env.layout.num_cells, dtype=jnp.int32), damaged, picked, road, time)
    return array[np.asarray(env.encode(state))].reshape(env.layout.height, env.layout.width)


def _waiting(layout: BusMap, scene: _Scene) -> dict[int, int]:
    """The cells of the passengers that are not on board, by their numbers."""
    return {i: cell for i, cell in enumerate(layout.passengers) if not scene.picked >> i & 1}


def _occurs(layout: BusMap, scene: _Scene) -> np.ndarray:
    """``[height, width]`` bool: an episode that goes on can have the bus here, with these passengers on board."""
    waiting = _waiting(layout, scene)
    reached, before = np.arange(layout.num_cells) == layout.start, np.zeros(layout.num_cells, np.bool_)
    while (reached != before).any():
        before = reached.copy()
        reached[layout.neighbour[before]] = True
        reached[list(waiting.values())] = False
    reached[layout.start] = bool(waiting)
    return reached.reshape(layout.height, layout.width)


def _status(layout: BusMap, scene: _Scene) -> str:
    picked = ", ".join(str(i) for i in range(len(layout.passengers)) if i not in _waiting(layout, scene))
    bus, road = ("sound", "damaged")[scene.damaged], ("none", *layout.site_names)[scene.road]
    return f"construction: {road} | bus: {bus} | picked: {picked or 'none'}"


def _centre(layout: BusMap, cell: int) -> tuple[int, int]:
    """The x and y of a cell in the coordinates of the pictures."""
    return cell % layout.width, cell // layout.width


def _new_axes(layout: BusMap, beside: float = 0.0) -> Axes:
    """Axes for a map with `beside` inches to their right."""
    scale = min(0.75, 24.0 / max(layout.height, layout.width))
    width, height = layout.width * scale, layout.height * scale
    full_width, full_height = max(width, 4.0) + 0.2 + beside, max(height, 1.5) + 0.45
    left, bottom = (full_width - beside - width) / 2, (full_height - 0.25 - height) / 2
    extent = (left / full_width, bottom / full_height, width / full_width, height / full_height)
    return Figure(figsize=(full_width, full_height)).add_axes(extent)


def _draw_ground(env: Bus, ax: Axes | None, scene: _Scene, values: np.ndarray | None = None) -> AxesImage:
    """Draws all but arrows and numbers; colours the cells by ``[height, width]`` `values` or else by area."""
    layout = env.layout
    ax = _new_axes(layout) if ax is None else ax
    palette = np.array([to_rgb(_AREA_COLOURS[area % len(_AREA_COLOURS)]) for area in range(len(layout.area_names))])
    cells = palette[layout.area].reshape(layout.height, layout.width, 3) if values is None else values
    image = ax.imshow(cells, cmap=_VALUE_COLOURS, interpolation="nearest")
    ax.set(xlim=(-0.5, layout.width - 0.5), ylim=(layout.height - 0.5, -0.5))
    ax.set_axis_off()
    ax.set_title(_status(layout, scene), fontsize=9)

    centre = np.array([_centre(layout, cell) for cell in range(layout.num_cells)])[:, None, None]
    step = np.array(MOVES)[:, None, ::-1]
    edge = centre + 0.5 * (step + step[..., ::-1] * np.array([[-1], [1]]))  # [cells, 4, 2 ends, x and y]
    is_wall = layout.neighbour == np.arange(layout.num_cells)[:, None]
    is_door = ~is_wall & (layout.area[layout.neighbour] != layout.area[:, None])
    styles = (~is_wall & ~is_door, "white", 0.015, "-"), (is_door, _FAINT, 0.03, ":"), (is_wall, _INK, 0.07, "-")
    for chosen, colour, width, style in styles:
        lines = LineCollection(list(edge[chosen]), colors=colour, linewidths=width * _cell_points(ax), linestyles=style)
        ax.add_collection(lines, autolim=False).set_clip_on(False)

    for area, name in enumerate(layout.area_names):
        x, y = _centre(layout, int(np.argmax(layout.area == area)))
        _write(ax, x - 0.34, y - 0.32, name, 0.24, weight="bold")
    _write(ax, layout.start % layout.width + 0.34, layout.start // layout.width + 0.32, "S", 0.24, weight="bold")
    for cell, move in np.argwhere(layout.site * (0, 1, 1, 0)).tolist():
        _draw_site(env, ax, cell, move, is_closed=layout.site[cell, move] == scene.road)
    for i, cell in _waiting(layout, scene).items():
        ax.add_patch(Circle(_centre(layout, cell), 0.26, facecolor=_PASSENGER, edgecolor="white", zorder=3))
        _write(ax, *_centre(layout, cell), f"P{i}", 0.24, "white", weight="bold")
    if scene.cell >= 0:
        _draw_bus(ax, *_centre(layout, scene.cell), is_damaged=scene.damaged == 1)
    return image


def _draw_site(env: Bus, ax: Axes, cell: int, move: int, is_closed: bool) -> None:
    """Draws the site on an edge and, hatched, what damages the bus when the site is under construction."""
    (x, y), (down, right) = _centre(env.layout, cell), MOVES[move]
    if is_closed:
        reach, width, height = (1.0, 1.0, 1.0) if env.site == "cell" else (0.5, 0.16 + 0.7 * down, 0.16 + 0.7 * right)
        corner = x + reach * right - width / 2, y + reach * down - height / 2
        ax.add_patch(Rectangle(corner, width, height, facecolor="#FFF9", edgecolor=_ALARM, hatch="////", zorder=2.5))
    middle, colour = (x + right / 2, y + down / 2), _ALARM if is_closed else _FAINT
    ax.add_patch(Circle(middle, 0.15, facecolor="white", edgecolor=colour, linewidth=0.03 * _cell_points(ax), zorder=3))
    _write(ax, *middle, env.layout.site_names[env.layout.site[cell, move] - 1], 0.2, colour, weight="bold")


def _draw_bus(ax: Axes, x: float, y: float, is_damaged: bool) -> None:
    body = Rectangle((x - 0.31, y - 0.2), 0.62, 0.38, facecolor=_ALARM if is_damaged else _BUS, edgecolor=_INK)
    wheels = [Circle((x + right, y + 0.19), 0.08, facecolor=_INK) for right in (-0.16, 0.16)]
    windows = [Rectangle((x + right, y - 0.13), 0.14, 0.13, facecolor="white") for right in (-0.25, -0.07, 0.11)]
    for layer, patch in enumerate([*wheels, body, *windows]):
        patch.set_zorder(5 + 0.1 * layer)
        ax.add_patch(patch)
    if is_damaged:
        _write(ax, x + 0.39, y - 0.2, "!", 0.4, _ALARM, weight="bold")


def _cell_points(ax: Axes) -> float:
    """Size of a cell in points; an approximation where the figure's layout may still move the axes."""
    box, (left, right), (bottom, top) = ax.get_window_extent(), ax.get_xlim(), ax.get_ylim()
    return 72 / ax.figure.dpi * min(box.width / (right - left), box.height / (bottom - top))


def _write(ax: Axes, x: float, y: float, string: str, size: float, colour: str = _INK, weight: str = "normal") -> None:
    points = size * _cell_points(ax)
    ax.text(x, y, string, fontsize=points, ha="center", va="center_baseline", color=colour, weight=weight, zorder=7)
