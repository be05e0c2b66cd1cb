"""Files that are either whole or not there, whatever happens while they are written."""

import os
from pathlib import Path

PARTIAL = ".partial"
"""End of the name of a file that is being written."""


def write_atomically(path: Path, content: bytes) -> None:
    """Writes a file beside its place, waits for the disk, and puts it in its place.

    Raises:
        OSError: it cannot be written; what was there is as it was.
    """
    partial = path.with_name(path.name + PARTIAL)
    try:
        with open(partial, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
