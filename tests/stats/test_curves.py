"""Moving averages, ranges, areas and thresholds of curves, by hand."""

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.stats import against_steps, area_under_curve, episode_range, episodes_to_reach, smoothed
from tests.curves import EPISODES, curve


def test_a_moving_average_covers_the_whole_bins_of_its_window():
    values = xr.DataArray([1.0, 2.0, 6.0, 7.0, 9.0], coords={"episode": EPISODES})
    assert smoothed(values, 10).values.tolist() == [1, 2, 6, 7, 9]
    np.testing.assert_allclose(smoothed(values, 29), [1, 1.5, 4, 6.5, (70 + 45) / 15])
    np.testing.assert_allclose(smoothed(values, 30), [1, 1.5, 3, 5, (60 + 70 + 45) / 25])
    with pytest.raises(ValueError, match="window must be at least a bin of 10 episodes, got 9"):
        smoothed(values, 9)


def test_a_moving_average_keeps_unfinished_runs_apart():
    values = curve(3)["return"]
    found = smoothed(values.where(values["seed"] < 2), 20)
    assert found.isel(seed=2).isnull().all()
    np.testing.assert_allclose(found.isel(seed=0), smoothed(values.isel(seed=0), 20))


def test_a_range_of_episodes_weighs_bins_by_their_episodes():
    values = xr.DataArray([1.0, 2.0, 6.0, 7.0, 9.0], coords={"episode": EPISODES})
    assert float(episode_range(values, 0, 45)) == pytest.approx((10 * (1 + 2 + 6 + 7) + 5 * 9) / 45)
    assert float(episode_range(values, 30, 45)) == pytest.approx((10 * 7 + 5 * 9) / 15)
    assert float(episode_range(values, 10, 20)) == 2
    many = curve(2)["return"]
    assert episode_range(many, 0, 45).dims == ("seed",)
    assert episode_range(many.where(many["seed"] < 1), 0, 45).isnull().values.tolist() == [False, True]


@pytest.mark.parametrize("ends", [(5, 45), (0, 44), (0, 50)])
def test_a_range_has_to_end_with_bins(ends: tuple[int, int]):
    wrong = ends[0] if ends[0] not in (0, *EPISODES) else ends[1]
    with pytest.raises(ValueError, match=f"episode {wrong} is not the end of a bin"):
        episode_range(curve()["return"], *ends)


@pytest.mark.parametrize("dims", [(), ("checkpoint",)], ids=str)
def test_only_what_has_episodes_can_be_averaged_over_them(dims: tuple[str, ...]):
    values = xr.DataArray(np.zeros((3,) * len(dims)), dims=dims)
    with pytest.raises(ValueError, match=f"values must have a dimension 'episode', got {''.join(dims) or 'none'}"):
        smoothed(values, 10)


def test_a_range_has_to_have_a_bin():
    with pytest.raises(ValueError, match="first must be less than last, got 20 and 20"):
        episode_range(curve()["return"], 20, 20)


def test_the_area_is_the_sum_over_episodes():
    values = xr.DataArray([1.0, 2.0, 6.0, 7.0, 9.0], coords={"episode": EPISODES}, name="return")
    assert float(area_under_curve(values)) == pytest.approx(10 * (1 + 2 + 6 + 7) + 5 * 9)
    assert float(area_under_curve(values, 10, 30)) == pytest.approx(10 * (2 + 6))
    assert float(area_under_curve(values, 30, reference=10.0)) == pytest.approx(-(10 * 3 + 5 * 1))
    assert area_under_curve(values).attrs == {"long_name": "area under return", "units": "episodes"}
    lengths = curve(3, pseudo_reward=[0.0, 5.0])["length"]
    area = area_under_curve(lengths.where(lengths["seed"] != 1))
    assert area.dims == ("pseudo_reward", "seed")
    assert area.isnull().values.tolist() == [[False, True, False]] * 2
    assert area.attrs == {"long_name": "area under steps per episode", "units": "steps x episodes"}


@settings(derandomize=True, deadline=None, max_examples=30)
@given(st.lists(st.integers(-100, 100), min_size=2, max_size=8), st.integers(1, 7), st.data())
def test_areas_of_neighbouring_ranges_add_up(heights: list[int], last_bin: int, data: st.DataObject):
    ends = [7 * (i + 1) for i in range(len(heights) - 1)] + [7 * (len(heights) - 1) + last_bin]
    values = xr.DataArray(np.array(heights, np.float64), coords={"episode": ends}, name="return")
    middle = data.draw(st.sampled_from(ends[:-1]))
    parts = area_under_curve(values, 0, middle) + area_under_curve(values, middle)
    assert float(parts) == pytest.approx(float(area_under_curve(values)))
    assert float(area_under_curve(values, reference=1.5)) == pytest.approx(float(parts) - 1.5 * ends[-1])


RISING = xr.DataArray([-50.0, -10.0, -40.0, -12.0, -4.0], coords={"episode": EPISODES})


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"target": -10.0}, 20),
        ({"target": -9.0}, 45),
        ({"target": -3.0}, np.inf),
        ({"target": -25.0, "window": 20}, 30),  # means of two bins: -30, -25, -26, -28/3
        ({"target": -24.0, "window": 20}, 45),
        ({"target": -26.0, "window": 29}, 30),
        ({"target": -23.0, "window": 40}, 45),  # one mean, of the last bins: (-10 - 40 - 12) * 10 and -4 * 5 over 35
        ({"target": 0.0, "share": 0.8, "baseline": -50.0}, 20),  # -10
        ({"target": 0.0, "share": 0.9, "baseline": -50.0}, 45),  # -5
        ({"target": 0.0, "share": 0.9, "baseline": -20.0}, np.inf),  # -2
        ({"target": -50.0}, 10),
    ],
    ids=str,
)
def test_episodes_to_reach_a_threshold(options: dict[str, float], expected: float):
    assert float(episodes_to_reach(RISING, **options)) == expected


def test_episodes_to_reach_tells_never_from_unfinished():
    values = xr.concat([RISING, RISING - 10, RISING * np.nan], "seed")
    found = episodes_to_reach(values, -10.0)
    np.testing.assert_array_equal(found, [20, np.inf, np.nan])
    assert found.attrs == {"long_name": "episodes to reach -10", "units": "episodes"}


def test_episodes_to_reach_along_checkpoints():
    values = RISING.rename(episode="checkpoint")
    assert float(episodes_to_reach(values, -10.0, along="checkpoint")) == 20
    with pytest.raises(ValueError, match="window must be None along 'checkpoint', got 20"):
        episodes_to_reach(values, -10.0, along="checkpoint", window=20)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": 1.0, "share": 0.0}, r"share must be a finite number in \(0, 1\], got 0.0"),
        ({"target": 1.0, "share": 1.01}, r"share must be a finite number in \(0, 1\], got 1.01"),
        ({"target": -24.0, "share": 0.9}, "baseline must be less than the target -24, got 0.0"),
        ({"target": np.inf}, "target must be a finite number in .*, got inf"),
        ({"target": 1.0, "window": 9}, "window must be at least a bin of 10 episodes, got 9"),
        ({"target": 1.0, "along": "time"}, "along must be one of 'episode', 'checkpoint', got 'time'"),
    ],
    ids=str,
)
def test_a_threshold_that_makes_no_sense_is_refused(options: dict[str, float], message: str):
    with pytest.raises(ValueError, match=message):
        episodes_to_reach(RISING, **options)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: smoothed(RISING, 2.5), TypeError, "window must be an integer from 1 to 2147483647, got 2.5"),
        (lambda: smoothed(RISING, True), TypeError, "window must be an integer from 1 to 2147483647, got True"),
        (lambda: smoothed(np.zeros(3), 10), TypeError, "values must be a DataArray such as .*got array"),
        (lambda: episode_range(RISING, 0, 1.5), TypeError, "last must be an integer from 0 to 2147483647, got 1.5"),
        (lambda: episode_range(RISING, -10, 10), ValueError, "first must be an integer from 0 to 2147483647, got -10"),
        (lambda: area_under_curve(RISING, reference=np.nan), ValueError, "reference must be a finite number .*got nan"),
    ],
)
def test_a_bad_argument_is_refused(call: Callable[[], object], error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        call()


@settings(derandomize=True, deadline=None, max_examples=50)
@given(st.lists(st.integers(-20, 20), min_size=1, max_size=9), st.integers(1, 5), st.integers(1, 60))
def test_a_moving_average_is_that_of_the_episodes_of_its_whole_bins(heights: list[int], last_bin: int, window: int):
    sizes = [5] * (len(heights) - 1) + [last_bin if len(heights) > 1 else 5]
    window = max(window, sizes[0])
    values = xr.DataArray(np.array(heights, np.float64), coords={"episode": np.cumsum(sizes)})
    for i, found in enumerate(smoothed(values, window).values):
        bins = range(max(0, i + 1 - window // 5), i + 1)
        episodes = [heights[b] for b in bins for _ in range(sizes[b])]
        assert found == pytest.approx(np.mean(episodes))


def test_against_steps_a_run_has_the_value_of_the_bin_that_it_is_in():
    """By hand: bins of 2, 2 and 1 episodes; 10, 30 and 5 steps in the first run, 20, 20 and 20 in the second."""
    curves = xr.Dataset(
        {
            "return": (("seed", "episode"), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
            "length": (("seed", "episode"), [[5.0, 15.0, 5.0], [10.0, 10.0, 20.0]]),
        },
        {"seed": [0, 1], "episode": [2, 4, 5]},
    )
    by_steps = against_steps(curves, num=9)
    assert by_steps["steps"].values.tolist() == [5, 10, 15, 20, 25, 30, 35, 40, 45]
    assert by_steps.sel(seed=0).values.tolist() == [1, 1, 2, 2, 2, 2, 2, 2, 3]
    assert by_steps.sel(seed=1).values.tolist() == [4, 4, 4, 4, 5, 5, 5, 5, 6]
    assert against_steps(curves, "length", num=1).values.ravel().tolist() == [5, 20]


def test_against_steps_unfinished_runs_are_nan_and_do_not_cut_the_others_short():
    data = curve(4, step_size=[0.1, 0.2])
    unfinished = data.where((data["seed"] < 3) | (data["step_size"] < 0.15))
    by_steps = against_steps(unfinished)
    assert by_steps.dims == ("step_size", "seed", "steps")
    assert by_steps.isnull().all("steps").values.tolist() == [[False] * 4, [False] * 3 + [True]]
    assert float(by_steps["steps"][-1]) == pytest.approx(float(unfinished["length"].weighted(
        xr.DataArray([10, 10, 10, 10, 5], dims="episode")).sum("episode", skipna=False).min()))  # fmt: skip


def test_against_steps_refuses_what_has_no_lengths():
    with pytest.raises(ValueError, match="curves must have the variable 'length'"):
        against_steps(curve()[["return"]])
    with pytest.raises(ValueError, match="curves must have a finished run"):
        against_steps(curve() * np.nan)
    with pytest.raises(ValueError, match="variable must be"):
        against_steps(curve(), "steps")
    with pytest.raises(TypeError, match="curves must be a dataset"):
        against_steps(curve()["return"])
