"""Names and places of a sweep's values: dimensions, coordinates and the order of runs."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np

from hrljax.sweeps.axes import POINT, Axes, of_env
from hrljax.sweeps.job import EPISODE, RunValues
from hrljax.sweeps.versions import Attributes

if TYPE_CHECKING:
    import xarray as xr

SEED = "seed"
"""The last dimension of runs."""
_AXES_ARE, _POINTS = "axes_are", "points"
_COORDINATES = "coordinates"
"""Attribute of a store by which xarray tells coordinates that are no dimensions from variables (CF conventions, 5)."""
_DESCRIPTIONS = {
    "return": {"long_name": "return per episode"},
    "discounted_return": {"long_name": "discounted return per episode"},
    "average_reward": {"long_name": "reward per step"},
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


class Coordinate(NamedTuple):
    """What stands along a dimension."""

    dim: str
    values: np.ndarray


class Grid(NamedTuple):
    """The runs of a sweep, in the order of the axes, the first slowest, and then of the seeds.

    Of points, the values of all axes belong together: they are values along one dimension.
    """

    axes: Axes
    seeds: int
    is_of_points: bool = False

    @classmethod
    def of(cls, attributes: Attributes) -> Grid:
        """The grid of a store with these attributes."""
        return cls(json.loads(attributes["axes"]), attributes["seeds"], attributes.get(_AXES_ARE) == _POINTS)

    @property
    def attributes(self) -> Attributes:
        """What a store says of it."""
        kind = {_AXES_ARE: _POINTS, _COORDINATES: " ".join(self.axes)} if self.is_of_points else {}
        return {"seeds": self.seeds, "axes": json.dumps(self.axes), **kind}

    @property
    def combinations(self) -> list[tuple[float, ...]]:
        """The value of each hyper-parameter, of all combinations."""
        values = self.axes.values()
        return list(zip(*values, strict=True) if self.is_of_points else itertools.product(*values))

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of runs."""
        return (POINT, SEED) if self.is_of_points else (*self.axes, SEED)

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of runs."""
        lengths = [len(values) for values in self.axes.values()]
        return (*(lengths[:1] if self.is_of_points else lengths), self.seeds)

    @property
    def num_runs(self) -> int:
        """All runs."""
        return int(np.prod(self.shape))

    @property
    def coordinates(self) -> dict[str, Coordinate]:
        """Of every dimension of runs."""
        dims = (POINT,) * len(self.axes) if self.is_of_points else self.axes
        axes = zip(dims, self.axes.items(), strict=True)
        coordinates = {name: Coordinate(dim, np.array(values, np.float64)) for dim, (name, values) in axes}
        if self.is_of_points:
            coordinates[POINT] = Coordinate(POINT, np.arange(self.shape[0]))
        return {**coordinates, SEED: Coordinate(SEED, np.arange(self.seeds))}

    def setting(self, run: int) -> dict[str, float]:
        """The values of the hyper-parameters of a run."""
        return dict(zip(self.axes, self.combinations[run // self.seeds], strict=True))

    def settings_of_env(self) -> list[dict[str, float]]:
        """The different values of the environment's numbers, by their names; one without any if none is swept."""
        settings = (of_env(dict(zip(self.axes, values, strict=True))) for values in self.combinations)
        return [dict(setting) for setting in dict.fromkeys(tuple(setting.items()) for setting in settings)]


class Schema(NamedTuple):
    """What a sweep's dataset and store hold of every run."""

    grid: Grid
    coordinates_of_run: dict[str, np.ndarray]
    variables: dict[str, Variable]

    @property
    def coordinates(self) -> dict[str, Coordinate]:
        """Of runs, and of what each of them holds."""
        of_run = {name: Coordinate(name, values) for name, values in self.coordinates_of_run.items()}
        return {**self.grid.coordinates, **of_run}


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
    along = schema.coordinates.items()
    coordinates = {name: xr.Variable((dim,), values, describe(name)) for name, (dim, values) in along}
    return xr.Dataset(variables, coordinates, {k: v for k, v in attributes.items() if k != _COORDINATES})
