"""Pictures of results. Figures are made without pyplot: no display, no global state."""

import itertools
from collections.abc import Mapping

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrljax import stats

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#999999")
"""Colours that colour-blind people can tell apart (Okabe and Ito)."""


def learning_curves(
    curves: xr.Dataset | Mapping[str, xr.Dataset],
    variable: str = "return",
    *,
    window: int | None = None,
    references: Mapping[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Mean over seeds against episodes, with bands of 95 % intervals.

    Args:
        curves: a dataset of `hrljax.sweep`, or several by name. Every combination of swept
            hyper-parameters becomes a curve.
        variable: what to draw.
        window: episodes of a moving average; none if None.
        references: horizontal lines by name.
        ax: where to draw; a new figure if None.

    Returns:
        The axes; ``ax.figure.savefig`` saves the picture.

    Raises:
        ValueError: there are no curves.
    """
    named = {"": curves} if isinstance(curves, xr.Dataset) else dict(curves)
    if not named:
        raise ValueError("curves must hold at least one dataset, got none")
    if ax is None:
        ax = Figure(figsize=(8, 5), layout="constrained").subplots()
    colours = itertools.cycle(COLOURS)
    for name, dataset in named.items():
        values = dataset[variable] if window is None else stats.smoothed(dataset[variable], window)
        along = "checkpoint" if "checkpoint" in values.dims else "episode"
        swept = [dim for dim in values.dims if dim not in ("seed", along)]
        for setting in itertools.product(*(values[dim].values for dim in swept)):
            curve = values.sel(dict(zip(swept, setting, strict=True)))
            described = ", ".join(f"{dim}={value:g}" for dim, value in zip(swept, setting, strict=True))
            interval = stats.mean_interval(curve)
            colour = next(colours)
            finished = int(curve.notnull().all(along).sum())
            label = " ".join(part for part in (name, described) if part) or str(dataset.attrs.get("learner", variable))
            ax.plot(interval[along], interval["mean"], color=colour, label=f"{label} (n={finished})", lw=1.4)
            ax.fill_between(interval[along], interval["low"], interval["high"], color=colour, alpha=0.25, lw=0)
    for (name, value), style in zip((references or {}).items(), ("--", ":", "-.") * 10, strict=False):
        ax.axhline(value, color="#444444", ls=style, lw=1, label=f"{name} {value:.2f}")
    ax.set_xlabel("episode")
    first = next(iter(named.values()))[variable]
    units = first.attrs.get("units")
    ax.set_ylabel(first.attrs.get("long_name", variable) + (f" ({units})" if units else ""))
    ax.legend(fontsize="small", frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
    return ax
