"""Sweeps on disk that can be continued: a Zarr store that grows chunk by chunk.

A chunk holds a group of seeds of one combination of hyper-parameters. Each of its variables is one
chunk file of a Zarr array, with a checksum that every Zarr reader verifies. Only one process writes,
each file is put in its place whole, and nothing in the store depends on when, where or in how many
attempts it was computed: a sweep that was killed and continued has the bytes of one that was not.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hrljax.files import PARTIAL, write_atomically
from hrljax.identity import differences
from hrljax.labels import Labels, describe

_FORMAT = {"store_format": "hrljax sweep", "store_version": 1}
_IGNORED = ("version.numpy", "version.xarray", "complete")
"""Attributes that may differ when a sweep is continued."""
_SEEDS_OF_A_CHUNK = "chunk_size"
_DESCRIPTION = "zarr.json"


class Store:
    """The chunks of one sweep. Use it as a context: it is locked against other processes meanwhile."""

    def __init__(self, path: str | Path, labels: Labels, attributes: dict[str, Any], chunk_size: int):
        """
        Args:
            path: the folder of the store.
            labels: names and places of the sweep's values.
            attributes: every setting that values depend on.
            chunk_size: seeds of a chunk.

        Raises:
            FileExistsError: there is something else at `path`.
            ValueError: there is a store of another sweep; the message says what differs.
        """
        self.path, self.labels, self.chunk_size = Path(path), labels, chunk_size
        self.attributes = {**_FORMAT, **attributes, _SEEDS_OF_A_CHUNK: chunk_size, "complete": 0}
        self._locks = contextlib.ExitStack()
        self._memory: dict[str, Any] = {}
        self._arrays: dict[str, Any] = {}
        found = attributes_on_disk(self.path)
        if found is None:
            return
        wrong = differences(found, json.loads(json.dumps(self.attributes)), _IGNORED)
        if wrong:
            raise ValueError(f"the store {self.path} belongs to another sweep: {'; '.join(wrong)}")
        self.attributes = found

    def __enter__(self) -> Store:
        """Makes the store ready to be written.

        Raises:
            OSError: it cannot be written, or another process writes it.
        """
        with self._explained():
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock()
            for partial in self.path.rglob("*" + PARTIAL):
                partial.unlink()
            self._write_descriptions()
        return self

    def __exit__(self, *_: object) -> None:
        self._locks.close()

    def read(self, chunks: list[range]) -> Iterator[tuple[range, dict[str, np.ndarray]]]:
        """The chunks that are finished, and their values. Warns of corrupt ones and deletes them."""
        import zarr

        group = zarr.open_group(str(self.path), mode="r")
        arrays: dict[str, Any] = {name: group[name] for name in self.labels.variables}
        corrupt: list[str] = []
        for chunk in chunks:
            if not all(self._file(name, chunk).exists() for name in arrays):
                continue
            values: dict[str, np.ndarray] = {}
            for name, array in arrays.items():
                try:
                    own = np.asarray(array[self._selection(chunk)])
                except OSError:
                    raise
                except Exception as error:  # whatever a reader makes of wrong bytes
                    corrupt.append(f"{self._file(name, chunk).relative_to(self.path)} ({error})")
                    self._file(name, chunk).unlink()
                else:
                    values[name] = own.reshape(len(chunk), *own.shape[len(self.labels.dims) :])
            if len(values) == len(arrays):
                yield chunk, values
        if corrupt:
            warnings.warn(
                f"{len(corrupt)} files of the store {self.path} are corrupt, their chunks are computed again: "
                + ", ".join(corrupt),
                RuntimeWarning,
                stacklevel=2,
            )

    def write(self, chunk: range, values: dict[str, np.ndarray]) -> None:
        """Keeps the values of a chunk.

        Raises:
            OSError: the store cannot be written; chunks that were kept before are intact.
        """
        with self._explained():
            for name in self.labels.variables:
                file = self._file(name, chunk)
                file.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(file, self._encoded(name, chunk, values[name]))

    def mark(self, complete: bool) -> None:
        """Says in the store's attributes whether all chunks are finished.

        Raises:
            OSError: the store cannot be written.
        """
        if bool(self.attributes["complete"]) != complete:
            self.attributes = {**self.attributes, "complete": int(complete)}
            with self._explained():
                write_atomically(self.path / _DESCRIPTION, self._settings())

    def _lock(self) -> None:
        try:
            import fcntl
        except ImportError:  # no such locks on Windows
            return
        descriptor = os.open(self.path, os.O_RDONLY)
        self._locks.callback(os.close, descriptor)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._locks.close()
            raise BlockingIOError(errno.EAGAIN, "another process writes it") from None
        except OSError:
            return  # a file system without locks

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            what = error.strerror or str(error)
            raise type(error)(
                error.errno or 0,
                f"the store cannot be written ({what}); its finished chunks are intact, and the same sweep continues",
                str(self.path),
            ) from error

    def _file(self, name: str, chunk: range) -> Path:
        *point, seed = np.unravel_index(chunk.start, self.labels.shape)
        dims = len(self.labels.variables[name].dims)
        return self.path.joinpath(name, "c", *map(str, (*point, seed // self.chunk_size, *[0] * dims)))

    def _selection(self, chunk: range) -> tuple[Any, ...]:
        *point, seed = (int(i) for i in np.unravel_index(chunk.start, self.labels.shape))
        return (*(slice(i, i + 1) for i in point), slice(seed, seed + len(chunk)))

    def _write_descriptions(self) -> None:
        """Writes all but the chunks, the settings first, and mends what is not as it should be."""
        self._describe()
        described = {name: content.to_bytes() for name, content in self._memory.items() if name != _DESCRIPTION}
        for name, content in {_DESCRIPTION: self._settings(), **described}.items():
            file = self.path / name
            if not file.exists() or file.read_bytes() != content:
                file.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(file, content)

    def _describe(self) -> None:
        """Makes the store without its chunks, in memory."""
        import zarr
        from zarr.storage import MemoryStore

        self._memory.clear()
        labels, store = self.labels, MemoryStore(store_dict=self._memory)
        group = zarr.create_group(store=store)
        for name, variable in labels.variables.items():
            dims = (*labels.dims, *variable.dims)
            shape = (*labels.shape, *variable.shape)
            chunks = (*[1] * len(labels.columns), self.chunk_size, *variable.shape)
            self._arrays[name] = _array(group, name, shape, chunks, dims, variable.unfinished, variable.attributes)
        for name, values in labels.coordinates.items():
            nothing = values.dtype.type(0)
            _array(group, name, values.shape, values.shape, (name,), nothing, describe(name))[...] = values
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
            zarr.consolidate_metadata(store)  # xarray looks for it and warns if it is not there

    def _settings(self) -> bytes:
        """The description of the store as a whole."""
        description = json.loads(self._memory[_DESCRIPTION].to_bytes())
        members = description["consolidated_metadata"]["metadata"]  # some Zarrs list them as they happen to come
        description["consolidated_metadata"]["metadata"] = dict(sorted(members.items()))
        return json.dumps({**description, "attributes": self.attributes}, indent=2).encode()

    def _encoded(self, name: str, chunk: range, values: np.ndarray) -> bytes:
        """The content of a chunk file, as Zarr makes it in memory."""
        array = self._arrays[name]
        array[self._selection(chunk)] = values.reshape(*[1] * len(self.labels.columns), *values.shape).astype(
            array.dtype
        )
        return self._memory.pop(self._file(name, chunk).relative_to(self.path).as_posix()).to_bytes()


def _array(
    group: Any,
    name: str,
    shape: tuple[int, ...],
    chunks: tuple[int, ...],
    dims: tuple[str, ...],
    fill_value: Any,
    attributes: dict[str, str],
) -> Any:
    """A new Zarr array; all that decides on its bytes is said here, whatever Zarr's defaults are."""
    from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec

    return group.create_array(
        name,
        shape=shape,
        chunks=chunks,
        dtype=fill_value.dtype,
        fill_value=fill_value,
        filters=None,
        serializer=BytesCodec(endian="little"),
        compressors=[ZstdCodec(level=3), Crc32cCodec()],
        chunk_key_encoding={"name": "default", "separator": "/"},
        dimension_names=dims,
        attributes=attributes,
        config={"write_empty_chunks": True},
    )


def attributes_on_disk(path: Path) -> dict[str, Any] | None:
    """The attributes of a store, None if nothing is there yet.

    Raises:
        FileExistsError: there is something else, which is left alone.
    """
    if not path.exists() or (path.is_dir() and all(entry.name.endswith(PARTIAL) for entry in path.iterdir())):
        return None
    try:
        attributes = json.loads((path / _DESCRIPTION).read_bytes())["attributes"]
    except (OSError, ValueError, KeyError):
        attributes = {}
    if attributes.get("store_format") != _FORMAT["store_format"]:
        raise FileExistsError(f"{path} exists and was not written by hrljax.sweep(store=...); it is left alone")
    return attributes
