"""Sweeps on disk that can be continued: a Zarr store that grows chunk by chunk.

A chunk holds a group of seeds of one combination of hyper-parameters. Each of its variables is one
chunk file of a Zarr array, with a label that says where it belongs (`hrljax.sweeps.chunk_file`). Only one
process writes, each file is put in its place whole, and nothing in the store depends on when, where
or in how many attempts it was computed: a sweep that was killed and continued has the bytes of one
that was not. More seeds only add files and fill up the last chunk of each combination; the file in
the root says how many there are, so that readers see all of the change or nothing of it.
"""

from __future__ import annotations

import contextlib
import errno
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hrljax.core.files import PARTIAL, make_folder, with_reason, write_atomically
from hrljax.engine.batch import Collected
from hrljax.sweeps import versions
from hrljax.sweeps.chunks import DamagedChunkError, Part, chunks_of_version
from hrljax.sweeps.descriptions import ROOT, describe_store
from hrljax.sweeps.request import SweepRequest
from hrljax.sweeps.schema import SEED
from hrljax.sweeps.store_attributes import (
    COMPLETE,
    SETTINGS,
    VERSION,
    attributes_on_disk,
    continued_attributes,
    new_attributes,
    parsed_root,
)

if TYPE_CHECKING:
    import xarray as xr


class Store:
    """The chunks of one sweep. Use it as a context: it is locked against other processes meanwhile."""

    def __init__(
        self,
        path: str | Path,
        request: SweepRequest,
        chunk_size: int,
        allow_other_versions: bool = False,
    ):
        """
        Args:
            path: the folder of the store.
            request: the sweep.
            chunk_size: seeds of a chunk.
            allow_other_versions: whether to continue a store that was computed under other versions.

        Raises:
            FileExistsError: there is something else at `path`.
            ValueError: there is a store of another sweep; the message says what differs.
        """
        self.path, self._request, self._chunk_size = Path(path), request, chunk_size
        new = new_attributes(request.identity, chunk_size)
        self._on_disk = attributes_on_disk(self.path)
        self.attributes = (
            new if self._on_disk is None else continued_attributes(self.path, self._on_disk, new, allow_other_versions)
        )
        self._settings = new[SETTINGS]
        self._begun: dict[int, Part] = {}  # by the end of the chunk, what was finished of it before
        self._versions = versions.VersionsOfRuns(request.grid.num_runs, versions.from_attributes(self.attributes))
        self._locks = contextlib.ExitStack()

    def __enter__(self) -> Store:
        """Makes the store ready to be written.

        Raises:
            OSError: it cannot be written, or another process writes it.
        """
        make_folder(self.path, "the store")
        with contextlib.ExitStack() as undone, self._explained():
            undone.callback(self._locks.close)
            self._lock()
            for partial in self.path.rglob("*" + PARTIAL):
                partial.unlink()
            kind, schema = chunks_of_version(self.attributes[VERSION]), self._request.schema(self._chunk_size)
            self._chunks = kind(self.path, schema, self._chunk_size, self._settings)
            self._write_descriptions()
            undone.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._locks.close()

    def restore(self, chunks: list[range], collected: Collected) -> list[range]:
        """Puts what is finished where it belongs. Warns of damaged files and deletes them.

        Args:
            chunks: all chunks.
            collected: where values are put.

        Returns:
            What is left to compute, in chunks that may lack their first runs.
        """
        damaged: list[str] = []
        left: list[range] = []
        for chunk in chunks:
            try:
                part = self._chunks.read(chunk)
            except DamagedChunkError as error:
                with self._explained():
                    for file, reason in error.reasons.items():
                        damaged.append(f"{self._chunks.where(file, chunk)}: {reason}")
                        file.unlink()
                left.append(chunk)
                continue
            begins = chunk.start + part.finished
            if part.finished:
                collected.put(range(chunk.start, begins), part.values)
                self._note_versions(chunk.start, part)
            if begins < chunk.stop:
                left.append(range(begins, chunk.stop))
            if chunk.start < begins < chunk.stop:
                self._begun[chunk.stop] = part
        if damaged:
            warnings.warn(
                f"{len(damaged)} files of the store {self.path} are corrupt, their chunks are computed again: "
                + "; ".join(damaged),
                RuntimeWarning,
                stacklevel=3,
            )
        if self._chunks.tell_versions:
            self._versions.keep_used()
        if left:
            self._versions.add(versions.installed())
        self.mark(complete=not left)
        return left

    def write(self, chunk: range, values: dict[str, np.ndarray]) -> None:
        """Keeps the values of a chunk, or of those of its runs that were not finished.

        Raises:
            OSError: the store cannot be written; chunks that were kept before are intact.
        """
        computed_by = [(len(chunk), versions.installed())]
        part = Part({name: values[name] for name in self._chunks.names}, computed_by)
        if chunk.stop in self._begun:
            begun = self._begun[chunk.stop]
            part, chunk = begun.extended(part), range(chunk.start - begun.finished, chunk.stop)
        with self._explained():
            for name in self._chunks.names:
                file = self._chunks.file(name, chunk)
                file.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(file, self._chunks.content(name, chunk, part))
        self._note_versions(chunk.start, part)

    def mark(self, complete: bool) -> None:
        """Says in the store's attributes whether all chunks are finished, and which versions computed them.

        Raises:
            OSError: the store cannot be written.
        """
        attributes = versions.recorded({**self.attributes, COMPLETE: int(complete)}, self._versions.sets)
        if attributes != self.attributes:
            self.attributes = attributes
            with self._explained():
                write_atomically(self.path / ROOT, self._description.files(attributes)[ROOT])

    def with_versions(self, dataset: xr.Dataset) -> xr.Dataset:
        """The sweep's dataset, with the versions that computed what is in it."""
        return self._versions.record_in(dataset)

    def _note_versions(self, first: int, part: Part) -> None:
        if self._chunks.tell_versions:
            self._versions.put(first, part.computed_by)

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
            raise BlockingIOError(errno.EAGAIN, "another process writes it") from None
        except OSError:
            return  # a file system without locks
        if attributes_on_disk(self.path) != self._on_disk:
            raise BlockingIOError(errno.EAGAIN, "another process has just written it")

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise with_reason(
                error,
                self.path,
                "the store cannot be written",
                "; its finished chunks are intact, and the same sweep continues",
            ) from error

    def _write_descriptions(self) -> None:
        """Writes all but the chunks, and mends what is not as it should be.

        The root's file comes first and says whose the folder is. Only where it is there already do the
        seeds come before it, so that it never speaks of more seeds than there are.
        """
        root = self.path / ROOT
        old = parsed_root(root.read_bytes()) if root.exists() else None
        schema, version = self._chunks.schema, self.attributes[VERSION]
        self._description = describe_store(schema, self._chunk_size, version, _seeds_of_a_file(old))
        contents = self._description.files(self.attributes)
        before_root = [name for name in contents if name.startswith(f"{SEED}/c/") and old is not None]
        for name in dict.fromkeys([*before_root, *contents]):
            file = self.path / name
            if not file.exists() or file.read_bytes() != contents[name]:
                file.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(file, contents[name])


def _seeds_of_a_file(root: versions.Attributes | None) -> int | None:
    """How many seeds a file of their coordinate holds in the store with this root."""
    try:
        seed = (root or {})["consolidated_metadata"]["metadata"][SEED]
        return int(seed["chunk_grid"]["configuration"]["chunk_shape"][0])
    except (KeyError, TypeError, IndexError, ValueError):
        return None
