"""Pictures over swept hyper-parameters: heat maps and sensitivity."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import Normalize
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle

from hrljax import stats
from hrljax.core import checks
from hrljax.plots import style
from hrljax.stats import Statistic
from hrljax.stats.arguments import check_named
from hrljax.stats.settings import along_points

_WINNER = "#D55E00"
"""The colour of what is around the best."""
_MOST_TICKS = 12
"""Values of an axis up to which each gets a tick; points are where they are, and their labels would overlap."""


def heat_map(
    values: xr.DataArray | xr.Dataset,
    x: str,
    y: str,
    *,
    statistic: Statistic = "mean",
    limits: tuple[float, float] | None = None,
    best: Literal["greatest", "least"] | None = "greatest",
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """A statistic over seeds for every combination of two swept hyper-parameters, as colours and numbers.

    Of a sweep over `hrljax.points`, a dot a point, coloured.

    Args:
        values: one number a run, with the dimensions `x`, `y` (or ``point``) and ``seed``, such as
            ``stats.episode_range(curves["return"], 0, 1000)``; or a dataset of `hrljax.sweep`, of which the mean
            return of whole runs is taken. NaN (unfinished) and infinite (a threshold that is never reached)
            statistics stay grey.
        x: the dimension to the right.
        y: the dimension upwards.
        statistic: of the seeds.
        limits: values of the darkest and the lightest colour; those of the statistic if None.
        best: which cell gets a frame, which dot a ring.
        title: what is shown; the statistic and the number of seeds follow. Of a dataset it is learner and environment
            if empty.
        ax: where to draw; a new figure if None.

    Returns:
        The axes; ``ax.figure.savefig`` saves the picture.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: other dimensions, limits that are not in order, or no finished run.
    """
    if x == y:
        raise ValueError(f"x and y must differ, got {x!r} twice")
    if isinstance(values, xr.Dataset):
        title = title or f"{values.attrs['learner']} on {values.attrs['environment']}"
        values = stats.episode_range(values["return"], 0, int(values["episode"][-1]))
    is_of_points = isinstance(values, xr.DataArray) and {x, y} <= set(along_points(values))
    dims = ("point",) if is_of_points else (y, x)
    style.check_seeds(values, "values", *dims)
    checks.choice("best", best, ("greatest", "least", None))
    checks.choice("statistic", statistic, Statistic)
    chosen = None if limits is None else _checked_limits(limits)
    estimates = stats.estimate(values, statistic).transpose(*dims)
    cells = estimates.values
    drawn = np.ma.masked_invalid(cells)
    low, high = chosen or ((drawn.min(), drawn.max()) if drawn.count() else (0, 1))
    colours: dict[str, Any] = {"cmap": colormaps[style.COLOUR_MAP].with_extremes(bad="#dddddd")}
    colours["norm"] = Normalize(low, high)
    winner = int(drawn.argmax() if best == "greatest" else drawn.argmin()) if best and drawn.count() else None
    ax = style.axes(ax, *((7, 5) if is_of_points else (2.4 + 0.75 * cells.shape[1], 1.8 + 0.55 * cells.shape[0])))
    if is_of_points:
        image = _dots(ax, estimates[x].values, estimates[y].values, drawn, winner, colours)
    else:
        image = _cells(ax, estimates[x].values, estimates[y].values, drawn, winner, colours)
    ax.set_xlabel(style.label(values[x]))
    ax.set_ylabel(style.label(values[y]))
    below, above = bool((drawn < low).any()), bool((drawn > high).any())
    extend = "both" if below and above else "min" if below else "max" if above else "neither"
    ax.figure.colorbar(image, ax=ax, label=style.label(values), extend=extend)
    ax.set_title(f"{title + ', ' if title else ''}{style.readable(statistic)} ({style.finished(values)})")
    ax.spines[:].set_visible(False)
    return ax


def _cells(
    ax: Axes, x: np.ndarray, y: np.ndarray, cells: np.ma.MaskedArray, winner: int | None, colours: dict[str, Any]
) -> AxesImage:
    """Draws a cell a combination ``[y, x]``, and a frame around the winner."""
    image = ax.imshow(cells, **colours, origin="lower", aspect="auto", interpolation="nearest")
    for (row, column), value in np.ndenumerate(cells.data):
        dark = np.isfinite(value) and colours["norm"](value) < 0.6
        text = f"{value:.3g}" if np.isfinite(value) else "never" if np.isinf(value) else "none"
        ax.text(column, row, text, ha="center", va="center", size="small", color="white" if dark else "black")
    if winner is not None:
        row, column = np.unravel_index(winner, cells.shape)
        ax.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, ec=_WINNER, lw=2.5, clip_on=False))
    ax.set_xticks(range(cells.shape[1]), [f"{value:g}" for value in x])
    ax.set_yticks(range(cells.shape[0]), [f"{value:g}" for value in y])
    return image


def _dots(
    ax: Axes, x: np.ndarray, y: np.ndarray, values: np.ma.MaskedArray, winner: int | None, colours: dict[str, Any]
) -> PathCollection:
    """Draws a dot a point ``[points]``, and a ring around the winner."""
    image = ax.scatter(x, y, c=values, s=90, plotnonfinite=True, **colours)
    if winner is not None:
        ax.plot(x[winner], y[winner], "o", ms=14, mfc="none", mec=_WINNER, mew=2.5)
    ax.set_axisbelow(True)
    ax.grid(color="#dddddd", lw=0.6)
    ax.set_xscale("log" if _is_wide(x) else "linear")
    ax.set_yscale("log" if _is_wide(y) else "linear")
    return image


def _is_wide(places: np.ndarray) -> bool:
    """Whether the places on an axis are better seen on a logarithmic one."""
    return bool(places.min() > 0 and places.max() >= 10 * places.min())


def sensitivity(
    values: xr.DataArray | Mapping[str, xr.DataArray],
    x: str,
    *,
    lines: str | None = None,
    statistic: Statistic = "mean",
    references: Mapping[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """A statistic over seeds against a swept hyper-parameter, with bands of 95 % intervals.

    The axis is logarithmic where the values are positive and span a factor of ten. Of a sweep over `hrljax.points`,
    every point is a marker with a whisker.

    Args:
        values: one number a run, with the dimensions `x` (or ``point``), ``seed`` and perhaps `lines`; or several by
            name. Infinite statistics leave a gap.
        x: the hyper-parameter to the right.
        lines: a hyper-parameter each of whose values gets a line; needed if there is another dimension.
        statistic: of the seeds.
        references: horizontal lines by name.
        ax: where to draw; a new figure if None.

    Returns:
        The axes; ``ax.figure.savefig`` saves the picture.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: no values, other dimensions, or no finished run.
    """
    named = {"": values} if isinstance(values, xr.DataArray) else values
    check_named("values", named, "a DataArray, or a mapping from names to DataArrays")
    checks.choice("statistic", statistic, Statistic)
    if not named:
        raise ValueError("values must hold at least one array, got none")
    for name, array in named.items():
        what = repr(name) if name else "values"
        checks.instance(what, array, xr.DataArray, "a DataArray such as curves['return'].mean('episode')")
        more = (lines,) if lines is not None and (lines in array.dims or len(named) == 1) else ()
        style.check_seeds(array, what, "point" if x in along_points(array) else x, *more)
    ax = style.axes(ax)
    styles, markers = style.lines(), style.markers()
    for name, array in named.items():
        chosen = array[lines].values if lines in array.dims else [None]
        for value in chosen:
            runs = array if value is None else array.sel({lines: value})
            middle, low, high = (part.where(np.isfinite(part)) for part in style.interval(runs, statistic))
            line, marker = next(styles), next(markers)
            described = " ".join(part for part in (name, f"{lines}={value:g}" if value is not None else "") if part)
            described = described or style.readable(statistic)
            place, text = array[x].values, f"{described} ({style.finished(runs)})"
            if x not in array.dims:
                reach = (middle - low, high - middle)
                ax.errorbar(place, middle, reach, fmt=marker, ms=4, color=line["color"], elinewidth=1, label=text)
                continue
            ax.plot(place, middle, **line, marker=marker, ms=4, lw=1.4, label=text)
            ax.fill_between(place, low, high, color=line["color"], alpha=0.25, lw=0)
    places = np.unique(np.concatenate([array[x].values for array in named.values()]))
    if _is_wide(places):
        ax.set_xscale("log")
    if len(places) <= _MOST_TICKS and all(x in array.dims for array in named.values()):
        ax.set_xticks(places, [f"{place:g}" for place in places])
        ax.minorticks_off()
    style.references(ax, references)
    first = next(iter(named.values()))
    ax.set_xlabel(style.label(first[x]))
    ax.set_ylabel(f"{style.label(first)}, {style.readable(statistic)}")
    style.tidy(ax)
    return ax


def _checked_limits(limits: tuple[float, float]) -> tuple[float, float]:
    if not isinstance(limits, Sequence | np.ndarray) or len(limits) != 2:
        raise TypeError(f"limits must be two numbers, got {limits!r}")
    low, high = (checks.number(f"limits[{i}]", limit) for i, limit in enumerate(limits))
    if not low <= high:
        raise ValueError(f"limits must be in order, the lower one first, got {limits!r}")
    return low, high
