"""Location of independent runs with intervals: Student's of the mean, and the bootstrap's of anything."""

import xarray as xr
from scipy import special

from hrljax.core import checks
from hrljax.stats import resampling
from hrljax.stats.arguments import check_bootstrap, check_level, check_values
from hrljax.stats.resampling import Method, Statistic


def estimate(values: xr.DataArray, statistic: Statistic, dim: str = "seed") -> xr.DataArray:
    """A statistic over a dimension; NaN entries (unfinished runs) do not count, infinite ones do.

    Raises:
        TypeError: the values are no DataArray.
        ValueError: an unknown statistic or dimension.
    """
    check_values("values", values, dim)
    checks.choice("statistic", statistic, Statistic)
    return xr.apply_ufunc(
        resampling.estimates, values, kwargs={"statistic": statistic}, input_core_dims=[[dim]], keep_attrs=True
    )


def mean(values: xr.DataArray, dim: str = "seed") -> xr.DataArray:
    """The mean over a dimension; NaN entries (unfinished runs) do not count."""
    return estimate(values, "mean", dim)


def interquartile_mean(values: xr.DataArray, dim: str = "seed") -> xr.DataArray:
    """The mean of the middle half over a dimension (Agarwal et al. 2021); NaN entries do not count.

    A quarter of the runs, rounded down, is left out at either end, as by `scipy.stats.trim_mean`.
    """
    return estimate(values, "interquartile_mean", dim)


def mean_interval(values: xr.DataArray, dim: str = "seed", level: float = 0.95) -> xr.Dataset:
    """The mean over a dimension and Student's interval of it.

    Args:
        values: any data; NaN entries (unfinished runs) do not count.
        dim: the dimension of independent repetitions.
        level: coverage of the interval, in (0, 1).

    Returns:
        ``mean``, ``low``, ``high`` without `dim`; with fewer than two values the interval is NaN.

    Raises:
        TypeError, ValueError: a bad argument.
    """
    check_values("values", values, dim)
    check_level(level)
    count = values.notnull().sum(dim)
    mean = values.mean(dim)
    freedom = (count - 1).clip(1)
    variance = ((values - mean) ** 2).sum(dim) / freedom
    error = ((variance / count.clip(1)) ** 0.5).where(count > 1)
    reach = xr.apply_ufunc(special.stdtrit, freedom, 0.5 + level / 2) * error
    return xr.Dataset({"mean": mean, "low": mean - reach, "high": mean + reach})


def bootstrap_interval(
    values: xr.DataArray,
    statistic: Statistic = "mean",
    dim: str = "seed",
    *,
    level: float = 0.95,
    resamples: int = 2000,
    method: Method = "percentile",
    key: int = 0,
) -> xr.Dataset:
    """A statistic over a dimension and its bootstrap interval.

    The same resamples of runs serve every entry, drawn as `scipy.stats.bootstrap` draws them.

    Args:
        values: any data; NaN entries (unfinished runs) do not count. Infinite ones, as of
            `episodes_to_reach`, need ``method="percentile"``.
        statistic: ``"mean"``, ``"interquartile_mean"`` or ``"median"``.
        dim: the dimension of independent repetitions.
        level: coverage of the interval, in (0, 1).
        resamples: number of resamples, at least 1.
        method: ``"percentile"``, or ``"bca"`` (Efron 1987), better for few runs of skewed values.
        key: seed of the resamples.

    Returns:
        A variable named by `statistic`, ``low`` and ``high``, without `dim`; with fewer than two
        values the interval is NaN.

    Raises:
        TypeError, ValueError: a bad argument.
    """
    check_values("values", values, dim)
    check_bootstrap(level, resamples, key, statistic, method)
    parts = xr.apply_ufunc(
        resampling.bootstrap,
        values,
        kwargs={"statistic": statistic, "level": level, "resamples": resamples, "method": method, "key": key},
        input_core_dims=[[dim]],
        output_core_dims=[[], [], []],
        keep_attrs=True,
    )
    return xr.Dataset(dict(zip((statistic, "low", "high"), parts, strict=True)))
