"""Probability of improvement and paired differences against SciPy and by hand."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats as scipy_stats

from hrljax.stats import bootstrap_interval, mean_interval, paired_differences, probability_of_improvement, resampling
from tests.curves import curve


def runs(*values: float, start: int = 0) -> xr.DataArray:
    return xr.DataArray(np.array(values, np.float64), coords={"seed": np.arange(start, start + len(values))})


def test_probability_of_improvement_by_hand():
    found = probability_of_improvement(runs(3, 1), runs(2, 1, 0))
    assert float(found["probability"]) == pytest.approx((3 + 1.5) / 6)  # 3 beats all three, 1 beats 0 and ties with 1
    assert set(found.data_vars) == {"probability", "low", "high"}
    never = probability_of_improvement(runs(np.inf, np.inf), runs(5, np.inf))
    assert float(never["probability"]) == 0.75


def test_probability_of_improvement_is_the_statistic_of_mann_and_whitney():
    rng = np.random.default_rng(2)
    first, second = rng.integers(0, 20, 31), rng.integers(3, 22, 17)
    u = scipy_stats.mannwhitneyu(first, second).statistic
    found = probability_of_improvement(runs(*first), runs(*second), resamples=10)
    assert float(found["probability"]) == pytest.approx(u / (31 * 17))


def test_its_interval_is_that_of_all_pairs_of_resamples():
    rng = np.random.default_rng(4)
    first, second = rng.integers(0, 9, 12).astype(float), rng.integers(1, 9, 7).astype(float)
    found = probability_of_improvement(runs(*first), runs(*second), resamples=300, level=0.8, key=5)
    of_first, of_second = np.random.default_rng(5).spawn(2)
    drawn = [
        (np.sign(a[:, None] - b).mean() + 1) / 2
        for a, b in zip(
            first[of_first.integers(0, 12, (300, 12))],
            np.sort(second)[of_second.integers(0, 7, (300, 7))],
            strict=True,
        )
    ]
    np.testing.assert_allclose([found["low"], found["high"]], np.quantile(drawn, [0.1, 0.9]))


def test_blocks_do_not_change_the_interval(monkeypatch: pytest.MonkeyPatch):
    data = curve(9)["return"]
    whole = probability_of_improvement(data, data.isel(seed=slice(5)) + 1, resamples=100)
    monkeypatch.setattr(resampling, "_BLOCK", 50)
    xr.testing.assert_identical(probability_of_improvement(data, data.isel(seed=slice(5)) + 1, resamples=100), whole)


def test_probability_of_improvement_keeps_labels_and_broadcasts():
    many = curve(8, pseudo_reward=[0.0, 5.0])["return"]
    one = curve(5)["return"]
    found = probability_of_improvement(many, one, resamples=50)
    assert found["probability"].dims == ("pseudo_reward", "episode")
    alone = probability_of_improvement(many.isel(pseudo_reward=1, episode=3), one.isel(episode=3), resamples=50)
    xr.testing.assert_equal(found.isel(pseudo_reward=1, episode=3), alone)
    with pytest.raises(ValueError, match="episode"):
        probability_of_improvement(many, one.isel(episode=slice(3)))


def test_unfinished_runs_do_not_count():
    found = probability_of_improvement(runs(3, np.nan, 1), runs(np.nan, 2, 1, 0), resamples=100)
    xr.testing.assert_equal(found, probability_of_improvement(runs(3, 1), runs(2, 1, 0), resamples=100))
    single = probability_of_improvement(runs(3, np.nan), runs(2, 1))
    assert float(single["probability"]) == 1
    assert np.isnan(single["low"])
    assert np.isnan(single["high"])
    assert np.isnan(probability_of_improvement(runs(np.nan), runs(2, 1))["probability"])


@settings(derandomize=True, deadline=None, max_examples=50)
@given(st.lists(st.integers(-5, 5), min_size=2, max_size=9), st.lists(st.integers(-5, 5), min_size=2, max_size=9))
def test_the_two_ways_around_add_up_to_one(first: list[int], second: list[int]):
    there = probability_of_improvement(runs(*first), runs(*second), resamples=60)
    back = probability_of_improvement(runs(*second), runs(*first), resamples=60)
    assert float(there["probability"]) == pytest.approx(1 - float(back["probability"]))
    assert 0 <= float(there["low"]) <= float(there["high"]) <= 1
    assert float(probability_of_improvement(runs(*first), runs(*first), resamples=1)["probability"]) == 0.5
    higher = probability_of_improvement(runs(*(v + 20 for v in first)), runs(*second), resamples=20)
    assert [float(higher[name]) for name in ("probability", "low", "high")] == [1, 1, 1]


def test_pairs_are_made_by_seed():
    first, second = runs(1, 2, 3, np.nan, start=0), runs(10, 20, np.nan, 40, start=1)
    found = paired_differences(first, second)
    assert found["seed"].values.tolist() == [1, 2, 3]
    np.testing.assert_array_equal(found, [2 - 10, 3 - 20, np.nan])
    with pytest.raises(ValueError, match="first and second have no seed in common"):
        paired_differences(first, runs(1, start=9))


def test_paired_intervals_are_those_of_scipy_for_related_samples():
    values = curve(9)["return"]
    other = values.copy(data=values + 1 + 0.1 * np.random.default_rng(0).normal(size=values.shape))
    differences = paired_differences(other, values)
    assert differences.attrs == values.attrs
    expected = scipy_stats.ttest_rel(other, values, axis=0).confidence_interval(0.95)
    found = mean_interval(differences)
    np.testing.assert_allclose([found["low"], found["high"]], [expected.low, expected.high])
    boot = bootstrap_interval(differences)
    assert (boot["low"] > 0.8).all()
    assert (boot["high"] < 1.2).all()


def test_pairs_need_the_same_bins():
    values = curve(4)["return"]
    with pytest.raises(ValueError, match="episode"):
        paired_differences(values, values.isel(episode=slice(3)))
