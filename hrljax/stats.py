"""Statistics of results over seeds."""

import numpy as np
import xarray as xr
from scipy import special


def mean_interval(values: xr.DataArray, dim: str = "seed", level: float = 0.95) -> xr.Dataset:
    """The mean over a dimension and Student's interval of it.

    Args:
        values: any data; NaN entries (unfinished runs) do not count.
        dim: the dimension of independent repetitions.
        level: coverage of the interval, in (0, 1).

    Returns:
        ``mean``, ``low``, ``high`` without `dim`; with fewer than two values the interval is NaN.
    """
    count = values.notnull().sum(dim)
    error = values.std(dim, ddof=1).where(count > 1) / np.sqrt(count.clip(1))
    reach = xr.apply_ufunc(special.stdtrit, (count - 1).clip(1), 0.5 + level / 2) * error
    mean = values.mean(dim)
    return xr.Dataset({"mean": mean, "low": mean - reach, "high": mean + reach})


def smoothed(values: xr.DataArray, window: int) -> xr.DataArray:
    """The moving average over a window of episodes, as far as whole bins allow.

    The first bins average over what there is of the window; bins count by their episodes.

    Raises:
        ValueError: the window is smaller than a bin.
    """
    episodes = values["episode"].values
    bin_size = int(episodes[0])
    if window < bin_size:
        raise ValueError(f"window must be at least a bin of {bin_size} episodes, got {window}")
    sizes = xr.DataArray(np.diff(episodes, prepend=0), coords={"episode": values["episode"]})
    weights = sizes.where(values.notnull())  # the last bin may be smaller

    def total(terms: xr.DataArray) -> xr.DataArray:
        return terms.rolling(episode=window // bin_size, min_periods=1).sum()

    return (total(values * weights) / total(weights)).transpose(*values.dims)


def episode_range(values: xr.DataArray, first: int, last: int) -> xr.DataArray:
    """The mean over the episodes after `first` up to `last`, both ends of bins.

    Raises:
        ValueError: an end is not the end of a bin.
    """
    ends = np.concatenate([[0], values["episode"].values])
    for end in (first, last):
        if end not in ends:
            raise ValueError(f"episode {end} is not the end of a bin")
    inside = values.sel(episode=(values["episode"] > first) & (values["episode"] <= last))
    weights = xr.DataArray(np.diff(ends), coords={"episode": values["episode"]}).sel(episode=inside["episode"])
    return inside.weighted(weights).mean("episode", skipna=False)
