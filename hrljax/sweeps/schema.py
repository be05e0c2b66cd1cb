"""Names and places of a sweep's values: dimensions, coordinates and the order of runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

_DESCRIPTIONS = {
    "return": {"long_name": "return per episode"},
    "length": {"long_name": "steps per episode", "units": "steps"},
    "episode": {"long_name": "last episode of the bin", "units": "episodes"},
}


class Variable(NamedTuple):
    """One of the values of each run."""

    dims: tuple[str, ...]  # of one run
    shape: tuple[int, ...]  # of one run
    dtype: np.dtype[Any]  # with a value for unfinished runs
    attributes: dict[str, str]

    @property
    def unfinished(self) -> Any:
        """The value where a run is not finished."""
        return self.dtype.type(np.nan if self.dtype.kind == "f" else 0)


class Labels(NamedTuple):
    """Runs lie in the order of the axes, the first slowest, and then of the seeds."""

    columns: dict[str, list[float]]  # values along each axis
    seeds: int
    coordinates_of_run: dict[str, np.ndarray]
    variables: dict[str, Variable]

    def after(self, episodes: int) -> Labels:
        """The same of runs that have learned from some episodes before: every coordinate of a run counts episodes."""
        return self._replace(coordinates_of_run={n: ends + episodes for n, ends in self.coordinates_of_run.items()})

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of runs."""
        return (*self.columns, "seed")

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of runs."""
        return (*map(len, self.columns.values()), self.seeds)

    @property
    def num_rows(self) -> int:
        """All runs."""
        return int(np.prod(self.shape))

    @property
    def coordinates(self) -> dict[str, np.ndarray]:
        axes = {name: np.array(values, np.float64) for name, values in self.columns.items()}
        return {**axes, "seed": np.arange(self.seeds), **self.coordinates_of_run}


def describe(name: str) -> dict[str, str]:
    """Attributes of a variable or a coordinate: its description and its unit."""
    return dict(_DESCRIPTIONS.get(name, {}))


def dataset(labels: Labels, values: dict[str, np.ndarray], finished: np.ndarray, attributes: Any) -> xr.Dataset:
    """The labelled values of all runs.

    Args:
        labels: their names and places.
        values: by name, ``[rows, ...]``.
        finished: ``[rows]`` bool: whether the values of a run count.
        attributes: of the dataset.
    """
    import xarray as xr  # here, because importing it takes longer than the rest of hrljax

    found = {}
    for name, variable in labels.variables.items():
        own = np.array(values[name], variable.dtype)
        own[~finished] = variable.unfinished
        found[name] = xr.Variable(
            (*labels.dims, *variable.dims), own.reshape(*labels.shape, *variable.shape), variable.attributes
        )
    coordinates = {name: xr.Variable((name,), own, describe(name)) for name, own in labels.coordinates.items()}
    return xr.Dataset(found, coordinates, attributes)
