"""The runs of a sweep that go on from runs of another one."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, NamedTuple

import chex
import jax
import numpy as np

from hrljax.engine.start import LEARNED, Start, Startable, checked_start, learned_shapes, step_words, tree_of
from hrljax.envs.base import AnyEnvironment
from hrljax.learners.base import AnyLearner
from hrljax.sweeps.axes import POINT
from hrljax.sweeps.fingerprint import differences
from hrljax.sweeps.schema import Grid
from hrljax.sweeps.versions import Attributes

if TYPE_CHECKING:
    import xarray as xr

NUM_STEPS = "num_steps"
_EPISODES_BEFORE = "episodes_before"


class Continuation(NamedTuple):
    """Where the runs of a sweep start."""

    episodes: int  # that all of them have learned from
    rows: dict[str, chex.ArrayTree]  # the other fields of `hrljax.engine.start.Start`, NumPy arrays ``[runs, ...]``

    def attributes(self) -> Attributes:
        """Of the dataset."""
        return {_EPISODES_BEFORE: self.episodes}

    def digest(self) -> str:
        """A digest of everything that the runs start with; of what is the same for all, whatever their number."""
        digest = hashlib.sha256(str(self.episodes).encode())
        for rows in jax.tree.leaves(self.rows):
            leaf = rows if rows.strides[0] else rows[:1]
            digest.update(f"{leaf.dtype.str}{leaf.shape}".encode() + np.ascontiguousarray(leaf).tobytes())
        return digest.hexdigest()[:32]


def episodes_of(dataset: xr.Dataset) -> int:
    """The episodes that the runs of a sweep have learned from, those before it included.

    Where steps stop runs, those of the one run that the dataset then has to hold.
    """
    if NUM_STEPS in dataset.attrs:
        return int(dataset["episode"].where(dataset["return"].notnull()).max())
    return int(dataset.attrs.get(_EPISODES_BEFORE, 0)) + int(dataset.attrs["num_episodes"])


def continuation(
    start: object, env: AnyEnvironment, learner: AnyLearner, grid: Grid, num_episodes: int
) -> Continuation:
    """Where the runs of a sweep start, for `start` as of `hrljax.sweep`.

    Raises:
        TypeError, ValueError: `start` has not what every run needs.
    """
    if isinstance(start, Startable) and not isinstance(start, type):
        begin = checked_start(start, env, learner, num_episodes)
        same = jax.tree.map(np.asarray, {"learned": begin.learned, "step_words": begin.step_words})
        rows = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (grid.num_runs, *leaf.shape)), same)
        return Continuation(int(begin.episodes), rows)
    import xarray as xr  # here, because importing it takes longer than the rest of hrljax

    if not isinstance(start, xr.Dataset):
        raise TypeError(
            f"start must be a dataset of hrljax.sweep(..., keep_learned=True) or a hrljax.Learned, got {start!r}"
        )
    check_origin("start", start, env, learner)
    if NUM_STEPS in start.attrs:
        raise ValueError(
            "start was stopped by num_steps, so that its runs have learned from different numbers of episodes; "
            "go on from one of them, a hrljax.Learned"
        )
    names = names_of_tables("start", start)
    runs = _runs(start, grid)
    named = {name: _rows(runs[name], grid) for name in names}
    learned = tree_of(learned_shapes(env, learner), named, (grid.num_runs,))
    rows = {"learned": learned, "step_words": step_words(_rows(runs["steps"], grid))}
    first = Start(episodes=episodes_of(start), **jax.tree.map(lambda leaf: leaf[0], rows))
    checked_start(first, env, learner, num_episodes)
    return Continuation(first.episodes, rows)


def check_origin(what: str, dataset: xr.Dataset, env: AnyEnvironment, learner: AnyLearner) -> None:
    """Raises ValueError for the dataset of another learner or environment; messages call it `what`."""
    names = {"environment": env.name, "learner": learner.name}
    wrong = differences({name: dataset.attrs.get(name) for name in names}, names)
    if wrong:
        raise ValueError(f"{what} is of another sweep: {'; '.join(wrong)}")


def names_of_tables(what: str, dataset: xr.Dataset) -> list[str]:
    """The variables of a dataset that are learned tables; raises ValueError, which calls it `what`, without any."""
    tables = [str(name) for name in dataset if str(name).startswith(LEARNED)]
    if not tables:
        raise ValueError(f"{what} has no tables; sweep with keep_learned=True")
    return tables


def swept_along_points(dataset: xr.Dataset) -> list[str]:
    """Hyper-parameters that a dataset has along the dimension of points."""
    along = ((str(name), values.dims) for name, values in dataset.coords.items())
    return [name for name, dims in along if dims == (POINT,) and name != POINT]


def _runs(start: xr.Dataset, grid: Grid) -> xr.Dataset:
    """Of the runs in a dataset, those that the runs of a sweep start from."""
    import xarray as xr

    wanted: dict[str, xr.DataArray] = {}
    for dim in map(str, start["steps"].dims):
        if dim not in grid.coordinates:
            raise ValueError(f"start has an axis {dim!r}, which this sweep has not; select one of its values first")
        along, values = grid.coordinates[dim]
        if dim == POINT:
            values = _points(start, grid)
        missing = np.setdiff1d(values, start[dim].values)
        if missing.size:
            raise ValueError(f"start has no runs with {dim} = {missing[0]:g}; it has {start[dim].values.tolist()}")
        wanted[dim] = xr.DataArray(values, dims=along)
    runs = start.sel(wanted)
    if not np.isfinite(runs["steps"].values).all():
        raise ValueError("start has runs that are not finished; finish that sweep first")
    return runs


def _points(start: xr.Dataset, grid: Grid) -> np.ndarray:
    """``[points]``: the number in a dataset of each combination of a sweep."""
    names = [name for name in swept_along_points(start) if name in grid.axes]
    if len(names) < len(swept_along_points(start)):
        raise ValueError(f"start has points of {swept_along_points(start)}, this sweep has {list(grid.axes)}")
    of_start = zip(*(start[name].values.tolist() for name in names), strict=True)
    numbers = dict(zip(of_start, start[POINT].values.tolist(), strict=True))
    wanted = list(zip(*(grid.axes[name] for name in names), strict=True))
    for combination in wanted:
        if combination not in numbers:
            setting = ", ".join(f"{name} = {value:g}" for name, value in zip(names, combination, strict=True))
            raise ValueError(f"start has no runs with {setting}")
    return np.array([numbers[combination] for combination in wanted])


def _rows(values: xr.DataArray, grid: Grid) -> np.ndarray:
    """The values of the run that each run of a sweep starts from, ``[rows, ...]``.

    Runs that differ in an axis that the values do not have start from the same one.
    """
    whole = values.expand_dims({d: n for d, n in zip(grid.dims, grid.shape, strict=True) if d not in values.dims})
    inner = [dim for dim in values.dims if dim not in grid.dims]
    array = whole.transpose(*grid.dims, *inner).values
    return array.reshape(grid.num_runs, *array.shape[len(grid.dims) :])
