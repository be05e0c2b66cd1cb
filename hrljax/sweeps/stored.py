"""A sweep's store as a dataset, without the sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hrljax.engine.batch import Collected
from hrljax.sweeps.chunks import Chunks, DamagedChunkError, chunks_of_version
from hrljax.sweeps.descriptions import FIRST_VERSION, NEWEST_VERSION, ROOT
from hrljax.sweeps.schema import Grid, Schema, Variable, dataset
from hrljax.sweeps.store_attributes import CHUNK_SIZE, COMPLETE, SETTINGS, VERSION
from hrljax.sweeps.versions import Attributes, VersionsOfRuns, from_attributes

if TYPE_CHECKING:
    import xarray as xr

MENDED = "the same hrljax.sweep(..., store=...) mends it"
_SAID = 5
"""Damaged files that an error names, at most."""


def load_store(path: Path, root: Attributes) -> xr.Dataset:
    """Loads what ``hrljax.sweep(store=...)`` wrote; it is complete if every run is there.

    Args:
        path: the folder of the store.
        root: what the file in it says.

    Raises:
        ValueError: a file is damaged; the message names it, its combination and its seeds.
    """
    attributes = dict(root["attributes"])
    version = attributes.get(VERSION)
    if version not in (FIRST_VERSION, NEWEST_VERSION):
        raise ValueError(f"the store {path} has version {version} of the format, known are 1 and 2")
    try:
        schema = _schema(path, attributes, root["consolidated_metadata"]["metadata"])
        chunk_size, settings = attributes[CHUNK_SIZE], attributes.get(SETTINGS, "")
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"the store {path} is damaged: {ROOT} ({error!r}); {MENDED}") from error
    chunks = chunks_of_version(version)(path, schema, chunk_size, settings)
    collected = Collected(schema.grid.num_runs)
    collected.values = {n: np.zeros((schema.grid.num_runs, *v.shape), v.dtype) for n, v in schema.variables.items()}
    versions = VersionsOfRuns(schema.grid.num_runs, from_attributes(attributes))
    _collect(chunks, collected, versions)
    if chunks.tell_versions and collected.finished.any():
        versions.keep_used()
    attributes[COMPLETE] = int(collected.finished.all())
    return versions.record_in(dataset(schema, collected.values, collected.finished, attributes))


def _collect(chunks: Chunks, collected: Collected, versions: VersionsOfRuns) -> None:
    damaged: list[str] = []
    for chunk in chunks.all():
        try:
            part = chunks.read(chunk)
        except DamagedChunkError as error:
            damaged += [f"{chunks.where(file, chunk)}: {reason}" for file, reason in error.reasons.items()]
            continue
        if part.finished:
            collected.put(range(chunk.start, chunk.start + part.finished), part.values)
            if chunks.tell_versions:
                versions.put(chunk.start, part.computed_by)
    if damaged:
        others = f" and {len(damaged) - _SAID} more" if len(damaged) > _SAID else ""
        raise ValueError(f"the store {chunks.path} is damaged: {'; '.join(damaged[:_SAID])}{others}; {MENDED}")


def _schema(path: Path, attributes: Attributes, members: Attributes) -> Schema:
    """Names and places of the store's values; all but coordinates of a run are in the root's file."""
    grid = Grid.of(attributes)
    coordinates: dict[str, np.ndarray] = {}
    variables: dict[str, Variable] = {}
    of_runs = list(grid.dims)
    for name, member in members.items():
        dims, shape, dtype = member["dimension_names"], member["shape"], np.dtype(member["data_type"])
        if dims[: len(of_runs)] == of_runs and name not in grid.coordinates:
            start = len(of_runs)
            variables[name] = Variable(tuple(dims[start:]), tuple(shape[start:]), dtype, member["attributes"])
        elif name not in grid.coordinates:
            coordinates[name] = _coordinate(path, name)
    return Schema(grid, coordinates, variables)


def _coordinate(path: Path, name: str) -> np.ndarray:
    import zarr

    file = path / name / "c" / "0"
    try:
        if not file.exists():
            raise FileNotFoundError("it is not there")
        array: Any = zarr.open_group(str(path), mode="r", use_consolidated=True)[name]
        return np.asarray(array[...])
    except Exception as error:  # whatever Zarr makes of wrong bytes
        raise ValueError(f"the store {path} is damaged: {name}/c/0 ({error}); {MENDED}") from error
