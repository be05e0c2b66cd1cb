"""The best of many settings, with an interval that knows that it was chosen."""

import numpy as np
import xarray as xr
from scipy import special

from hrljax.core import checks
from hrljax.stats import resampling
from hrljax.stats.arguments import TIMES, check_bootstrap, check_values


def best(
    values: xr.DataArray,
    dim: str = "seed",
    *,
    least: bool = False,
    level: float = 0.95,
    resamples: int = 2000,
    key: int = 0,
) -> xr.Dataset:
    """The setting with the greatest mean over runs, and an interval of that mean that holds although it was chosen.

    The interval of a winner by itself lies too high: of many settings that are equally good, the luckiest wins.
    Here intervals are so wide that with probability `level` those of all settings hold at once, and
    so does that of the winner: each reaches c standard errors to either side, where c is the `level`-quantile of

        max_k |mean*_k - mean_k| / error_k

    over resamples of runs (the single-step max-t method, Westfall and Young 1993; Romano and Wolf 2005), corrected
    for few runs so that for a single setting it is Student's interval. Settings share their seeds, and resamples draw
    whole seeds, so that what is alike in all settings makes the interval no wider.

    Args:
        values: one number a run, such as ``hrl.stats.area_under_curve(curves["return"])``; every dimension but
            `dim` is one of settings. Runs count that are finished (not NaN) in every setting.
        dim: the dimension of independent repetitions.
        least: whether the least mean is the best, as of steps or damage.
        level: coverage of the interval, in (0, 1).
        resamples: number of resamples, at least 1.
        key: seed of the resamples.

    Returns:
        ``mean``, ``low`` and ``high``, without dimensions; coordinates say which setting it is. With fewer than two
        runs the interval is NaN.

    Raises:
        TypeError, ValueError: a bad argument, no run that is finished in every setting, or values that are not finite.
    """
    check_values("values", values, dim)
    for time in TIMES:
        if time in values.dims:
            raise ValueError(
                f"values must be one number a run, got a dimension {time!r}: reduce it, such as by mean({time!r})"
            )
    check_bootstrap(level, resamples, key)
    checks.flag("least", least)
    settings = [name for name in values.dims if name != dim]
    runs = values.transpose(*settings, dim)
    samples = runs.values.reshape(-1, values.sizes[dim]).astype(np.float64)
    samples = samples[:, ~np.isnan(samples).any(0)]
    if not samples.size:
        raise ValueError(f"values must have a {dim} that is finished in every setting, got none")
    if not np.isfinite(samples).all():
        raise ValueError("values must be finite, for their means are compared")
    means = samples.mean(1)
    winner = int(means.argmin() if least else means.argmax())
    reach = _critical_value(samples, level, resamples, key) * _standard_errors(samples)[winner]
    place = np.unravel_index(winner, [values.sizes[name] for name in settings])
    chosen = runs.isel(dict(zip(settings, map(int, place), strict=True)))
    scalars = {name: of_setting for name, of_setting in chosen.coords.items() if dim not in of_setting.dims}
    ends = {"mean": means[winner], "low": means[winner] - reach, "high": means[winner] + reach}
    return xr.Dataset(ends, scalars, dict(values.attrs))


def _standard_errors(samples: np.ndarray) -> np.ndarray:
    """Of the means of samples ``[settings, runs]``; NaN of fewer than two runs."""
    size = samples.shape[1]
    return samples.std(1, ddof=1) / np.sqrt(size) if size > 1 else np.full(len(samples), np.nan)


def _critical_value(samples: np.ndarray, level: float, resamples: int, key: int) -> float:
    """How many standard errors the intervals of all settings must reach, so that all hold at once."""
    size, errors = samples.shape[1], _standard_errors(samples)
    if size < 2:
        return np.nan
    # What is the same in every run has no error, and needs none.
    varies = errors > 0
    deviations = (samples[varies] - samples[varies].mean(1, keepdims=True)) / errors[varies, None]
    greatest = np.zeros(resamples)
    for rows, index in resampling.resampled(np.random.default_rng(key), size, resamples):
        of_means = np.abs(deviations @ resampling.counted(index).T / size)
        greatest[rows] = of_means.max(0, initial=0)
    # A resample varies less than runs do, by (n - 1) / n; few runs tell their spread badly: Student for Gauss.
    of_gauss = np.quantile(greatest, level) * np.sqrt(size / (size - 1))
    return float(-special.stdtrit(size - 1, special.ndtr(-of_gauss)))
