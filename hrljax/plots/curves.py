"""Learning curves."""

from collections.abc import Mapping

import xarray as xr
from matplotlib.axes import Axes

from hrljax import stats
from hrljax.core import checks
from hrljax.plots import style
from hrljax.stats import Statistic
from hrljax.stats.arguments import TIMES
from hrljax.stats.settings import settings

Curves = xr.Dataset | xr.DataArray


def learning_curves(
    curves: Curves | Mapping[str, Curves],
    variable: str = "return",
    *,
    window: int | None = None,
    statistic: Statistic = "mean",
    references: Mapping[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """A statistic over seeds against episodes or steps, with bands of 95 % intervals.

    Args:
        curves: a dataset of `hrljax.sweep` or one of its variables, such as ``dataset["return"]``, or what
            `stats.against_steps` makes of it; or several by name. Every combination of swept
            hyper-parameters becomes a curve.
        variable: what to draw of a dataset.
        window: episodes of a moving average; none if None. A curve begins where its
            first window is whole, or in the middle of the run if that comes first.
        statistic: ``"mean"``, with Student's interval, or one of `stats.bootstrap_interval`.
        references: horizontal lines by name.
        ax: where to draw; a new figure if None.

    Returns:
        The axes; ``ax.figure.savefig`` saves the picture.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: there is no curve, or none of that variable.
    """
    named = {"": curves} if isinstance(curves, xr.Dataset | xr.DataArray) else curves
    checks.instance("curves", named, Mapping, "a dataset of hrljax.sweep, a DataArray, or several by name")
    if not named:
        raise ValueError("curves must hold at least one dataset, got none")
    drawn = {name: _values(name, of_name, variable) for name, of_name in named.items()}
    ax = style.axes(ax)
    lines = style.lines()
    for name, values in drawn.items():
        along = _along(values)
        if window is not None:
            begun = values[along] >= min(window, int(values[along][-1]) / 2)
            values = stats.smoothed(values, window).where(begun, drop=True)
        for curve, setting in settings(values, "seed", along):
            middle, low, high = style.interval(curve, statistic)
            line = next(lines)
            described = " ".join(part for part in (name, setting) if part)
            described = described or str(named[name].attrs.get("learner", values.name))
            ax.plot(middle[along], middle, **line, label=f"{described} ({style.finished(curve, along)})", lw=1.4)
            ax.fill_between(middle[along], low, high, color=line["color"], alpha=0.25, lw=0)
    style.references(ax, references)
    is_by_steps = all(_along(values) == "steps" for values in drawn.values())
    ax.set_xlabel("primitive steps" if is_by_steps else "episode")
    shown = style.label(next(iter(drawn.values())))
    ax.set_ylabel(shown if statistic == "mean" else f"{shown}, {style.readable(statistic)}")
    style.tidy(ax)
    return ax


def _values(name: str, curves: Curves, variable: str) -> xr.DataArray:
    """The values to draw of a dataset, or the array itself."""
    where = f" of {name!r}" if name else ""
    checks.instance(f"curves{where}", curves, (xr.Dataset, xr.DataArray), "a dataset of hrljax.sweep or a DataArray")
    if isinstance(curves, xr.Dataset):
        known = [str(key) for key, array in curves.data_vars.items() if _along(array)]
        if variable not in known:
            raise ValueError(
                f"variable{where} must be one of {', '.join(known) or 'none'}, those over episodes, "
                f"got {checks.described(variable)}"
            )
        return curves[variable]
    along = _along(curves)
    if along is None or "seed" not in curves.dims:
        present = ", ".join(map(str, curves.dims)) or "none"
        raise ValueError(
            f"curves{where} must have the dimensions 'seed' and 'episode', 'checkpoint' or 'steps', got {present}"
        )
    return curves


def _along(values: xr.DataArray) -> str | None:
    """The dimension of time, None if there is none."""
    return next((dim for dim in TIMES if dim in values.dims), None)
