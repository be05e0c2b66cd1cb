"""Learning curves."""

import itertools
from collections.abc import Mapping

import xarray as xr
from matplotlib.axes import Axes

from hrljax import stats
from hrljax.plots import style
from hrljax.stats import Statistic


def learning_curves(
    curves: xr.Dataset | Mapping[str, xr.Dataset],
    variable: str = "return",
    *,
    window: int | None = None,
    statistic: Statistic = "mean",
    references: Mapping[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """A statistic over seeds against episodes, with bands of 95 % intervals.

    Args:
        curves: a dataset of `hrljax.sweep`, or several by name. Every combination of swept
            hyper-parameters becomes a curve.
        variable: what to draw.
        window: episodes of a moving average; none if None.
        statistic: ``"mean"``, with Student's interval, or one of `stats.bootstrap_interval`.
        references: horizontal lines by name.
        ax: where to draw; a new figure if None.

    Returns:
        The axes; ``ax.figure.savefig`` saves the picture.

    Raises:
        ValueError: there is no curve, or none of that variable.
    """
    named = {"": curves} if isinstance(curves, xr.Dataset) else dict(curves)
    if not named:
        raise ValueError("curves must hold at least one dataset, got none")
    for name, dataset in named.items():
        if variable not in dataset:
            known = ", ".join(map(str, dataset.data_vars))
            raise ValueError(f"variable must be one of {known}{f' in {name!r}' if name else ''}, got {variable!r}")
    ax = style.axes(ax)
    lines = style.lines()
    for name, dataset in named.items():
        values = dataset[variable] if window is None else stats.smoothed(dataset[variable], window)
        along = "checkpoint" if "checkpoint" in values.dims else "episode"
        swept = tuple(dim for dim in values.dims if dim not in ("seed", along))
        for setting in itertools.product(*(values[dim].values for dim in swept)):
            curve = values.sel(dict(zip(swept, setting, strict=True)))
            middle, low, high = style.interval(curve, statistic)
            line = next(lines)
            described = " ".join(part for part in (name, style.setting(swept, setting)) if part)
            described = described or str(dataset.attrs.get("learner", variable))
            ax.plot(middle[along], middle, **line, label=f"{described} ({style.finished(curve, along)})", lw=1.4)
            ax.fill_between(middle[along], low, high, color=line["color"], alpha=0.25, lw=0)
    style.references(ax, references)
    ax.set_xlabel("episode")
    shown = style.label(next(iter(named.values()))[variable])
    ax.set_ylabel(shown if statistic == "mean" else f"{shown}, {style.readable(statistic)}")
    style.tidy(ax)
    return ax
