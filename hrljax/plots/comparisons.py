"""Several learners side by side."""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from hrljax.core import checks
from hrljax.plots import style
from hrljax.stats import Statistic
from hrljax.stats.arguments import check_named


def intervals(
    values: Mapping[str, xr.DataArray],
    statistics: Sequence[Statistic] = ("mean", "interquartile_mean"),
    *,
    references: Mapping[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Statistics over seeds of several learners, a row each, with 95 % intervals.

    Args:
        values: by name, one number a run with the dimension ``seed`` only. The first is on top.
        statistics: what to show of each, a marker each: the mean (with Student's interval) or those of
            `stats.bootstrap_interval`. Infinite ones are left out.
        references: vertical lines by name.
        ax: where to draw; a new figure if None.

    Returns:
        The axes; ``ax.figure.savefig`` saves the picture.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: no values, no statistics, other dimensions, or no finished run.
    """
    check_named("values", values, "a mapping from names to DataArrays")
    statistics = checks.names("statistics", statistics)  # type: ignore[assignment]
    if not values:
        raise ValueError("values must hold at least one array, got none")
    if not statistics:
        raise ValueError("statistics must be at least one, got none")
    for statistic in statistics:
        checks.choice("statistic", statistic, Statistic)
    for name, runs in values.items():
        style.check_seeds(runs, repr(name))
    ax = style.axes(ax, 8, 1.4 + 0.45 * len(values))
    rows = np.arange(len(values))
    apart = 0.5 / len(statistics)
    for number, (statistic, line, marker) in enumerate(zip(statistics, style.lines(), style.markers(), strict=False)):
        parts = np.array([[float(part) for part in style.interval(runs, statistic)] for runs in values.values()])
        middle, low, high = np.where(np.isfinite(parts), parts, np.nan).T
        place = rows + apart * (number - (len(statistics) - 1) / 2)
        ax.hlines(place, low, high, color=line["color"], lw=3, alpha=0.45)
        ax.plot(middle, place, marker, color=line["color"], ms=6, label=style.readable(statistic))
    ax.set_yticks(rows, [f"{name} ({style.finished(runs)})" for name, runs in values.items()])
    ax.set_ylim(len(values) - 0.5, -0.5)
    style.references(ax, references, vertical=True)
    ax.set_xlabel(style.label(next(iter(values.values()))))
    ax.grid(axis="x", color="#dddddd", lw=0.6)
    ax.set_axisbelow(True)
    style.tidy(ax, legend_above=True)
    return ax
