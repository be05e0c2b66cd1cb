"""Sweeps over combinations of hyper-parameters that form no grid."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.stats import qmc

import hrljax as hrl
from tests.maps import SMALL

VALUES = {"step_size": [0.5, 0.125, 0.5], "env.slip_probability": [0.0, 0.25, 0.25]}
LEARNER = hrl.QLearning(initial_value=-25.0)
OPTIONS: dict[str, Any] = {"seeds": 3, "num_episodes": 8, "bin_size": 4, "keep_learned": True, "progress": False}


@pytest.fixture(scope="module")
def zipped() -> xr.Dataset:
    return hrl.sweep(SMALL, LEARNER, axes=hrl.points(VALUES), **OPTIONS)


@pytest.fixture(scope="module")
def grid() -> xr.Dataset:
    """All combinations of the same values."""
    axes = {name: sorted(set(values)) for name, values in VALUES.items()}
    return hrl.sweep(SMALL, LEARNER, axes=axes, **OPTIONS)


def test_points_are_a_dimension_and_their_values_coordinates_along_it(zipped: xr.Dataset):
    assert zipped["return"].dims == ("point", "seed", "episode")
    assert zipped["point"].values.tolist() == [0, 1, 2]
    for name, values in VALUES.items():
        assert zipped[name].dims == ("point",)
        assert zipped[name].values.tolist() == values
    assert zipped.attrs["learner.step_size"] == "swept"


def test_a_point_gives_what_it_gives_in_a_grid(zipped: xr.Dataset, grid: xr.Dataset):
    for point in range(3):
        setting = {name: values[point] for name, values in VALUES.items()}
        for name, expected in grid.sel(setting).data_vars.items():
            np.testing.assert_array_equal(zipped[name].sel(point=point), expected, err_msg=str(name))


def test_a_store_of_points_opens_continues_and_refuses_others(zipped: xr.Dataset, tmp_path: Path):
    path, points = tmp_path / "points.zarr", hrl.points(VALUES)
    fewer = hrl.sweep(SMALL, LEARNER, axes=points, **{**OPTIONS, "seeds": 2}, store=path, chunk_size=2)
    assert fewer.equals(zipped.isel(seed=slice(2)))
    assert hrl.sweep(SMALL, LEARNER, axes=points, **OPTIONS, store=path, chunk_size=2).equals(zipped)
    loaded = hrl.load(path)
    assert loaded.equals(zipped)
    assert set(loaded.coords) == set(zipped.coords)
    opened = xr.open_zarr(path, chunks=None)
    assert opened.equals(zipped)
    assert set(opened.coords) == set(zipped.coords)
    hrl.save(loaded, tmp_path / "saved.zarr")
    assert hrl.load(tmp_path / "saved.zarr").equals(loaded)
    (path / "return" / "c" / "1" / "0" / "0").write_bytes(b"?")
    with pytest.raises(
        ValueError, match=r"return/c/1/0/0 \(step_size=0\.125, env\.slip_probability=0\.25, seeds 0 to 1\)"
    ):
        hrl.load(path)
    with pytest.raises(ValueError, match="axes"):
        hrl.sweep(SMALL, LEARNER, axes=VALUES | {"step_size": [0.5, 0.125]}, **OPTIONS, store=path)


@pytest.mark.parametrize("begin", ["points", "grid"])
def test_runs_go_on_from_points_and_from_a_grid(begin: str, zipped: xr.Dataset, grid: xr.Dataset):
    """Points in another order, of which each goes on from the run with its values."""
    turned = hrl.points({name: values[::-1] for name, values in VALUES.items()})
    rest = hrl.sweep(SMALL, LEARNER, axes=turned, **OPTIONS, start={"points": zipped, "grid": grid}[begin])
    whole = hrl.sweep(SMALL, LEARNER, axes=hrl.points(VALUES), **{**OPTIONS, "num_episodes": 16})
    assert rest["return"].episode.values.tolist() == [12, 16]
    for name, expected in whole.isel(episode=slice(2, None)).data_vars.items():
        np.testing.assert_array_equal(rest[name].values[::-1], expected, err_msg=str(name))


def test_runs_cannot_go_on_from_points_that_are_missing(zipped: xr.Dataset, grid: xr.Dataset):
    def go_on(axes: Any, start: xr.Dataset = zipped) -> xr.Dataset:
        return hrl.sweep(SMALL, LEARNER, axes=axes, **OPTIONS, start=start)

    with pytest.raises(ValueError, match=r"no runs with step_size = 0\.25, env.slip_probability = 0"):
        go_on(hrl.points({"step_size": [0.25], "env.slip_probability": [0.0]}))
    with pytest.raises(ValueError, match="start has points of"):
        go_on(hrl.points({"step_size": [0.5]}))
    with pytest.raises(ValueError, match="start has an axis 'point'"):
        go_on({"step_size": [0.5]})
    with pytest.raises(ValueError, match=r"no runs with step_size = 0\.25"):
        go_on(hrl.points({"step_size": [0.25], "env.slip_probability": [0.0]}), grid)


def test_what_a_point_has_learned(zipped: xr.Dataset):
    learned = hrl.Learned.of(zipped, SMALL, LEARNER, seed=2, at={"point": 1})
    assert learned.learner.settings()["step_size"] == 0.125
    np.testing.assert_array_equal(learned.tables, zipped["learned"].sel(point=1, seed=2))
    with pytest.raises(KeyError, match="at: point must be one of 0, 1, 2, got 3"):
        hrl.Learned.of(zipped, SMALL, LEARNER, at={"point": 3})


def test_points_of_a_sobol_sequence_are_estimated_and_the_best_is_named():
    sample = qmc.scale(qmc.Sobol(2, rng=0).random_base2(2), [0.05, 0.01], [1.0, 0.3])
    points = hrl.points({"step_size": sample[:, 0], "epsilon": sample[:, 1]})
    options = {"seeds": 2, "num_episodes": 4}
    assert hrl.estimate(SMALL, LEARNER, axes=points, **options).runs == 8
    curves = hrl.sweep(SMALL, LEARNER, axes=points, **options, progress=False)
    means = curves["return"].mean("episode")
    best = hrl.stats.best(means)
    assert best["mean"] == means.mean("seed").max()
    assert best["epsilon"] == sample[int(best["point"]), 1]


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: hrl.points([0.1]), TypeError, "values must be a mapping"),
        (lambda: hrl.points({}), ValueError, "as many values as the others, got none"),
        (lambda: hrl.points({"step_size": 0.1}), TypeError, "must be a sequence of numbers"),
        (lambda: hrl.points({"a": [1], "b": [1, 2]}), ValueError, "got 'a' 1, 'b' 2"),
        (lambda: hrl.points({"size": [1]}), ValueError, "'size' cannot be swept"),
        (lambda: hrl.points({"step_size": []}), ValueError, "at least one"),
        (lambda: hrl.points({"step_size": [2.0]}), ValueError, "step_size"),
        (lambda: hrl.points({"step_size": [0.1, 0.1]}), ValueError, "must be different"),
    ],
)
def test_points_that_make_no_sense_are_refused(make: Callable[[], hrl.Points], error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        hrl.sweep(SMALL, LEARNER, axes=make(), **OPTIONS)
