"""Results on disk: Zarr stores that xarray opens."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hrljax.core import checks
from hrljax.sweeps.descriptions import ROOT
from hrljax.sweeps.store_attributes import FORMAT, has_lost_its_root, is_of_a_sweep, parsed_root
from hrljax.sweeps.stored import MENDED, load_store

if TYPE_CHECKING:
    import xarray as xr


def save(dataset: xr.Dataset, path: str | Path) -> None:
    """Saves a dataset of `hrljax.sweep` as a Zarr store, replacing one that is there.

    The store is written beside its place first: a store that can be seen is whole.

    Raises:
        TypeError: an argument is of the wrong kind.
        OSError: `path` cannot be written, or is something other than a Zarr store.
    """
    import xarray as xr
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    checks.instance("dataset", dataset, xr.Dataset, "a dataset of hrljax.sweep")
    path = checks.path("path", path)
    if path.exists() and not (path / ROOT).exists():
        raise FileExistsError(f"{path} exists and is no Zarr store; it is left alone")
    path.parent.mkdir(parents=True, exist_ok=True)
    workplace = Path(tempfile.mkdtemp(prefix=path.name + ".", dir=path.parent))
    partial, old = workplace / "new.partial", workplace / "old"
    dataset = dataset.copy()
    dataset.attrs = {name: value for name, value in dataset.attrs.items() if name not in FORMAT}  # of what was loaded
    for variable in dataset.variables.values():
        variable.encoding = {"compressors": [ZstdCodec(level=3), Crc32cCodec()]}
    try:
        with zarr.config.set({"array.write_empty_chunks": True}):  # so that a file that is not there is lost
            dataset.to_zarr(partial, mode="w", consolidated=False)
        if path.exists():
            path.rename(old)
        try:
            partial.rename(path)
        except OSError:
            if old.exists():
                old.rename(path)
            raise
    finally:
        shutil.rmtree(workplace, ignore_errors=True)


def load(path: str | Path) -> xr.Dataset:
    """Loads a dataset that `save` or ``hrljax.sweep(store=...)`` wrote, into memory; unfinished runs are NaN.

    Of a sweep's store, every chunk is checked: that it is as it was written, and in its place.
    ``complete`` is 1 if every run is there, whatever the store says.

    Raises:
        TypeError: `path` is no path.
        FileNotFoundError: there is no Zarr store at `path`, or its ``zarr.json`` is lost.
        ValueError: a file is damaged. The message names it and, of a sweep's store, the combination
            of hyper-parameters and the seeds; the same sweep mends it.
    """
    path = checks.path("path", path)
    try:
        root = parsed_root((path / ROOT).read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        lost = f"; its {ROOT} is lost: {MENDED}" if has_lost_its_root(path) else ""
        raise FileNotFoundError(f"no Zarr store at {path}{lost}") from None
    if root is None:
        raise ValueError(f"the store {path} is damaged: {ROOT}; if it is a sweep's, {MENDED}")
    return load_store(path, root) if is_of_a_sweep(root) else _load_saved(path)


def _load_saved(path: Path) -> xr.Dataset:
    import xarray as xr

    damaged = _damaged_files(path)
    if damaged:
        raise ValueError(f"the store {path} is damaged: {'; '.join(damaged)}")
    with xr.open_zarr(path, consolidated=False) as store:
        return store.load()


def _damaged_files(path: Path) -> list[str]:
    """Files of a store of `save` that cannot be read, or that are not there though every chunk has one."""
    import zarr

    damaged: list[str] = []
    for folder in sorted(entry for entry in path.iterdir() if entry.is_dir()):
        try:
            array: Any = zarr.open_array(str(folder), mode="r")
        except Exception as error:  # whatever Zarr makes of wrong bytes
            damaged.append(f"{folder.name}/{ROOT} ({error})")
            continue
        has_every_chunk = any(codec.to_dict()["name"] == "crc32c" for codec in array.compressors)
        for index in np.ndindex(array.cdata_shape):
            file = folder.joinpath("c", *map(str, index))
            try:
                array.blocks[index]
                if has_every_chunk and not file.exists():
                    raise FileNotFoundError("it is not there")
            except Exception as error:
                damaged.append(f"{file.relative_to(path).as_posix()} ({error})")
    return damaged
