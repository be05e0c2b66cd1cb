"""Statistics over seeds against SciPy and by hand, and what the pictures show."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats as scipy_stats

from hrljax.plots import COLOURS, learning_curves
from hrljax.stats import episode_range, mean_interval, smoothed

EPISODES = [10, 20, 30, 40, 45]  # the last bin is half as long


def curve(seeds: int = 6, **axes: list[float]) -> xr.Dataset:
    """Shaped as a dataset of `hrljax.sweep`."""
    shape = (*map(len, axes.values()), seeds, len(EPISODES))
    values = np.random.default_rng(1).normal(-30, 5, shape)
    dims = (*axes, "seed", "episode")
    variables = {"return": (dims, values, {"long_name": "return per episode"})}
    variables["length"] = (dims, -values, {"long_name": "steps per episode", "units": "steps"})
    return xr.Dataset(variables, {**axes, "seed": np.arange(seeds), "episode": EPISODES}, {"learner": "HORDQ"})


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


def test_a_moving_average_covers_the_whole_bins_of_its_window():
    values = xr.DataArray([1.0, 2.0, 6.0, 7.0, 9.0], coords={"episode": EPISODES})
    assert smoothed(values, 10).values.tolist() == [1, 2, 6, 7, 9]
    np.testing.assert_allclose(smoothed(values, 29), [1, 1.5, 4, 6.5, (10 * 7 + 5 * 9) / 15])
    np.testing.assert_allclose(smoothed(values, 30), [1, 1.5, 3, 5, (10 * 6 + 10 * 7 + 5 * 9) / 25])
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


@pytest.mark.parametrize("ends", [(5, 45), (0, 44), (0, 50), (-10, 10)])
def test_a_range_has_to_end_with_bins(ends: tuple[int, int]):
    wrong = ends[0] if ends[0] not in (0, *EPISODES) else ends[1]
    with pytest.raises(ValueError, match=f"episode {wrong} is not the end of a bin"):
        episode_range(curve()["return"], *ends)


def labels(ax: Axes) -> list[str]:
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_one_dataset_is_one_curve_with_its_band():
    data = curve()
    ax = learning_curves(data)
    assert labels(ax) == ["HORDQ (n=6)"]
    (line,), (band,) = ax.lines, ax.collections
    np.testing.assert_allclose(line.get_xydata(), np.stack([EPISODES, data["return"].mean("seed")], -1))
    interval = mean_interval(data["return"])
    edges = band.get_paths()[0].vertices
    assert edges[:, 1].min() == pytest.approx(float(interval["low"].min()))
    assert edges[:, 1].max() == pytest.approx(float(interval["high"].max()))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("episode", "return per episode")


def test_every_combination_of_an_axis_is_a_curve():
    data = curve(3, **{"pseudo_reward": [0.0, 5.0], "env.slip_probability": [0.1, 0.25, 0.5]})
    ax = learning_curves({"flat": curve(), "deep": data}, "length", references={"optimum": 20.0, "limit": 1000.0})
    expected = [f"pseudo_reward={k}, env.slip_probability={p}" for k in (0, 5) for p in (0.1, 0.25, 0.5)]
    assert labels(ax) == [
        "flat (n=6)",
        *(f"deep {setting} (n=3)" for setting in expected),
        "optimum 20.00",
        "limit 1000.00",
    ]
    assert len(ax.collections) == 7
    assert len({line.get_color() for line in ax.lines[:7]}) == 7
    np.testing.assert_allclose(ax.lines[4].get_ydata(), data["length"].sel(pseudo_reward=5).mean("seed")[0])
    assert [float(line.get_ydata()[0]) for line in ax.lines[7:]] == [20, 1000]
    assert ax.get_ylabel() == "steps per episode (steps)"


def test_nothing_cannot_be_drawn():
    with pytest.raises(ValueError, match="curves must hold at least one dataset, got none"):
        learning_curves({})


def test_labels_count_the_finished_runs():
    data = curve()
    assert labels(learning_curves({"one": data.where(data["seed"] < 4)})) == ["one (n=4)"]


def test_a_window_smooths_the_curve():
    data = curve()
    (line,) = learning_curves(data, window=20).lines
    np.testing.assert_allclose(line.get_ydata(), smoothed(data["return"], 20).mean("seed"))


def test_greedy_returns_are_curves_over_checkpoints():
    values = np.random.default_rng(2).normal(size=(2, 5, 3))
    dims = ("pseudo_reward", "seed", "checkpoint")
    coordinates = {"pseudo_reward": [0.0, 5.0], "seed": np.arange(5), "checkpoint": [20, 40, 60]}
    ax = learning_curves(xr.Dataset({"greedy_return": (dims, values)}, coordinates), "greedy_return")
    assert len(ax.lines) == 2
    assert ax.lines[0].get_xdata().tolist() == [20, 40, 60]
    assert labels(ax) == ["pseudo_reward=0 (n=5)", "pseudo_reward=5 (n=5)"]


def test_there_are_colours_for_any_number_of_curves():
    many = len(COLOURS) * 11
    assert len(learning_curves(curve(2, step_size=np.linspace(0.01, 1, many).tolist())).lines) == many


def test_curves_are_drawn_where_the_caller_wants_and_can_be_saved(tmp_path: Path):
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert learning_curves(curve(), ax=right) is right
    assert not left.lines
    learning_curves(curve()).figure.savefig(tmp_path / "curve.png")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
