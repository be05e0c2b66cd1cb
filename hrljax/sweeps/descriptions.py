"""All of a sweep's store but its chunks: what Zarr reads first, and the coordinates."""

from __future__ import annotations

import json
import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hrljax.sweeps.chunk_file import COMPRESSION
from hrljax.sweeps.schema import SEED, Schema, describe
from hrljax.sweeps.versions import Attributes

if TYPE_CHECKING:
    from zarr import Array as ZarrArray
    from zarr import Group
    from zarr.codecs import GzipCodec
    from zarr.core.buffer import Buffer

FIRST_VERSION, NEWEST_VERSION = 1, 2
"""Of the format: labels of chunks came with the second."""
ROOT = "zarr.json"
"""The file with the settings and the descriptions of all arrays."""
_SEEDS_OF_A_FILE = 1024
"""Of the coordinate: its files are full to the end, so that those of more seeds begin with those of fewer."""


class Description(NamedTuple):
    """A store without chunks, in memory."""

    content: dict[str, Buffer]  # by place, what Zarr keeps bytes in
    arrays: dict[str, ZarrArray[Any]]  # the variables

    @property
    def buffer(self) -> type[Buffer]:
        """What Zarr keeps bytes in."""
        return type(self.content[ROOT])

    def files(self, attributes: Attributes) -> dict[str, bytes]:
        """Every file by its place, the root first, with these attributes."""
        root = json.loads(self.content[ROOT].to_bytes())
        members = root["consolidated_metadata"]["metadata"]  # some Zarrs list them as they happen to come
        root["consolidated_metadata"]["metadata"] = dict(sorted(members.items()))
        settings = json.dumps({**root, "attributes": attributes}, indent=2).encode()
        return {ROOT: settings, **{name: c.to_bytes() for name, c in self.content.items() if name != ROOT}}


def describe_store(schema: Schema, chunk_size: int, version: int, seeds_of_a_file: int | None = None) -> Description:
    """Makes the store without its chunks.

    Args:
        schema: names and places of the sweep's values.
        chunk_size: most seeds of a chunk.
        version: of the format.
        seeds_of_a_file: of the coordinate, where it is there already.
    """
    import zarr
    from zarr.codecs import GzipCodec
    from zarr.storage import MemoryStore

    of_chunks = None if version == FIRST_VERSION else [GzipCodec(level=COMPRESSION)]
    content: dict[str, Buffer] = {}
    arrays: dict[str, ZarrArray[Any]] = {}
    store = MemoryStore(store_dict=content)
    group = zarr.create_group(store=store)
    for name, variable in schema.variables.items():
        dims = (*schema.grid.dims, *variable.dims)
        shape = (*schema.grid.shape, *variable.shape)
        chunks = (*[1] * (len(schema.grid.dims) - 1), chunk_size, *variable.shape)
        arrays[name] = _array(group, name, shape, chunks, dims, variable.unfinished, variable.attributes, of_chunks)
    for name, (dim, values) in schema.coordinates.items():
        size = len(values)
        if name == SEED:
            size = seeds_of_a_file or (size if version == FIRST_VERSION else _SEEDS_OF_A_FILE)
        whole = -(-len(values) // size) * size
        array = _array(group, name, (whole,), (size,), (dim,), values.dtype.type(0), describe(name))
        array[...] = np.arange(whole) if name == SEED else values
        array.resize(values.shape)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
        zarr.consolidate_metadata(store)  # xarray looks for it and warns if it is not there
    return Description(content, arrays)


def _array(
    group: Group,
    name: str,
    shape: tuple[int, ...],
    chunks: tuple[int, ...],
    dims: tuple[str, ...],
    fill_value: np.generic,
    attributes: dict[str, str],
    compressors: list[GzipCodec] | None = None,
) -> ZarrArray[Any]:
    """A new Zarr array; all that decides on its bytes is said here, whatever Zarr's defaults are.

    What Zarr itself writes is not gzip, which it gives the time of the day.
    """
    from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec

    return group.create_array(
        name,
        shape=shape,
        chunks=chunks,
        dtype=fill_value.dtype,
        fill_value=fill_value,
        filters=None,
        serializer=BytesCodec(endian="little"),
        compressors=compressors or [ZstdCodec(level=3), Crc32cCodec()],
        chunk_key_encoding={"name": "default", "separator": "/"},
        dimension_names=dims,
        attributes={**attributes},
        config={"write_empty_chunks": True},
    )
