"""Names and places of a sweep's values: dimensions, coordinates and the order of runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np

from hrljax.sweeps.axes import Axes
from hrljax.sweeps.job import EPISODE, RunValues
from hrljax.sweeps.versions import Attributes

if TYPE_CHECKING:
    import xarray as xr

SEED = "seed"
"""The last dimension of runs."""
_DESCRIPTIONS = {
    "return": {"long_name": "return per episode"},
    "length": {"long_name": "steps per episode", "units": "steps"},
    EPISODE: {"long_name": "last episode of the bin", "units": "episodes"},
}


class Variable(NamedTuple):
    """One of the values of each run."""

    dims: tuple[str, ...]  # of one run
    shape: tuple[int, ...]  # of one run
    dtype: np.dtype[np.generic]  # with a value for unfinished runs
    attributes: dict[str, str]

    @property
    def unfinished(self) -> np.generic:
        """The value where a run is not finished."""
        return self.dtype.type(np.nan if self.dtype.kind == "f" else 0)


class Grid(NamedTuple):
    """The runs of a sweep, in the order of the axes, the first slowest, and then of the seeds."""

    axes: Axes
    seeds: int

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of runs."""
        return (*self.axes, SEED)

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of runs."""
        return (*map(len, self.axes.values()), self.seeds)

    @property
    def num_runs(self) -> int:
        """All runs."""
        return int(np.prod(self.shape))

    @property
    def coordinates(self) -> dict[str, np.ndarray]:
        """Of every dimension of runs."""
        axes = {name: np.array(values, np.float64) for name, values in self.axes.items()}
        return {**axes, SEED: np.arange(self.seeds)}


class Schema(NamedTuple):
    """What a sweep's dataset and store hold of every run."""

    grid: Grid
    coordinates_of_run: dict[str, np.ndarray]
    variables: dict[str, Variable]

    @property
    def coordinates(self) -> dict[str, np.ndarray]:
        """Of runs, and of what each of them holds."""
        return {**self.grid.coordinates, **self.coordinates_of_run}


def variables_of(run: RunValues[jax.ShapeDtypeStruct]) -> dict[str, Variable]:
    """The variables of a sweep, of the shapes of what one run gives.

    What is measured is float64, where NaN stands for unfinished runs; learned tables keep their dtypes.
    """

    leaves = ((place, run.by_name[place.name]) for place in run.places)
    return {
        name: Variable(dims, leaf.shape[: len(dims)], np.dtype(leaf.dtype if is_table else np.float64), describe(name))
        for (name, dims, is_table), leaf in leaves
    }


def describe(name: str) -> dict[str, str]:
    """Attributes of a variable or a coordinate: its description and its unit."""
    return dict(_DESCRIPTIONS.get(name, {}))


def dataset(
    schema: Schema, values: Mapping[str, np.ndarray], finished: np.ndarray, attributes: Attributes
) -> xr.Dataset:
    """The labelled values of all runs.

    Args:
        schema: their names and places.
        values: by name, ``[runs, ...]``.
        finished: ``[runs]`` bool: whether the values of a run count.
        attributes: of the dataset.
    """
    import xarray as xr  # here, because importing it takes longer than the rest of hrljax

    grid = schema.grid
    variables = {}
    for name, variable in schema.variables.items():
        array = np.array(values[name], variable.dtype)
        array[~finished] = variable.unfinished
        dims, shape = (*grid.dims, *variable.dims), (*grid.shape, *variable.shape)
        variables[name] = xr.Variable(dims, array.reshape(shape), variable.attributes)
    coordinates = {name: xr.Variable((name,), along, describe(name)) for name, along in schema.coordinates.items()}
    return xr.Dataset(variables, coordinates, attributes)
