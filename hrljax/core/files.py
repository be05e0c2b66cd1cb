"""Files that are either whole or not there, whatever happens while they are written."""

import contextlib
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


def make_folder(path: Path, what: str) -> None:
    """Makes the folder of something, and those above it, or none of them.

    Raises:
        OSError: it cannot be made; the message says why.
    """
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        for folder in missing:
            with contextlib.suppress(OSError):
                folder.rmdir()
        files = [folder for folder in (path, *path.parents) if folder.is_file()]
        why = f"{files[0]} is a file" if files else "its folder cannot be made"
        raise with_reason(error, path, f"{what} cannot be written", f": {why}") from error


def with_reason(error: OSError, path: Path, what: str, consequence: str = "") -> OSError:
    """An error of the same kind that says what cannot be done with a path, why, and what follows."""
    reason = error.strerror or str(error)
    return type(error)(error.errno or 0, f"{what} ({reason}){consequence}", str(path))


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
