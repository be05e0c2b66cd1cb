"""What all experiments write: intervals for JSON, curves as comma-separated values."""

from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from hrljax import stats

Row: TypeAlias = dict[str, Any]
"""A row of a table and of summary.json: numbers and text by name, and intervals as `interval_row` gives them."""


def interval_row(interval: xr.Dataset) -> dict[str, float | None]:
    """A mean and its ends for JSON, which knows no NaN: one seed has no interval."""
    values = {name: float(interval[key]) for name, key in (("mean", "mean"), ("lo", "low"), ("hi", "high"))}
    return {name: value if np.isfinite(value) else None for name, value in values.items()}


def curves_csv(results: Iterable[tuple[str, str, xr.Dataset]]) -> str:
    """Mean and 95 % interval of every curve, bin and variable; a result is its panel, its name and its data."""
    lines = ["panel,curve,variable,episode,mean,low,high"]
    for panel, name, dataset in results:
        for variable in dataset.data_vars:
            if "episode" not in dataset[variable].dims:
                continue
            interval = stats.mean_interval(dataset[variable])
            columns = (interval[column].values for column in ("episode", "mean", "low", "high"))
            for episode, mean, low, high in zip(*columns, strict=True):
                lines.append(f'{panel},"{name}",{variable},{episode},{mean:.6g},{low:.6g},{high:.6g}')
    return "\n".join(lines) + "\n"
