"""The bootstrap on plain arrays (Efron and Tibshirani 1993) of means that leave out the same share at either end."""

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy import special

Statistic = Literal["mean", "interquartile_mean", "median"]
Method = Literal["percentile", "bca"]

_BLOCK = 1 << 20
"""Numbers that are held at a time, about."""


class Interval(NamedTuple):
    """Statistics of independent samples with the ends of their intervals, each ``[...]``."""

    estimate: np.ndarray
    low: np.ndarray
    high: np.ndarray


def trimmed(statistic: Statistic, size: Any) -> Any:
    """Smallest and greatest values of a sample that the statistic leaves out, of each.

    A quarter, rounded down, for the interquartile mean (as `scipy.stats.trim_mean`); all but the
    middle one or two for the median.
    """
    return {"mean": 0 * size, "interquartile_mean": size // 4, "median": np.maximum(size - 1, 0) // 2}[statistic]


def estimates(samples: np.ndarray, statistic: Statistic) -> np.ndarray:
    """The statistic along the last axis, where NaN do not count; NaN where nothing else is there."""
    ordered = np.sort(samples, axis=-1)  # NaN last
    count = np.asarray((~np.isnan(samples)).sum(-1))
    cut = trimmed(statistic, count)
    rank = np.arange(samples.shape[-1])
    inside = (rank >= cut[..., None]) & (rank < (count - cut)[..., None])
    with np.errstate(invalid="ignore"):
        return np.where(inside, ordered, 0).sum(-1) / np.where(count > 0, count - 2 * cut, np.nan)


def bootstrap(
    samples: np.ndarray, statistic: Statistic, level: float, resamples: int, method: Method, key: int
) -> Interval:
    """Bootstrap intervals along the last axis; NaN where fewer than two values are not NaN.

    All samples of the same runs are resampled alike, whatever other samples there are.
    """
    flat = samples.reshape(-1, samples.shape[-1]).astype(np.float64)
    result = Interval(estimates(flat, statistic), *np.full((2, len(flat)), np.nan))
    finished, group = np.unique(~np.isnan(flat), axis=0, return_inverse=True)
    at_once = max(1, _BLOCK // resamples)
    for number, present in enumerate(finished):
        if present.sum() < 2:
            continue
        (cells,) = np.nonzero(group.ravel() == number)
        for block in np.split(cells, range(at_once, len(cells), at_once)):
            sample = flat[block][:, present]
            replicates = _replicates(sample, statistic, resamples, key)
            shares = np.full((len(block), 2), [(1 - level) / 2, (1 + level) / 2])
            if method == "bca":
                shares = _corrected(shares, replicates, sample, result.estimate[block], statistic)
            result.low[block], result.high[block] = quantiles(replicates, shares).T
    return Interval(*(part.reshape(samples.shape[:-1]) for part in result))


def resampled(
    rng: np.random.Generator, size: int, resamples: int, widest: int | None = None
) -> Iterator[tuple[slice, np.ndarray]]:
    """Which of `size` values each resample holds: blocks of rows ``[rows, size]``, and where they lie.

    Generators with the same `widest` go in step.
    """
    rows = max(1, _BLOCK // (widest or size))
    for start in range(0, resamples, rows):
        stop = min(start + rows, resamples)
        yield slice(start, stop), rng.integers(0, size, (stop - start, size))


def counted(index: np.ndarray) -> np.ndarray:
    """How often each value is in each resample, ``[rows, size]`` float64."""
    rows, size = index.shape
    places = index + size * np.arange(rows)[:, None]
    return np.bincount(places.ravel(), minlength=index.size).reshape(index.shape).astype(np.float64)


def quantiles(values: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Quantiles along the last axis (linear between values, which may be infinite), ``[..., shares]``."""
    ordered = np.sort(values, axis=-1)
    place = shares * (values.shape[-1] - 1)
    below = np.floor(place).astype(np.int64)
    low = np.take_along_axis(ordered, below, -1)
    high = np.take_along_axis(ordered, np.minimum(below + 1, values.shape[-1] - 1), -1)
    with np.errstate(invalid="ignore"):
        between = low + (place - below) * (high - low)
    return np.where((low == high) | (place == below), low, between)


def _replicates(samples: np.ndarray, statistic: Statistic, resamples: int, key: int) -> np.ndarray:
    """The statistic of every resample of every sample, ``[samples, resamples]``."""
    size = samples.shape[-1]
    cut = trimmed(statistic, size)
    replicates = np.empty((len(samples), resamples))
    for rows, index in resampled(np.random.default_rng(key), size, resamples):
        if cut == 0 and np.isfinite(samples).all():
            replicates[:, rows] = samples @ counted(index).T / size
            continue
        for number, sample in enumerate(samples):
            drawn = sample[index]
            drawn.sort(axis=-1)
            with np.errstate(invalid="ignore"):
                replicates[number, rows] = drawn[:, cut : size - cut].mean(-1)
    return replicates


def _corrected(
    shares: np.ndarray, replicates: np.ndarray, samples: np.ndarray, estimate: np.ndarray, statistic: Statistic
) -> np.ndarray:
    """The shares of the BCa interval (Efron 1987): corrected for bias and for skewness."""
    if not np.isfinite(samples).all():
        raise ValueError("method must be 'percentile' where values are infinite, got 'bca'")
    rounding = 1e-12 * np.abs(samples).max(-1)
    above = replicates - estimate[:, None]
    ties = (above < -rounding[:, None]).mean(-1) + (above <= rounding[:, None]).mean(-1)
    edge = 0.5 / replicates.shape[-1]
    bias = special.ndtri(np.clip(ties / 2, edge, 1 - edge))[:, None]
    left_out = _jackknife(samples, statistic)
    spread = left_out.mean(-1, keepdims=True) - left_out
    scale = (spread**2).sum(-1) ** 1.5
    skewed = np.where(scale > 0, (spread**3).sum(-1) / np.where(scale > 0, 6 * scale, 1), 0)[:, None]
    reach = bias + special.ndtri(shares)
    return special.ndtr(bias + reach / (1 - skewed * reach))


def _jackknife(samples: np.ndarray, statistic: Statistic) -> np.ndarray:
    """The statistic of every sample without each of its values in turn, by rank of what is left out."""
    ordered = np.sort(samples, axis=-1)
    size = samples.shape[-1] - 1
    cut = trimmed(statistic, size)
    stop = size - cut
    below = np.concatenate([np.zeros((len(samples), 1)), ordered.cumsum(-1)], axis=-1)
    without_low, without_high = below[:, stop + 1] - below[:, cut + 1], below[:, stop] - below[:, cut]
    rank = np.arange(size + 1)
    inside = (below[:, stop + 1] - below[:, cut])[:, None] - ordered
    total = np.where(rank < cut, without_low[:, None], np.where(rank >= stop, without_high[:, None], inside))
    return total / (size - 2 * cut)
