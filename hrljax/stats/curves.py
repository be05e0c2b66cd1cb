"""From the curve of a run to fewer numbers: moving averages, ranges, areas, and how soon a value is reached."""

import numpy as np
import xarray as xr

from hrljax.core import checks
from hrljax.stats.arguments import check_values


def smoothed(values: xr.DataArray, window: int) -> xr.DataArray:
    """The moving average over a window of episodes, as far as whole bins allow.

    Bins weigh as much as they have episodes: the last may have fewer. The first averages are over
    what there is of the window.

    Raises:
        TypeError: `values` is no DataArray, or `window` no integer.
        ValueError: the window is smaller than a bin, or there is no dimension ``episode``.
    """
    check_values("values", values, "episode")
    weights = xr.DataArray(_episodes_in_bins(values), coords={"episode": values["episode"]})
    whole = _bins_in(window, values, "episode")

    def summed(terms: xr.DataArray) -> xr.DataArray:
        return terms.rolling(episode=whole, min_periods=1).sum()

    average = summed(values * weights) / summed(weights.where(values.notnull()))
    return average.transpose(*values.dims).rename(values.name).assign_attrs(values.attrs)


def episode_range(values: xr.DataArray, first: int, last: int) -> xr.DataArray:
    """The mean over the episodes after `first` up to `last`, both ends of bins.

    Raises:
        TypeError: `values` is no DataArray, or an end no integer.
        ValueError: an end is not the end of a bin, or no bin is between them.
    """
    check_values("values", values, "episode")
    ends = np.concatenate([[0], values["episode"].values])
    for name, end in (("first", first), ("last", last)):
        if checks.integer(name, end) not in ends:
            raise ValueError(f"episode {end} is not the end of a bin")
    if first >= last:
        raise ValueError(f"first must be less than last, got {first} and {last}")
    inside = values.sel(episode=(values["episode"] > first) & (values["episode"] <= last))
    weights = xr.DataArray(np.diff(ends), coords={"episode": values["episode"]}).sel(episode=inside["episode"])
    return inside.weighted(weights).mean("episode", skipna=False).assign_attrs(values.attrs)


def area_under_curve(
    values: xr.DataArray, first: int = 0, last: int | None = None, reference: float = 0.0
) -> xr.DataArray:
    """The sum over episodes of a value per episode, less a reference: the area between the two.

    With the optimum as the reference of a return, it is the negative regret.

    Args:
        values: means per episode of bins, along ``episode``.
        first: the sum begins after this episode, the end of a bin (or 0).
        last: and ends with this one, the end of a bin; the last of the run if None.
        reference: what is subtracted in every episode.

    Raises:
        TypeError, ValueError: a bad argument, as of `episode_range`.
    """
    check_values("values", values, "episode")
    reference = checks.number("reference", reference)
    last = int(values["episode"].values[-1]) if last is None else last
    area = (episode_range(values, first, last) - reference) * (last - first)
    unit = values.attrs.get("units")
    name = f"area under {values.attrs.get('long_name', values.name)}"
    return area.assign_attrs({"long_name": name, "units": f"{unit} x episodes" if unit else "episodes"})


def episodes_to_reach(
    values: xr.DataArray,
    target: float,
    *,
    share: float = 1.0,
    baseline: float = 0.0,
    window: int | None = None,
    along: str = "episode",
) -> xr.DataArray:
    """Episodes until a moving average is for the first time at least a threshold.

    The threshold is `share` of the way from `baseline` to `target`. Returns are often negative, and
    then a share of the optimum means nothing without a baseline, such as the return of random actions.

    Args:
        values: a value where more is better.
        target: what to reach, for example the optimum.
        share: in (0, 1].
        baseline: where the way begins; below `target`, and used only if `share` is less than 1.
        window: episodes of the moving average, as far as whole bins allow; a bin if None. Averages
            over less than the window do not count. Only along ``episode``.
        along: the dimension of time, ``"episode"`` or ``"checkpoint"``.

    Returns:
        The last episode of the first window that reaches the threshold, in episodes, without the
        dimension `along`; infinity for a run that never does, NaN for one that was not finished.

    Raises:
        TypeError, ValueError: a bad argument.
    """
    checks.choice("along", along, ("episode", "checkpoint"))
    check_values("values", values, along)
    checks.number("share", share, checks.Interval(0, 1, low_open=True))
    checks.number("target", target)
    checks.number("baseline", baseline)
    if share < 1 and not baseline < target:
        raise ValueError(f"baseline must be less than the target {target:g}, got {baseline!r}")
    threshold = target if share == 1 else baseline + share * (target - baseline)
    average = values
    if window is not None:
        if along != "episode":
            raise ValueError(f"window must be None along {along!r}, got {window!r}")
        average = (
            smoothed(values, window)
            .where(values.notnull())
            .isel(episode=slice(_bins_in(window, values, along) - 1, None))
        )
    reached = average >= threshold
    time = average[along].astype(np.float64)
    first = time.where(reached, np.inf).min(along)
    return first.where(values.notnull().any(along)).assign_attrs(
        {"long_name": f"episodes to reach {threshold:.4g}", "units": "episodes"}
    )


def against_steps(curves: xr.Dataset, variable: str = "return", num: int = 200) -> xr.DataArray:
    """A curve of each run against its primitive steps instead of its episodes.

    Runs whose episodes are short have more of them in as many steps; where steps are what costs, this is the fair
    comparison. At a number of steps stands the mean per episode of the bin in which the run then was.

    Args:
        curves: a dataset of `hrljax.sweep`, with ``length`` over ``episode``.
        variable: which of its variables over ``episode``.
        num: places on the axis, at least 1.

    Returns:
        The values along ``steps`` in place of ``episode``: `num` equal parts of the steps that every finished run took.
        Runs that were not finished are NaN.

    Raises:
        TypeError, ValueError: a bad argument, or no run is finished.
    """
    checks.instance("curves", curves, xr.Dataset, "a dataset of hrljax.sweep")
    known = [str(name) for name, values in curves.data_vars.items() if "episode" in values.dims]
    checks.choice("variable", variable, tuple(known))
    if "length" not in known:
        raise ValueError(f"curves must have the variable 'length' over episodes, it has {', '.join(known) or 'none'}")
    checks.integer("num", num, 1)
    values, length = curves[variable], curves["length"]
    bins = xr.DataArray(np.diff(values["episode"].values, prepend=0), coords={"episode": values["episode"]})
    finished = length.isel(episode=0).notnull()
    ends = (length.fillna(0) * bins).cumsum("episode").where(finished)  # no length: steps had stopped the run before
    total = float(ends.isel(episode=-1).min())
    if not np.isfinite(total):
        raise ValueError("curves must have a finished run, got none")
    places = total * np.arange(1, num + 1) / num

    def looked_up(of_run: np.ndarray, ends_of_run: np.ndarray) -> np.ndarray:
        if np.isnan(ends_of_run).any():
            return np.full(num, np.nan)
        inside = np.searchsorted(ends_of_run, places)
        return of_run[np.minimum(inside, len(of_run) - 1)]

    along = xr.apply_ufunc(
        looked_up,
        values,
        ends,
        input_core_dims=[["episode"], ["episode"]],
        output_core_dims=[["steps"]],
        vectorize=True,
        keep_attrs=True,
    )
    of_steps = xr.Variable("steps", places, {"long_name": "primitive steps", "units": "steps"})
    return along.assign_coords(steps=of_steps).rename(variable).assign_attrs(values.attrs)


def _episodes_in_bins(values: xr.DataArray) -> np.ndarray:
    """Episodes of each bin, relative to the first."""
    ends = values["episode"].values
    return np.diff(ends, prepend=0) / ends[0]


def _bins_in(window: int, values: xr.DataArray, along: str) -> int:
    """Whole bins in a window of episodes, at most those of the run."""
    bin_size = int(values[along].values[0])
    if checks.integer("window", window, 1) < bin_size:
        raise ValueError(f"window must be at least a bin of {bin_size} episodes, got {window}")
    return min(window // bin_size, values.sizes[along])
