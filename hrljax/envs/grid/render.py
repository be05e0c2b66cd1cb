"""What pictures of grids have in common: ground and walls, arrows, values, text and pixels.

Cells are numbered row by row; the x and y of a picture are a cell's column and row. Without `ax`,
drawing starts a new figure, which is ``ax.figure``, and needs neither a display nor pyplot.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.image import AxesImage
from matplotlib.patches import Circle, Rectangle
from numpy.typing import ArrayLike

from hrljax.core import checks, figures
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.envs.grid.ascii_map import MOVES, text_lines
from hrljax.solvers.model import Model

INK, FAINT, ALARM, VEHICLE, PERSON = "#222222", "#777777", "#CC3311", "#DDAA33", "#004488"
_REGION_COLOURS = ("#BBCCEE", "#CCDDAA", "#EEEEBB", "#FFCCCC", "#CCEEFF", "#DDDDDD")  # "pale" of Paul Tol
_VALUE_COLOURS = ListedColormap(colormaps["YlGnBu_r"](np.linspace(0.45, 1.0, 256))).with_extremes(bad="#E4E4E4")


class Ground(NamedTuple):
    """The part of a picture that the state does not change."""

    height: int
    width: int
    neighbour: np.ndarray  # [cells, 4] int32: the cell that a move reaches (itself at a wall)
    region: np.ndarray  # [cells] int32: the cells of a region have one colour; those of region -1 are solid

    def centre(self, cell: int) -> tuple[int, int]:
        """The x and y of a cell."""
        return cell % self.width, cell // self.width


def text_with(text: str, marks: Iterable[tuple[int, int, str]], status: str | None = None) -> str:
    """The text of a map with characters written over it, each with its line and column, and a last line."""
    lines = [list(line) for line in text_lines(text)]
    for line, column, mark in marks:
        lines[line][column] = mark
    lines += [] if status is None else [list(status)]
    return "".join("".join(line) + "\n" for line in lines)


def checked_integer(argument: str, value: ArrayLike, largest: int, meaning: str) -> int:
    """`value`, after checking that it is an integer from 0 to `largest`, or a bool that stands for 0 or 1."""
    is_flag = checks.is_number(value, np.bool_)
    return checks.integer(argument, int(value) if is_flag else value, 0, largest, meaning=meaning)  # type: ignore[arg-type]


def policy_at(env: AnyTabularEnvironment, policy: ArrayLike, states: ArrayLike) -> np.ndarray:
    """The actions of an ``[S]`` policy in states with these numbers, after checking it; -1 is none."""
    actions = _checked_table(env, "policy", policy, "iu", "integers")[np.asarray(states)]
    most = env.num_actions - 1
    if not np.isin(actions, range(-1, env.num_actions)).all():
        raise ValueError(
            f"policy must have actions 0 to {most}, or -1 for none, got {actions.min()} to {actions.max()}"
        )
    return actions


def value_at(env: AnyTabularEnvironment, value: ArrayLike, states: ArrayLike) -> np.ndarray:
    """The entries (float64) of an ``[S]`` value function for states with these numbers, after checking it."""
    return _checked_table(env, "value", value, "fiu", "real numbers")[np.asarray(states)].astype(np.float64)


def occurring_states(model: Model, initial: np.ndarray) -> np.ndarray:
    """``[S]`` bool: an episode that goes on can be in this state, if it begins by the probabilities `initial`."""
    successors = model.successors().reshape(model.num_states, -1)
    occurs, before = initial > 0, np.zeros(model.num_states, np.bool_)
    while (occurs != before).any():
        before = occurs.copy()
        following = successors[before]
        occurs[following[following >= 0]] = True
    return occurs


def _checked_table(env: AnyTabularEnvironment, argument: str, table: ArrayLike, kinds: str, meaning: str) -> np.ndarray:
    array = np.asarray(table)
    if array.shape != (env.num_states,) or array.dtype.kind not in kinds:
        allowed = f"{meaning} of shape ({env.num_states},)"
        raise ValueError(f"{argument} must be {allowed}, got {array.dtype} of shape {array.shape}")
    return array


def new_axes(ground: Ground, beside: float = 0.0) -> Axes:
    """Axes for a map with `beside` inches to their right."""
    scale = min(0.75, 24.0 / max(ground.height, ground.width))
    width, height = ground.width * scale, ground.height * scale
    full_width, full_height = max(width, 4.0) + 0.2 + beside, max(height, 1.5) + 0.45
    left, bottom = (full_width - beside - width) / 2, (full_height - 0.25 - height) / 2
    extent = (left / full_width, bottom / full_height, width / full_width, height / full_height)
    return figures.new_axes(full_width, full_height, extent)


def draw_ground(ground: Ground, ax: Axes | None, title: str = "", values: np.ndarray | None = None) -> AxesImage:
    """Draws cells, walls and doors between regions; colours the cells by ``[cells]`` `values` or else by region."""
    ax = new_axes(ground, beside=0.0 if values is None else 1.1) if ax is None else ax
    palette = np.array([to_rgb(colour) for colour in _REGION_COLOURS])[ground.region % len(_REGION_COLOURS)]
    cells = palette if values is None else values
    shape = (ground.height, ground.width, *cells.shape[1:])
    image = ax.imshow(cells.reshape(shape), cmap=_VALUE_COLOURS, interpolation="nearest")
    ax.set(xlim=(-0.5, ground.width - 0.5), ylim=(ground.height - 0.5, -0.5))
    ax.set_axis_off()
    ax.set_title(title, fontsize=9)
    is_solid = ground.region < 0
    for cell in np.flatnonzero(is_solid).tolist():
        x, y = ground.centre(cell)
        ax.add_patch(Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, facecolor=INK, edgecolor=INK, linewidth=0.5))

    centre = np.array([ground.centre(cell) for cell in range(len(is_solid))])[:, None, None]
    step = np.array(MOVES)[:, None, ::-1]
    edge = centre + 0.5 * (step + step[..., ::-1] * np.array([[-1], [1]]))  # [cells, 4, 2 ends, x and y]
    is_wall = ground.neighbour == np.arange(len(is_solid))[:, None]
    is_door = ~is_wall & (ground.region[ground.neighbour] != ground.region[:, None])
    styles = (~is_wall & ~is_door, "white", 0.015, "-"), (is_door, FAINT, 0.03, ":"), (is_wall, INK, 0.07, "-")
    for chosen, colour, width, style in styles:
        segments = list(edge[chosen & ~is_solid[:, None]])
        lines = LineCollection(segments, colors=colour, linewidths=width * cell_points(ax), linestyles=style)
        ax.add_collection(lines, autolim=False).set_clip_on(False)
    return image


def draw_actions(
    ax: Axes, ground: Ground, actions: np.ndarray, shown: np.ndarray, signs: Sequence[tuple[int, int] | str]
) -> None:
    """Draws ``[cells]`` actions where `shown` (bool) and not -1, each by its sign: a (row, column) step or a text."""
    shown = shown & (actions >= 0)
    steps = np.array([(0, 0) if isinstance(sign, str) else sign for sign in signs])[actions]
    is_step = shown & steps.any(-1)
    down, right = 0.56 * steps[is_step].T
    row, column = np.divmod(np.flatnonzero(is_step), ground.width)
    ax.quiver(
        *(column, row, right, down), pivot="mid", angles="xy", units="xy", scale_units="xy", scale=1, color=INK,
        width=0.065, headwidth=3.6, headlength=3.4, headaxislength=3.1, zorder=4,
    )  # fmt: skip
    for cell in np.flatnonzero(shown & ~is_step).tolist():
        sign = str(signs[actions[cell]])
        write(ax, *ground.centre(cell), sign, min(0.24, 1.3 / max(map(len, sign.split("\n")))), weight="bold")


def shown_values(values: np.ndarray, shown: np.ndarray) -> np.ma.MaskedArray:
    """``[cells]``: the values that a picture colours: finite ones where `shown` (bool)."""
    return np.ma.masked_array(values, ~(shown & np.isfinite(values)))


def draw_numbers(image: AxesImage, ground: Ground, values: np.ndarray, shown: np.ndarray) -> None:
    """Writes ``[cells]`` values where `shown` (bool) and draws a colour bar beside the axes of `image`."""
    greatest = max([1e-9, *np.abs(shown_values(values, shown).compressed())])
    decimals = int(np.clip(2 - np.floor(np.log10(greatest)), 0, 3))
    for cell in np.flatnonzero(shown).tolist():
        write(image.axes, *ground.centre(cell), f"{values[cell]:z.{decimals}f}", 0.22)
    bar = image.axes.inset_axes((1 + 0.25 / ground.width, 0.0, 0.3 / ground.width, 1.0))
    image.axes.figure.colorbar(image, cax=bar, label="expected return")


def draw_disc(ax: Axes, x: float, y: float, label: str, radius: float = 0.26, layer: float = 3) -> None:
    """Draws an agent or a passenger: a disc with a label."""
    ax.add_patch(Circle((x, y), radius, facecolor=PERSON, edgecolor="white", zorder=layer))
    write(ax, x, y, label, radius * 12 / 13, "white", weight="bold")


def draw_vehicle(ax: Axes, x: float, y: float, colour: str = VEHICLE) -> None:
    """Draws a bus or a taxi."""
    body = Rectangle((x - 0.31, y - 0.2), 0.62, 0.38, facecolor=colour, edgecolor=INK)
    wheels = [Circle((x + right, y + 0.19), 0.08, facecolor=INK) for right in (-0.16, 0.16)]
    windows = [Rectangle((x + right, y - 0.13), 0.14, 0.13, facecolor="white") for right in (-0.25, -0.07, 0.11)]
    for layer, patch in enumerate([*wheels, body, *windows]):
        patch.set_zorder(5 + 0.1 * layer)
        ax.add_patch(patch)


def cell_points(ax: Axes) -> float:
    """Size of a cell in points; an approximation where the figure's layout may still move the axes."""
    box, (left, right), (bottom, top) = ax.get_window_extent(), ax.get_xlim(), ax.get_ylim()
    return 72 / ax.figure.dpi * min(box.width / (right - left), box.height / (bottom - top))


def write(ax: Axes, x: float, y: float, string: str, size: float, colour: str = INK, weight: str = "normal") -> None:
    """Writes a text of `size` cells around a point."""
    points = size * cell_points(ax)
    ax.text(x, y, string, fontsize=points, ha="center", va="center_baseline", color=colour, weight=weight, zorder=7)


def pixels(ax: Axes) -> np.ndarray:
    """The figure of `ax` as ``[H, W, 3]`` uint8."""
    canvas = FigureCanvasAgg(ax.figure)  # type: ignore[arg-type]
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
