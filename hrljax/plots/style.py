"""What all pictures share: colours, labels with units, counts of seeds, references."""

import itertools
from collections.abc import Hashable, Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from hrljax import stats
from hrljax.core import checks
from hrljax.core.figures import new_axes
from hrljax.stats import Statistic

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#999999")
"""Colours that colour-blind people can tell apart (Okabe and Ito)."""

COLOUR_MAP = "viridis"
"""Even in lightness: the same order for colour-blind people and in print."""

_DASHES = ("-", "--", "-.", ":")
_MARKERS = "osD^vPX*"


def axes(ax: Axes | None, width: float = 8, height: float = 5) -> Axes:
    """The axes, or new ones in a figure of their own."""
    if ax is None:
        return new_axes(width, height)
    return checks.instance("ax", ax, Axes, "Matplotlib's axes or None")


def lines() -> Iterator[dict[str, Any]]:
    """Styles of lines, without end: colours, and when they are used up, other dashes."""
    combined = ((dash, colour) for dash in itertools.cycle(_DASHES) for colour in COLOURS)
    return ({"color": colour, "ls": dash} for dash, colour in combined)


def markers() -> Iterator[str]:
    """Markers without end."""
    return itertools.cycle(_MARKERS)


def readable(name: Hashable) -> str:
    """The name of a variable or a hyper-parameter as people write it."""
    return str(name).replace("pseudo_reward", "pseudo-reward").replace("_", " ")


def label(values: xr.DataArray) -> str:
    """What an axis shows, with its units where they are known."""
    text = values.attrs.get("long_name") or readable(values.name)
    units = values.attrs.get("units")
    return f"{text} ({units})" if units else text


def finished(values: xr.DataArray, *along: Hashable) -> str:
    """How many seeds are in a picture; with further dimensions, those without a gap in them."""
    finite = values.notnull()
    counts = (finite.all(along) if along else finite).sum("seed")
    low, high = int(counts.min()), int(counts.max())
    return f"n={low}" if low == high else f"n={low} to {high}"


def interval(values: xr.DataArray, statistic: Statistic) -> tuple[xr.DataArray, xr.DataArray, xr.DataArray]:
    """A statistic over seeds with its 95 % interval: Student's of the mean, else the bootstrap's."""
    if statistic == "mean" and np.isfinite(values.where(values.notnull(), 0)).all():
        estimate = stats.mean_interval(values)
    else:
        estimate = stats.bootstrap_interval(values, statistic)
    return estimate[statistic], estimate["low"], estimate["high"]


def check_seeds(values: xr.DataArray, what: str, *allowed: Hashable) -> None:
    """Raises unless the values are an array whose dimensions are ``seed`` and those allowed."""
    checks.instance(what, values, xr.DataArray, "a DataArray such as curves['return'].mean('episode')")
    missing = [str(dim) for dim in ("seed", *allowed) if dim not in values.dims]
    if missing:
        raise ValueError(f"{what} must have the dimension {missing[0]!r}, got {', '.join(map(str, values.dims))}")
    more = [str(dim) for dim in values.dims if dim not in ("seed", *allowed)]
    if more:
        raise ValueError(f"{what} has the dimension {more[0]!r} that the picture does not show: select or reduce it")
    if not values.notnull().any():
        raise ValueError(f"{what} has no finished run: there is nothing to draw")


def references(ax: Axes, values: Mapping[str, float] | None, vertical: bool = False) -> None:
    """Lines across the picture by name."""
    draw = ax.axvline if vertical else ax.axhline
    values = checks.instance("references", values or {}, Mapping, "a mapping such as {'optimum': -24.6}")
    for (name, value), style in zip(values.items(), itertools.cycle(("--", ":", "-.")), strict=False):
        checks.number(f"references: {name}", value)
        draw(value, color="#444444", ls=style, lw=1, label=f"{name} {value:.2f}")


def tidy(ax: Axes, legend_above: bool = False) -> None:
    """A legend that lets the picture shine through, and no lines where nothing is measured."""
    above: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0, 1), "ncols": 4}
    ax.legend(fontsize="small", edgecolor="none", framealpha=0.8, **(above if legend_above else {}))
    ax.spines[["top", "right"]].set_visible(False)
