"""The bytes of a chunk file: its numbers as gzip, and in gzip's header where they belong.

The header of a gzip file has a field for what programs want to add (RFC 1952, section 2.3.1.1), and
every reader skips it. So what says where a chunk belongs is in the file of the chunk, is written with
it or not at all, and any Zarr reader opens it.
"""

import hashlib
import json
import struct
import zlib
from typing import NamedTuple

import numpy as np

from hrljax.sweeps.versions import ComputedBy

COMPRESSION = 4
"""Level of gzip: files as small as those of Zarr's own default, in less than a millisecond each."""
_START = b"\x1f\x8b\x08\x04" + bytes(5) + b"\xff"  # gzip, deflated, with a field of ours, no time, no system
_FIELD = b"HR"
_LENGTH = struct.Struct("<H")
_DIGEST = 16


def _before_field(size: int) -> bytes:
    """The bytes in front of a field of ours of some size."""
    return _START + _LENGTH.pack(len(_FIELD) + _LENGTH.size + size) + _FIELD + _LENGTH.pack(size)


_FIELD_BEGINS = len(_before_field(0))


class Label(NamedTuple):
    """Where the numbers of a chunk file belong."""

    settings: str  # digest of the sweep's settings
    file: str  # its place below the store
    chunk_size: int  # most seeds of a chunk of this store
    first_seed: int
    computed_by: ComputedBy  # the chunk's first seeds, which are finished


def encode(values: np.ndarray, label: Label) -> bytes:
    """A chunk file.

    Args:
        values: of the whole chunk, unfinished seeds included.
        label: where they belong.
    """
    numbers = values.astype(values.dtype.newbyteorder("<")).tobytes()
    compressor = zlib.compressobj(COMPRESSION, zlib.DEFLATED, -zlib.MAX_WBITS)
    body = compressor.compress(numbers) + compressor.flush()
    body += struct.pack("<II", zlib.crc32(numbers), len(numbers) % 2**32)
    text = json.dumps(label._asdict(), separators=(",", ":")).encode()
    field = _digest(text + body) + text
    return _before_field(len(field)) + field + body


def decode(content: bytes, dtype: np.dtype[np.generic], shape: tuple[int, ...]) -> np.ndarray:
    """The values of a whole chunk, ``[*shape]``; `label_of` has to have read its label.

    Raises:
        ValueError: there are more or fewer.
    """
    size, numbers = int(np.prod(shape)) * dtype.itemsize, zlib.decompress(content, zlib.MAX_WBITS | 16)
    if len(numbers) != size:
        raise ValueError(f"it holds {len(numbers)} bytes instead of {size}")
    return np.frombuffer(numbers, dtype.newbyteorder("<")).reshape(shape).astype(dtype)


def label_of(content: bytes) -> Label:
    """The label of a chunk file.

    Raises:
        ValueError: the file is not as it was written.
    """
    size = int.from_bytes(content[_FIELD_BEGINS - _LENGTH.size : _FIELD_BEGINS], "little")
    field_ends = _FIELD_BEGINS + size
    text = content[_FIELD_BEGINS + _DIGEST : field_ends]
    expected = _before_field(size) + _digest(text + content[field_ends:])
    if not content.startswith(expected):
        raise ValueError("its checksum does not match")
    fields = json.loads(text)
    return Label(**{**fields, "computed_by": [(count, versions) for count, versions in fields["computed_by"]]})


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()[:_DIGEST]
