"""Means, interquartile means and intervals against SciPy and by hand."""

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats as scipy_stats

from hrljax.stats import bootstrap_interval, interquartile_mean, mean, mean_interval, resampling
from tests.curves import curve


@pytest.mark.parametrize("level", [0.5, 0.95])
@pytest.mark.parametrize("seeds", [2, 6])
def test_the_interval_is_that_of_student(seeds: int, level: float):
    values = curve(seeds)["return"]
    found = mean_interval(values, level=level)
    low, high = scipy_stats.t.interval(level, seeds - 1, values.mean("seed"), scipy_stats.sem(values, axis=0))
    np.testing.assert_allclose(found["mean"], values.mean("seed"))
    np.testing.assert_allclose(found["low"], low)
    np.testing.assert_allclose(found["high"], high)
    assert found["low"].dims == ("episode",)


def test_the_interval_leaves_out_unfinished_runs():
    values = curve(6)["return"]
    unfinished = values.where(values["seed"] < 4)
    xr.testing.assert_allclose(mean_interval(unfinished), mean_interval(values.isel(seed=slice(4))))


@pytest.mark.parametrize("finished", [0, 1])
def test_there_is_no_interval_of_less_than_two_values(finished: int):
    values = curve(3)["return"]
    found = mean_interval(values.where(values["seed"] < finished))
    assert found["low"].isnull().all()
    assert found["high"].isnull().all()
    assert found["mean"].notnull().all() == (finished == 1)


def test_the_interval_may_be_over_another_dimension():
    values = curve(3, pseudo_reward=[0.0, 5.0, 60.0])["return"]
    found = mean_interval(values, "pseudo_reward")
    assert found["mean"].dims == ("seed", "episode")
    expected = scipy_stats.t.interval(0.95, 2, values.mean("pseudo_reward"), scipy_stats.sem(values, axis=0))
    np.testing.assert_allclose([found["low"], found["high"]], expected)


def skewed(*shape: int, key: int = 3) -> np.ndarray:
    return np.random.default_rng(key).gamma(1.5, 10, shape)


def runs(values: np.ndarray) -> xr.DataArray:
    return xr.DataArray(values, dims=[*("xyz"[: values.ndim - 1]), "seed"], attrs={"units": "steps"})


SCIPY = {
    "mean": np.mean,
    "interquartile_mean": lambda values, axis: scipy_stats.trim_mean(values, 0.25, axis=axis),
    "median": np.median,
}


@pytest.mark.parametrize("seeds", [1, 2, 3, 4, 5, 7, 8, 23])
def test_means_are_those_of_scipy(seeds: int):
    values = skewed(3, seeds)
    np.testing.assert_allclose(interquartile_mean(runs(values)), scipy_stats.trim_mean(values, 0.25, axis=-1))
    np.testing.assert_allclose(mean(runs(values)), values.mean(-1))
    assert interquartile_mean(runs(values)).attrs == {"units": "steps"}


def test_interquartile_means_by_hand():
    assert float(interquartile_mean(runs(np.array([100.0, 4.0, 2.0, -100.0])))) == 3
    assert float(interquartile_mean(runs(np.array([np.nan, 100.0, 4.0, np.nan, 2.0, -100.0])))) == 3
    assert float(interquartile_mean(runs(np.array([1.0, np.inf, 2.0, 3.0])))) == 2.5
    assert float(interquartile_mean(runs(np.array([1.0, np.inf, np.inf, 3.0])))) == np.inf
    assert float(mean(runs(np.array([np.nan, 2.0, 5.0])))) == 3.5
    assert np.isnan(interquartile_mean(runs(np.full(4, np.nan))))
    assert np.isnan(mean(runs(np.full(4, np.nan))))


@pytest.mark.parametrize("method", ["percentile", "bca"])
@pytest.mark.parametrize("statistic", SCIPY)
@pytest.mark.parametrize("seeds", [2, 3, 10, 41])
def test_bootstrap_intervals_are_those_of_scipy(seeds: int, statistic: str, method: str):
    values = (1024 * skewed(2, seeds)).round()  # sums are exact: what ties, ties in every order of summation
    found = bootstrap_interval(runs(values), statistic, level=0.9, resamples=500, method=method, key=7)
    for row, sample in enumerate(values):
        expected = scipy_stats.bootstrap(
            (sample,),
            SCIPY[statistic],
            n_resamples=500,
            confidence_level=0.9,
            method={"bca": "BCa"}.get(method, method),
            rng=np.random.default_rng(7),
        ).confidence_interval
        np.testing.assert_allclose(found[statistic][row], SCIPY[statistic](sample, axis=0))
        np.testing.assert_allclose([found["low"][row], found["high"][row]], expected, rtol=1e-9)
    assert set(found.data_vars) == {statistic, "low", "high"}
    assert found["low"].dims == ("x",)


def test_blocks_do_not_change_a_bootstrap(monkeypatch: pytest.MonkeyPatch):
    values = runs(skewed(5, 9))
    options = {"resamples": 50, "key": 1}
    whole = [bootstrap_interval(values, statistic, **options) for statistic in SCIPY]
    monkeypatch.setattr(resampling, "_BLOCK", 100)
    for statistic, expected in zip(SCIPY, whole, strict=True):
        xr.testing.assert_allclose(bootstrap_interval(values, statistic, **options), expected, rtol=1e-12)


@pytest.mark.parametrize("statistic", SCIPY)
def test_a_bootstrap_leaves_out_unfinished_runs(statistic: str):
    values = skewed(4, 9)
    values[1, [0, 5]] = np.nan
    values[2] = np.nan
    values[3, 1:] = np.nan
    found = bootstrap_interval(runs(values), statistic, resamples=200)
    for row, sample in enumerate(values[:2]):
        alone = bootstrap_interval(runs(sample[~np.isnan(sample)]), statistic, resamples=200)
        xr.testing.assert_allclose(found.isel(x=row), alone)
    assert found[statistic].isnull().values.tolist() == [False, False, True, False]
    assert found["low"].isnull().values.tolist() == found["high"].isnull().values.tolist() == [False, False, True, True]


def test_a_bootstrap_of_equal_values_is_that_value():
    for method in ("percentile", "bca"):
        found = bootstrap_interval(runs(np.full(5, 3.0)), "interquartile_mean", method=method, resamples=20)
        assert [float(found[name]) for name in ("interquartile_mean", "low", "high")] == [3, 3, 3]


def test_runs_that_never_reach_a_threshold_are_infinite():
    values = runs(np.array([[10.0, 20.0, 30.0, 40.0, 50.0, np.inf], [10.0, np.inf, np.inf, np.inf, 20.0, np.inf]]))
    found = bootstrap_interval(values, "median", resamples=1001, level=0.9)
    np.testing.assert_array_equal(found["median"], [35, np.inf])
    np.testing.assert_array_equal(found["high"], [np.inf, np.inf])
    drawn = values.values[0][np.random.default_rng(0).integers(0, 6, (1001, 6))]
    assert float(found["low"][0]) == np.sort(np.sort(drawn)[:, 2:4].mean(-1))[50]
    assert float(bootstrap_interval(values[0], "mean", resamples=10)["mean"]) == np.inf
    with pytest.raises(ValueError, match="method must be 'percentile' where values are infinite"):
        bootstrap_interval(values, "median", method="bca")


@settings(derandomize=True, deadline=None, max_examples=50)
@given(
    st.lists(st.floats(-100, 100), min_size=2, max_size=12),
    st.sampled_from(list(SCIPY)),
    st.sampled_from(["percentile", "bca"]),
    st.floats(0.5, 4),
    st.floats(-50, 50),
)
def test_intervals_follow_units_and_lie_within_the_values(
    values: list[float], statistic: str, method: str, scale: float, offset: float
):
    sample = np.array(values).round(3)
    found = bootstrap_interval(runs(sample), statistic, resamples=100, method=method)
    low, estimate, high = (float(found[name]) for name in ("low", statistic, "high"))
    slack = 1e-9
    assert sample.min() - slack <= low <= high <= sample.max() + slack
    assert sample.min() - slack <= estimate <= sample.max() + slack
    moved = bootstrap_interval(runs(sample * scale + offset), statistic, resamples=100)
    plain = bootstrap_interval(runs(sample), statistic, resamples=100)
    xr.testing.assert_allclose(moved, plain * scale + offset, atol=1e-9)


@settings(derandomize=True, deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_the_key_decides_the_interval(key: int):
    values = runs(skewed(12))
    first = bootstrap_interval(values, resamples=50, key=key)
    xr.testing.assert_identical(first, bootstrap_interval(values, resamples=50, key=key))
    assert float(first["low"]) != float(bootstrap_interval(values, resamples=50, key=key + 1)["low"])


@pytest.mark.parametrize("statistic", SCIPY)
def test_a_bootstrap_covers_the_truth_about_as_often_as_it_says(statistic: str):
    values = np.random.default_rng(5).normal(2, 1, (400, 30))
    found = bootstrap_interval(runs(values), statistic, level=0.9, resamples=400)
    covered = float(((found["low"] <= 2) & (found["high"] >= 2)).mean())
    assert 0.82 < covered < 0.95


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"statistic": "mode"}, "statistic must be one of 'mean', 'interquartile_mean', 'median', got 'mode'"),
        ({"method": "t"}, "method must be one of 'percentile', 'bca', got 't'"),
        ({"level": 95}, r"level must be a share in \(0, 1\), got 95; perhaps 0.95 is meant"),
        ({"resamples": 0}, "resamples must be an integer from 1 to 2147483647, got 0"),
        ({"key": -1}, "key must be an integer from 0 to 18446744073709551615, got -1"),
        ({"dim": "seeds"}, "values must have a dimension 'seeds', got seed"),
    ],
    ids=str,
)
def test_a_bad_argument_of_a_bootstrap_is_refused(options: dict[str, object], message: str):
    with pytest.raises(ValueError, match=message):
        bootstrap_interval(runs(skewed(5)), **options)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: bootstrap_interval(runs(skewed(5)), resamples=10.0),
            "resamples must be an integer from 1 to .*got 10.0",
        ),
        (lambda: mean(np.zeros(3)), r"values must be a DataArray such as curves\['return'\], got array"),
        (lambda: mean_interval(runs(skewed(5)), level="0.95"), "level must be a number, got '0.95'"),
    ],
)
def test_an_argument_of_the_wrong_type_is_refused(call: Callable[[], object], message: str):
    with pytest.raises(TypeError, match=message):
        call()


@pytest.mark.parametrize(
    ("level", "message"),
    [(95, r"in \(0, 1\), got 95; perhaps 0.95 is meant"), (1, r"in \(0, 1\), got 1"), (-0.5, r"in \(0, 1\), got -0.5")],
)
def test_a_level_is_a_share(level: float, message: str):
    with pytest.raises(ValueError, match=message):
        mean_interval(runs(skewed(5)), level=level)
