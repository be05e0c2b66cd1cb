"""Results on disk: Zarr stores that xarray opens."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from hrljax import checks

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

    checks.instance("dataset", dataset, xr.Dataset, "a dataset of hrljax.sweep")
    path = checks.path("path", path)
    if path.exists() and not (path / "zarr.json").exists():
        raise FileExistsError(f"{path} exists and is no Zarr store; it is left alone")
    path.parent.mkdir(parents=True, exist_ok=True)
    workplace = Path(tempfile.mkdtemp(prefix=path.name + ".", dir=path.parent))
    partial, old = workplace / "new.partial", workplace / "old"
    try:
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

    Raises:
        TypeError: `path` is no path.
        FileNotFoundError: there is no Zarr store at `path`.
        ValueError: a chunk of a sweep's store is corrupt; the sweep computes it again.
    """
    import xarray as xr

    path = checks.path("path", path)
    if not (path / "zarr.json").exists():
        raise FileNotFoundError(f"no Zarr store at {path}")
    with xr.open_zarr(path, consolidated=False) as store:
        return store.load()
