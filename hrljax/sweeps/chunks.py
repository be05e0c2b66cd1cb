"""The chunks of a sweep's store: where their files lie, what they hold, and whether that is what belongs there."""

import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hrljax.engine import batch
from hrljax.sweeps import chunk_file
from hrljax.sweeps.descriptions import FIRST_VERSION, describe_store
from hrljax.sweeps.job import STEPS
from hrljax.sweeps.schema import Schema
from hrljax.sweeps.versions import ComputedBy, Versions


class DamagedChunkError(ValueError):
    """Some files of a chunk do not hold what was written there."""

    def __init__(self, reasons: dict[Path, str]):
        """
        Args:
            reasons: what is wrong, by the file.
        """
        super().__init__(str(reasons))
        self.reasons = reasons


class Part(NamedTuple):
    """What is finished of a chunk: its first seeds."""

    values: dict[str, np.ndarray]  # by name, [finished seeds, ...]
    computed_by: ComputedBy  # without versions where files do not tell them

    @property
    def finished(self) -> int:
        """Finished seeds."""
        return sum(count for count, _ in self.computed_by)

    def extended(self, following: "Part") -> "Part":
        """With the seeds that follow."""
        values = {name: np.concatenate([first, following.values[name]]) for name, first in self.values.items()}
        return Part(values, _grouped(_per_seed(self.computed_by) + _per_seed(following.computed_by)))


class Chunks:
    """Chunks whose files are labelled (`hrljax.sweeps.chunk_file`)."""

    tell_versions = True
    """Whether the files say which versions computed them."""

    def __init__(self, path: Path, schema: Schema, chunk_size: int, settings: str):
        """
        Args:
            path: the folder of the store.
            schema: names and places of the sweep's values.
            chunk_size: most seeds of a chunk.
            settings: digest of the sweep's settings.
        """
        self.path, self.schema, self.chunk_size, self.settings = path, schema, chunk_size, settings
        self.names = sorted(schema.variables, key=lambda name: name == STEPS)
        """In the order in which files are written. Those of the first version are finished when their steps are."""

    def all(self) -> list[range]:
        """The runs of every chunk."""
        return batch.chunks_of(self.schema.grid.num_runs, self.chunk_size, within=self.schema.grid.seeds)

    def file(self, name: str, chunk: range) -> Path:
        """Where a variable of a chunk is."""
        *point, seed = np.unravel_index(chunk.start, self.schema.grid.shape)
        dims = len(self.schema.variables[name].dims)
        return self.path.joinpath(name, "c", *map(str, (*point, seed // self.chunk_size, *[0] * dims)))

    def where(self, file: Path, chunk: range) -> str:
        """A file of the store and the runs whose values it holds, as text."""
        seed = chunk.start % self.schema.grid.seeds
        combination = [f"{name}={value}" for name, value in self.schema.grid.setting(chunk.start).items()]
        seeds = f"seeds {seed} to {seed + len(chunk) - 1}"
        return f"{file.relative_to(self.path).as_posix()} ({', '.join([*combination, seeds])})"

    def read(self, chunk: range) -> Part:
        """What is finished of a chunk.

        Raises:
            DamagedChunkError: files that are there do not hold what was written there.
            OSError: they cannot be read.
        """
        values: dict[str, np.ndarray] = {}
        computed_by: list[list[Versions]] = []
        reasons: dict[Path, str] = {}
        for name in self.names:
            file = self.file(name, chunk)
            try:
                values[name], versions = self._decoded(name, chunk, file.read_bytes())
                computed_by.append(_per_seed(versions))
            except FileNotFoundError:
                computed_by.append([])
            except ValueError as error:
                reasons[file] = str(error)
        if reasons:
            raise DamagedChunkError(reasons)
        same = itertools.takewhile(lambda seed: all(v == seed[0] for v in seed), zip(*computed_by, strict=False))
        agreed = [versions[0] for versions in same][: len(chunk)]
        return Part({name: whole[: len(agreed)] for name, whole in values.items()}, _grouped(agreed))

    def content(self, name: str, chunk: range, part: Part) -> bytes:
        """The file of a variable of a chunk of which a part is finished."""
        variable, finished = self.schema.variables[name], part.values[name]
        whole = np.full((self.chunk_size, *variable.shape), variable.unfinished)
        whole[: len(finished)] = finished
        return chunk_file.encode(whole, self._label(name, chunk, part.computed_by))

    def _label(self, name: str, chunk: range, computed_by: ComputedBy) -> chunk_file.Label:
        file = self.file(name, chunk).relative_to(self.path).as_posix()
        return chunk_file.Label(self.settings, file, self.chunk_size, chunk.start % self.schema.grid.seeds, computed_by)

    def _decoded(self, name: str, chunk: range, content: bytes) -> tuple[np.ndarray, ComputedBy]:
        """``[chunk_size, ...]`` values of a chunk file, and the versions that computed its finished seeds.

        Raises:
            ValueError: the file does not hold what was written there.
        """
        label = chunk_file.label_of(content)
        expected = self._label(name, chunk, label.computed_by)
        if (label.settings, label.chunk_size) != (expected.settings, expected.chunk_size):
            raise ValueError("it belongs to another store")
        if label != expected:
            raise ValueError(f"it belongs to {label.file}")
        variable = self.schema.variables[name]
        return chunk_file.decode(content, variable.dtype, (self.chunk_size, *variable.shape)), label.computed_by


class ChunksOfFirstVersion(Chunks):
    """Chunks as version 1 of the format has them: without labels, encoded by Zarr."""

    tell_versions = False

    def __init__(self, path: Path, schema: Schema, chunk_size: int, settings: str):
        super().__init__(path, schema, chunk_size, settings)
        self._description = describe_store(schema, chunk_size, FIRST_VERSION)

    def content(self, name: str, chunk: range, part: Part) -> bytes:
        array = self._description.arrays[name]
        values = part.values[name]
        array[self._selection(chunk)] = values.reshape(*[1] * len(self.schema.grid.axes), *values.shape).astype(
            array.dtype
        )
        return self._description.content.pop(self._key(name, chunk)).to_bytes()

    def _decoded(self, name: str, chunk: range, content: bytes) -> tuple[np.ndarray, ComputedBy]:
        contents, key = self._description.content, self._key(name, chunk)
        contents[key] = self._description.buffer.from_bytes(content)
        try:
            values = np.asarray(self._description.arrays[name][self._selection(chunk)])
        except Exception as error:  # whatever Zarr makes of wrong bytes
            raise ValueError(str(error)) from error
        finally:
            del contents[key]
        values = values.reshape(len(chunk), *values.shape[len(self.schema.grid.dims) :])
        finished = int(np.isfinite(values).cumprod().sum()) if name == STEPS else len(values)
        return values, [(finished, {})]

    def _key(self, name: str, chunk: range) -> str:
        return self.file(name, chunk).relative_to(self.path).as_posix()

    def _selection(self, chunk: range) -> tuple[slice, ...]:
        *point, seed = (int(i) for i in np.unravel_index(chunk.start, self.schema.grid.shape))
        return (*(slice(i, i + 1) for i in point), slice(seed, seed + len(chunk)))


def chunks_of_version(version: int) -> type[Chunks]:
    """How a version of the format keeps its chunks."""
    return ChunksOfFirstVersion if version == FIRST_VERSION else Chunks


def _per_seed(computed_by: ComputedBy) -> list[Versions]:
    return [versions for count, versions in computed_by for _ in range(count)]


def _grouped(per_seed: list[Versions]) -> ComputedBy:
    return [(len(list(group)), versions) for versions, group in itertools.groupby(per_seed)]
