"""Checks of arguments that the statistics share."""

from collections.abc import Mapping

import xarray as xr

from hrljax.core import checks
from hrljax.stats.resampling import Method, Statistic

TIMES = ("checkpoint", "episode", "steps")
"""Dimensions along which a run goes on."""


def check_values(name: str, values: object, *dims: str) -> None:
    """Raises unless the values are an array with some dimensions."""
    array = checks.instance(name, values, xr.DataArray, "a DataArray such as curves['return']")
    for dim in dims:
        if dim not in array.dims:
            present = ", ".join(map(str, array.dims)) or "none"
            raise ValueError(f"{name} must have a dimension {dim!r}, got {present}")


def check_named(name: str, values: object, what: str) -> None:
    """Raises unless the values are a mapping by name; a dataset is one, of variables."""
    if isinstance(values, xr.Dataset):
        raise TypeError(
            f"{name} must be one variable of a dataset, such as curves['return'].mean('episode'), got all of it"
        )
    checks.instance(name, values, Mapping, what)


def check_level(level: float) -> None:
    """Raises unless the coverage of an interval is a share."""
    if checks.is_number(level) and 1 < level < 100:
        raise ValueError(f"level must be a share in (0, 1), got {level}; perhaps {level / 100:g} is meant")
    checks.number("level", level, checks.PROPER_SHARE)


def check_bootstrap(
    level: float, resamples: int, key: int, statistic: Statistic = "mean", method: Method = "percentile"
) -> None:
    """Raises unless the arguments of a bootstrap make sense."""
    checks.choice("statistic", statistic, Statistic)
    checks.choice("method", method, Method)
    check_level(level)
    checks.integer("resamples", resamples, 1)
    checks.integer("key", key, 0, 2**64 - 1)
