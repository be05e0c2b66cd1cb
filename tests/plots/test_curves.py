"""What the pictures of learning curves show."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread

from hrljax.plots import COLOURS, learning_curves
from hrljax.stats import against_steps, mean_interval, smoothed
from tests.curves import EPISODES, curve


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


def test_labels_count_the_finished_runs():
    data = curve()
    assert labels(learning_curves({"one": data.where(data["seed"] < 4)})) == ["one (n=4)"]


def test_a_window_smooths_the_curve():
    data = curve()
    (line,) = learning_curves(data, window=20).lines
    whole = smoothed(data["return"], 20).mean("seed").isel(episode=slice(1, None))
    np.testing.assert_allclose(line.get_ydata(), whole)
    np.testing.assert_array_equal(line.get_xdata(), EPISODES[1:])


def test_a_curve_begins_where_its_first_window_is_whole():
    """Averages over what there is of a window would bend where it becomes whole: then bad first episodes leave it."""
    returns = xr.DataArray([[-100.0, *[-10.0] * 39]], dims=("seed", "episode"), coords={"episode": np.arange(1, 41)})
    (line,) = learning_curves(returns.rename("return"), window=20).lines
    np.testing.assert_array_equal(line.get_xdata(), np.arange(20, 41))
    (longer,) = learning_curves(returns.rename("return"), window=100).lines
    np.testing.assert_array_equal(longer.get_xdata(), np.arange(20, 41))


def test_axes_and_their_figure_show_themselves_in_a_notebook():
    """IPython asks the last expression of a cell for `_repr_png_`."""
    ax = learning_curves(curve())
    for shown in (ax, ax.figure):
        assert imread(BytesIO(shown._repr_png_())).std() > 0.05


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


def test_curves_against_steps_say_so():
    ax = learning_curves(against_steps(curve(), num=12))
    (line,) = ax.lines
    assert (ax.get_xlabel(), len(line.get_xdata())) == ("primitive steps", 12)
