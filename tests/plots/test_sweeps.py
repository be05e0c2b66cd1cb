"""What heat maps, pictures of sensitivity and interval plots show."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

import hrljax as hrl
from hrljax import stats
from hrljax.plots import COLOURS, heat_map, intervals, learning_curves, sensitivity
from tests.curves import curve

STEP_SIZES, PSEUDO_REWARDS = [0.01, 0.1, 0.5, 1.0], [0.0, 5.0, 60.0]


def swept(seeds: int = 5) -> xr.DataArray:
    """One number a run; the best combination is a step size of 0.1 and a pseudo-reward of 60."""
    means = np.array([[-40.0, -38, -36], [-30, -28, -26], [-60, -50, -45], [-99, -98, -97]])
    values = means[..., None] + np.linspace(-1, 1, seeds) ** 3
    coordinates = {"step_size": STEP_SIZES, "pseudo_reward": PSEUDO_REWARDS, "seed": np.arange(seeds)}
    return xr.DataArray(
        values,
        coordinates,
        ["step_size", "pseudo_reward", "seed"],
        "return",
        {"long_name": "return", "units": "reward"},
    )


def pixels(ax: Axes) -> np.ndarray:
    """The picture inside the axes as numbers."""
    figure = ax.figure
    assert isinstance(figure, Figure)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    box = ax.get_window_extent().padded(-3)
    image = np.asarray(canvas.buffer_rgba())[::-1]
    return image[int(box.y0) : int(box.y1), int(box.x0) : int(box.x1), :3]


def colourful(ax: Axes) -> float:
    """Which share of what is inside the axes is neither white nor grey nor black."""
    return float((np.ptp(pixels(ax).astype(int), axis=-1) > 60).mean())


def test_an_empty_picture_has_no_colours():
    ax = Figure().subplots()
    ax.grid()
    ax.axhline(0.5, color="#444444")
    assert colourful(ax) == 0


DRAWN: dict[str, Callable[[], Axes]] = {
    "learning_curves": lambda: learning_curves(curve()),
    "heat_map": lambda: heat_map(swept(), "step_size", "pseudo_reward"),
    "sensitivity": lambda: sensitivity(swept(), "step_size", lines="pseudo_reward"),
    "intervals": lambda: intervals({"one": swept()[0, 0], "two": swept()[1, 0]}),
}


@pytest.mark.parametrize("picture", DRAWN)
def test_no_picture_is_empty(picture: str, tmp_path: Path):
    ax = DRAWN[picture]()
    assert colourful(ax) > 0.002
    assert ax.get_xlabel()
    texts = [*(t.get_text() for t in ax.get_yticklabels()), ax.get_title()]
    texts += [t.get_text() for t in ax.get_legend().get_texts()] if ax.get_legend() else []
    assert any("(n=" in text for text in texts)
    ax.figure.savefig(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def cells(ax: Axes) -> np.ndarray:
    (image,) = [child for child in ax.get_children() if isinstance(child, AxesImage)]
    return image.get_array()


def test_a_heat_map_shows_the_statistic_of_every_cell():
    ax = heat_map(swept(), "step_size", "pseudo_reward", title="HORDQ")
    np.testing.assert_allclose(cells(ax), swept().mean("seed").T)
    assert [t.get_text() for t in ax.get_xticklabels()] == ["0.01", "0.1", "0.5", "1"]
    assert [t.get_text() for t in ax.get_yticklabels()] == ["0", "5", "60"]
    assert [t.get_text() for t in ax.texts][:4] == ["-40", "-30", "-60", "-99"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("step size", "pseudo-reward")
    assert ax.get_title() == "HORDQ, mean (n=5)"
    _, bar = ax.figure.axes
    assert bar.get_ylabel() == "return (reward)"


def test_a_heat_map_of_a_dataset_shows_the_mean_return_and_says_of_which_learner_and_environment():
    runs = {"seeds": 2, "num_episodes": 3, "axes": {"step_size": [0.1, 0.5], "epsilon": [0.1, 0.2]}, "progress": False}
    curves = hrl.sweep(hrl.make("Maze"), hrl.QLearning(), **runs)
    ax = heat_map(curves, "step_size", "epsilon")
    assert ax.get_title() == "Q-learning on Maze, mean (n=2)"
    shown = ax.images[0].get_array()
    np.testing.assert_allclose(shown, curves["return"].mean(["seed", "episode"]).transpose("epsilon", "step_size"))


def test_a_heat_map_may_be_turned_and_show_another_statistic():
    ax = heat_map(swept(8), "pseudo_reward", "step_size", statistic="interquartile_mean")
    np.testing.assert_allclose(cells(ax), stats.interquartile_mean(swept(8)))
    assert ax.get_title() == "interquartile mean (n=8)"


@pytest.mark.parametrize(("best", "expected"), [("greatest", (1, 2)), ("least", (3, 0)), (None, None)])
def test_the_best_cell_has_a_frame(best: str | None, expected: tuple[int, int] | None):
    ax = heat_map(swept(), "step_size", "pseudo_reward", best=best)
    assert [patch.get_center().tolist() for patch in ax.patches] == ([] if expected is None else [list(expected)])


def test_cells_without_a_number_are_grey_and_say_why():
    values = swept()
    values[0, 0] = np.nan
    values[1, 0, 3] = np.nan
    values[2, 0, 1] = np.inf
    ax = heat_map(values, "step_size", "pseudo_reward")
    assert [t.get_text() for t in ax.texts][:3] == ["none", "-30", "never"]
    assert cells(ax).mask[0].tolist() == [True, False, True, False]
    assert ax.get_title() == "mean (n=0 to 5)"
    grey = pixels(ax)[5, 5]
    assert grey.tolist() == [0xDD] * 3


def test_the_limits_of_colours_can_be_set():
    ax = heat_map(swept(), "step_size", "pseudo_reward", limits=(-60.0, -20.0))
    image = next(child for child in ax.get_children() if isinstance(child, AxesImage))
    assert image.get_clim() == (-60, -20)
    assert image.colorbar.extend == "min"


def test_limits_may_be_equal_as_they_are_when_an_interrupt_has_left_one_value():
    ax = heat_map(swept(), "step_size", "pseudo_reward", limits=(-30.0, -30.0))
    ax.figure.canvas.draw()


def test_sensitivity_is_a_line_for_every_value_of_another_axis():
    ax = sensitivity(swept(), "step_size", lines="pseudo_reward", references={"optimum": -24.59})
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == [*(f"pseudo_reward={k:g} (n=5)" for k in PSEUDO_REWARDS), "optimum -24.59"]
    for line, expected in zip(ax.lines[:3], swept().mean("seed").values.T, strict=True):
        np.testing.assert_allclose(line.get_xydata(), np.stack([STEP_SIZES, expected], -1))
    interval = stats.mean_interval(swept().sel(pseudo_reward=60))
    edges = ax.collections[2].get_paths()[0].vertices[:, 1]
    assert edges.min() == pytest.approx(float(interval["low"].min()))
    assert edges.max() == pytest.approx(float(interval["high"].max()))
    assert ax.get_xscale() == "log"
    assert [t.get_text() for t in ax.get_xticklabels()] == ["0.01", "0.1", "0.5", "1"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("step size", "return (reward), mean")
    assert ax.lines[3].get_ydata()[0] == -24.59


def test_sensitivity_of_several_learners_and_of_another_statistic():
    flat = swept().isel(pseudo_reward=0, drop=True)
    ax = sensitivity({"deep": swept(), "flat": flat}, "step_size", lines="pseudo_reward", statistic="median")
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == [*(f"deep pseudo_reward={k:g} (n=5)" for k in PSEUDO_REWARDS), "flat (n=5)"]
    np.testing.assert_allclose(ax.lines[3].get_ydata(), flat.median("seed"))
    assert len({line.get_color() for line in ax.lines}) == 4


def test_sensitivity_to_values_with_zero_is_linear_and_leaves_gaps():
    values = swept().isel(step_size=1, drop=True)
    values[1, 0] = np.inf
    ax = sensitivity(values, "pseudo_reward")
    assert ax.get_xscale() == "linear"
    assert np.isnan(ax.lines[0].get_ydata()).tolist() == [False, True, False]


def test_intervals_are_a_row_for_every_learner():
    values = {"HORDQ": swept(8)[1, 2], "Q-learning": swept(8)[0, 0].isel(seed=slice(6))}
    ax = intervals(values, references={"optimum": -24.59})
    assert [t.get_text() for t in ax.get_yticklabels()] == ["HORDQ (n=8)", "Q-learning (n=6)"]
    legend = [text.get_text() for text in ax.get_legend().get_texts()]
    assert legend == ["mean", "interquartile mean", "optimum -24.59"]
    means, middles, optimum = ax.lines
    np.testing.assert_allclose(means.get_xdata(), [float(runs.mean()) for runs in values.values()])
    np.testing.assert_allclose(middles.get_xdata(), [float(stats.interquartile_mean(r)) for r in values.values()])
    assert (means.get_ydata() < middles.get_ydata()).all()
    assert optimum.get_xdata()[0] == -24.59
    interval = stats.bootstrap_interval(values["HORDQ"], "interquartile_mean")
    segment = ax.collections[1].get_segments()[0]
    np.testing.assert_allclose(segment[:, 0], [interval["low"], interval["high"]])
    assert ax.get_ylim() == (1.5, -0.5)
    assert ax.get_xlabel() == "return (reward)"


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda: learning_curves({}), "curves must hold at least one dataset, got none"),
        (
            lambda: learning_curves(curve(), "damage"),
            "variable must be one of return, length, those over episodes, got 'damage'",
        ),
        (
            lambda: learning_curves({"a": curve()}, "damage"),
            "variable of 'a' must be one of return, length, those over episodes, got 'damage'",
        ),
        (
            lambda: learning_curves(curve().assign(steps=curve()["return"].sum("episode")), "steps"),
            "length, those over",
        ),
        (
            lambda: learning_curves(curve()["return"].mean("seed")),
            "curves must have the dimensions 'seed' and 'episode', 'checkpoint' or 'steps', got",
        ),
        (
            lambda: learning_curves(curve(), references={"optimum": np.nan}),
            "references: optimum must be a finite number",
        ),
        (lambda: heat_map(swept(), "step_size", "pseudo_reward", limits=(5, 1)), r"limits must be in order.*\(5, 1\)"),
        (lambda: heat_map(swept(), "step_size", "step_size"), "x and y must differ, got 'step_size' twice"),
        (lambda: heat_map(swept()[0], "step_size", "pseudo_reward"), "values must have the dimension 'step_size'"),
        (lambda: heat_map(swept().mean("seed"), "step_size", "pseudo_reward"), "values must have the dimension 'seed'"),
        (lambda: heat_map(swept() * np.nan, "step_size", "pseudo_reward"), "values has no finished run"),
        (lambda: heat_map(swept(), "step_size", "pseudo_reward", best="top"), "best must be .* got 'top'"),
        (lambda: sensitivity(swept(), "step_size"), "values has the dimension 'pseudo_reward' that the picture"),
        (lambda: sensitivity({}, "step_size"), "values must hold at least one array, got none"),
        (lambda: sensitivity({"a": swept()[0]}, "step_size"), "'a' must have the dimension 'step_size'"),
        (lambda: sensitivity(swept(), "step_size", lines="epsilon"), "values must have the dimension 'epsilon'"),
        (lambda: intervals({}), "values must hold at least one array, got none"),
        (lambda: intervals({"a": swept()[0, 0]}, ()), "statistics must be at least one, got none"),
        (lambda: intervals({"a": swept()}), "'a' has the dimension 'step_size' that the picture does not show"),
        (lambda: intervals({"a": swept()[0, 0]}, ("mode",)), "statistic must be one of 'mean'"),
    ],
)
def test_what_cannot_be_drawn_is_refused(draw: Callable[[], Axes], message: str):
    with pytest.raises(ValueError, match=message):
        draw()


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (
            lambda: learning_curves([curve()]),
            "curves must be a dataset of hrljax.sweep, a DataArray, or several by name",
        ),
        (
            lambda: learning_curves({"a": np.zeros(3)}),
            "curves of 'a' must be a dataset of hrljax.sweep or a DataArray, got",
        ),
        (lambda: learning_curves(curve(), window=2.5), "window must be an integer from 1 to 2147483647, got 2.5"),
        (lambda: learning_curves(curve(), references=5), "references must be a mapping such as .*got 5"),
        (lambda: learning_curves(curve(), ax="here"), "ax must be Matplotlib's axes or None, got 'here'"),
        (lambda: heat_map(swept(), "step_size", "pseudo_reward", limits=5), "limits must be two numbers, got 5"),
        (
            lambda: sensitivity(np.zeros(3), "step_size"),
            "values must be a DataArray, or a mapping from names to DataArrays",
        ),
        (lambda: sensitivity(curve(), "step_size"), "values must be one variable of a dataset, such as curves"),
        (lambda: intervals(curve()), "values must be one variable of a dataset, such as curves"),
        (lambda: intervals(swept()), "values must be a mapping from names to DataArrays, got <xarray.DataArray"),
        (lambda: intervals({"a": swept()[0, 0]}, "mean"), "statistics must be a sequence of names, got 'mean'"),
    ],
)
def test_what_is_of_the_wrong_type_is_refused(draw: Callable[[], Axes], message: str):
    with pytest.raises(TypeError, match=message):
        draw()


def test_an_array_of_a_dataset_is_a_curve_too():
    data = curve(3, step_size=[0.1, 0.2])
    for drawn in (data["return"], {"HORDQ": data["return"]}, data["return"].rename(None)):
        lines = learning_curves(drawn).lines
        for line, expected in zip(lines, learning_curves(data).lines, strict=True):
            np.testing.assert_array_equal(line.get_xydata(), expected.get_xydata())


def test_curves_that_share_a_colour_have_other_dashes():
    ax = learning_curves(curve(2, step_size=np.linspace(0.01, 1, len(COLOURS) * 3).tolist()))
    assert len({(line.get_color(), line.get_linestyle()) for line in ax.lines}) == len(COLOURS) * 3


def test_curves_of_another_statistic_say_so():
    data = curve(8)
    ax = learning_curves(data, "length", statistic="interquartile_mean")
    np.testing.assert_allclose(ax.lines[0].get_ydata(), stats.interquartile_mean(data["length"]))
    assert ax.get_ylabel() == "steps per episode (steps), interquartile mean"


POINTS = {"step_size": [0.05, 0.8, 0.2], "epsilon": [0.3, 0.1, 0.2]}


def of_points() -> xr.DataArray:
    """One number a run of three points; the second is the best."""
    coordinates = {"point": np.arange(3), **{name: ("point", values) for name, values in POINTS.items()}}
    values = np.array([-40.0, -20, -30])[:, None] + np.linspace(-1, 1, 5)
    return xr.DataArray(values, coordinates, ("point", "seed"), "return")


def test_points_are_coloured_dots_with_a_ring_around_the_best():
    ax = heat_map(of_points(), "step_size", "epsilon")
    (dots,) = ax.collections
    np.testing.assert_array_equal(dots.get_offsets(), np.transpose(list(POINTS.values())))
    np.testing.assert_allclose(dots.get_array(), [-40, -20, -30])
    (ring,) = ax.lines
    assert ring.get_xydata().tolist() == [[0.8, 0.1]]
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "linear")
    assert heat_map(of_points(), "step_size", "epsilon", best="least").lines[0].get_xydata().tolist() == [[0.05, 0.3]]
    assert not heat_map(of_points(), "step_size", "epsilon", best=None).lines


def test_the_sensitivity_of_points_is_a_marker_each_with_its_interval():
    ax = sensitivity(of_points(), "epsilon")
    (drawn,) = ax.containers
    markers, _, (whiskers,) = drawn
    assert markers.get_xydata().tolist() == [[0.3, -40], [0.1, -20], [0.2, -30]]
    interval = stats.mean_interval(of_points())
    ends = [segment[:, 1].tolist() for segment in whiskers.get_segments()]
    np.testing.assert_allclose(ends, np.transpose([interval["low"], interval["high"]]))
    assert not set(POINTS["epsilon"]) <= set(ax.get_xticks()), "labels of points that are close would overlap"


def test_curves_of_points_say_their_hyper_parameters():
    along = {name: values for name, values in of_points().coords.items() if name in POINTS}
    points = xr.concat([curve()["return"]] * 3, "point").assign_coords(along)
    ax = learning_curves(points)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [
        "step_size=0.05, epsilon=0.3 (n=6)",
        "step_size=0.8, epsilon=0.1 (n=6)",
        "step_size=0.2, epsilon=0.2 (n=6)",
    ]
