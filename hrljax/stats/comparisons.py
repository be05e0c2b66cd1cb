"""How two learners compare: who does better how often, and by how much on the same seed."""

import numpy as np
import xarray as xr

from hrljax.stats import resampling
from hrljax.stats.arguments import check_bootstrap, check_values


def paired_differences(first: xr.DataArray, second: xr.DataArray, dim: str = "seed") -> xr.DataArray:
    """``first - second`` on the same seeds: those that both have and both finished; others are NaN or missing.

    Seeds of a sweep with one key see the same random words, so that pairs take away what luck they
    share. `mean_interval` and `bootstrap_interval` of the differences are the paired intervals.

    Raises:
        TypeError: a side is no DataArray.
        ValueError: no seed is common, a side has no such dimension, or other coordinates differ.
    """
    check_values("first", first, dim)
    check_values("second", second, dim)
    first, second = xr.align(first, second, join="inner", exclude=set(first.dims) - {dim})
    first, second = xr.align(first, second, join="exact")
    if not first.sizes[dim]:
        raise ValueError(f"first and second have no {dim} in common")
    return (first - second).assign_attrs(first.attrs)


def probability_of_improvement(
    first: xr.DataArray,
    second: xr.DataArray,
    dim: str = "seed",
    *,
    level: float = 0.95,
    resamples: int = 2000,
    key: int = 0,
) -> xr.Dataset:
    """How likely a run of `first` is better (greater) than an independent one of `second`.

    Ties count half (the Mann-Whitney statistic over the number of pairs; Agarwal et al. 2021). The
    interval is the percentile bootstrap's, with both sides resampled independently.

    Args:
        first: any data; NaN entries (unfinished runs) do not count, infinite ones do.
        second: as `first`; `dim` may have another length, other dimensions are broadcast.
        dim: the dimension of independent repetitions.
        level: coverage of the interval, in (0, 1).
        resamples: number of resamples, at least 1.
        key: seed of the resamples.

    Returns:
        ``probability``, ``low``, ``high`` without `dim`; NaN where a side has no finished run, the
        interval where it has fewer than two.

    Raises:
        TypeError, ValueError: a bad argument, or coordinates that differ.
    """
    check_values("first", first, dim)
    check_values("second", second, dim)
    check_bootstrap(level, resamples, key)
    second = second.rename({dim: f"second {dim}"})
    parts = xr.apply_ufunc(
        _improvements,
        first,
        second,
        kwargs={"level": level, "resamples": resamples, "key": key},
        input_core_dims=[[dim], [f"second {dim}"]],
        output_core_dims=[[], [], []],
        join="exact",
    )
    return xr.Dataset(dict(zip(("probability", "low", "high"), parts, strict=True)))


def _improvements(
    first: np.ndarray, second: np.ndarray, level: float, resamples: int, key: int
) -> tuple[np.ndarray, ...]:
    shape = np.broadcast_shapes(first.shape[:-1], second.shape[:-1])
    firsts = np.broadcast_to(first, (*shape, first.shape[-1])).reshape(-1, first.shape[-1])
    seconds = np.broadcast_to(second, (*shape, second.shape[-1])).reshape(-1, second.shape[-1])
    pairs = [_improvement(a, b, level, resamples, key) for a, b in zip(firsts, seconds, strict=True)]
    return tuple(np.array(part, np.float64).reshape(shape) for part in zip(*pairs, strict=True))


def _improvement(
    first: np.ndarray, second: np.ndarray, level: float, resamples: int, key: int
) -> tuple[float, float, float]:
    first, second = first[~np.isnan(first)], np.sort(second[~np.isnan(second)])
    if not (len(first) and len(second)):
        return np.nan, np.nan, np.nan
    pairs = len(first) * len(second)
    worse = np.searchsorted(second, first, "left")
    not_better = np.searchsorted(second, first, "right")
    probability = (worse + not_better).sum() / (2 * pairs)
    if min(len(first), len(second)) < 2:
        return probability, np.nan, np.nan
    of_first, of_second = np.random.default_rng(key).spawn(2)
    drawn = np.empty(resamples)
    block = max(len(first), len(second))
    left = resampling.resampled(of_first, len(first), resamples, block)
    right = resampling.resampled(of_second, len(second), resamples, block)
    for (rows, index), (_, others) in zip(left, right, strict=True):
        below = np.concatenate([np.zeros((len(others), 1)), resampling.counted(others).cumsum(-1)], axis=-1)
        drawn[rows] = (resampling.counted(index) * (below[:, worse] + below[:, not_better])).sum(-1) / (2 * pairs)
    low, high = resampling.quantiles(drawn, np.array([(1 - level) / 2, (1 + level) / 2]))
    return probability, low, high
