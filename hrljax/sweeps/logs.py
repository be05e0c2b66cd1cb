"""Logs of a sweep while it runs: finished runs as datasets, as lines of a CSV file, and for TensorBoard."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from hrljax.core import checks
from hrljax.sweeps.job import EPISODE
from hrljax.sweeps.schema import SEED, Schema, describe

if TYPE_CHECKING:
    import xarray as xr

RUN = "run"
"""The dimension of finished runs."""
Callback: TypeAlias = "Callable[[xr.Dataset], object]"
"""What is told of runs as soon as they are finished; see `hrljax.sweep`."""


def finished_runs(schema: Schema, runs: np.ndarray, values: Mapping[str, np.ndarray]) -> xr.Dataset:
    """Some runs of a sweep as a dataset, with a dimension ``run``.

    Args:
        schema: names and places of the sweep's values.
        runs: ``[runs]`` their numbers.
        values: by name, ``[runs, ...]``.
    """
    import xarray as xr

    grid = schema.grid
    settings = [grid.setting(run) for run in runs.tolist()]
    variables = {
        name: xr.Variable((RUN, *variable.dims), np.array(values[name], variable.dtype), variable.attributes)
        for name, variable in schema.variables.items()
    }
    coordinates = {name: (RUN, [setting[name] for setting in settings]) for name in grid.axes}
    of_run = {name: (name, along, describe(name)) for name, along in schema.coordinates_of_run.items()}
    return xr.Dataset(variables, {**coordinates, SEED: (RUN, runs % grid.seeds), **of_run})


class CSVLog:
    """Writes every finished run of a sweep to a CSV file, for `callback` of `hrljax.sweep`.

    A line a bin of a run: hyper-parameters that are swept, ``seed``, ``episode`` (the last of the bin), and the
    variables over episodes. The file is new with every sweep, and holds whole runs at any time.
    """

    def __init__(self, path: str | Path):
        """
        Args:
            path: the file; one that is there is replaced.

        Raises:
            TypeError: `path` is no path.
        """
        self.path = checks.path("path", path)
        self._has_header = False

    def __call__(self, runs: xr.Dataset) -> None:
        """Writes finished runs.

        Raises:
            OSError: the file cannot be written.
        """
        names = _over_episodes(runs)
        settings = [*_swept(runs), SEED]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a" if self._has_header else "w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            if not self._has_header:
                writer.writerow([*settings, EPISODE, *names])
            for run in range(runs.sizes[RUN]):
                setting = [runs[name].values[run].item() for name in settings]
                bins = zip(*(runs[name].values[run].tolist() for name in names), strict=True)
                for episode, of_bin in zip(runs[EPISODE].values.tolist(), bins, strict=True):
                    writer.writerow([*setting, episode, *of_bin])
        self._has_header = True


class TensorBoardLog:
    """Writes every finished run of a sweep for TensorBoard, for `callback` of `hrljax.sweep`.

    A folder a run, such as ``step_size=0.1,seed=3``; a scalar a variable over episodes, against the last episode of
    each bin. Needs the package tensorboardX (``pip install 'hrljax[tensorboard]'``).
    """

    def __init__(self, folder: str | Path):
        """
        Args:
            folder: where folders of runs are made; it must not hold anything, for TensorBoard would mix both.

        Raises:
            TypeError: `folder` is no path.
            FileExistsError: it is a file, or not empty.
            ModuleNotFoundError: tensorboardX is not installed.
        """
        import tensorboardX

        self.folder = checks.path("folder", folder)
        if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            raise FileExistsError(
                f"{self.folder} exists and is no empty folder; TensorBoard would mix its runs with these"
            )
        self._writer = tensorboardX.SummaryWriter

    def __call__(self, runs: xr.Dataset) -> None:
        """Writes finished runs.

        Raises:
            OSError: the folder cannot be written.
        """
        for run in range(runs.sizes[RUN]):
            setting = [f"{name}={runs[name].values[run].item():g}" for name in (*_swept(runs), SEED)]
            with self._writer(logdir=str(self.folder / ",".join(setting))) as writer:
                for name in _over_episodes(runs):
                    curve = zip(runs[EPISODE].values.tolist(), runs[name].values[run].tolist(), strict=True)
                    for episode, value in curve:
                        if np.isfinite(value):
                            writer.add_scalar(name, value, episode)


def _over_episodes(runs: xr.Dataset) -> list[str]:
    return [str(name) for name, values in runs.data_vars.items() if values.dims == (RUN, EPISODE)]


def _swept(runs: xr.Dataset) -> list[str]:
    return [str(name) for name, values in runs.coords.items() if values.dims == (RUN,) and name != SEED]
