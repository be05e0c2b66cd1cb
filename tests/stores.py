"""What tests of stores share: what is in one, what was computed for it, and disks that die."""

import os
from pathlib import Path
from typing import Any

import pytest

from hrljax.sweeps.store import Store
from tests.kill_sweep import CALLS


def contents(store: Path) -> dict[str, bytes | None]:
    """Every file and folder below a store."""
    return {
        path.relative_to(store).as_posix(): path.read_bytes() if path.is_file() else None for path in store.rglob("*")
    }


def written(path: Path, files: dict[str, bytes | None]) -> Path:
    """A store of these files."""
    for name, content in files.items():
        if content is not None:
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            (path / name).write_bytes(content)
    return path


def chunk_files(store: Path) -> list[Path]:
    return sorted(
        path for path in store.rglob("*") if path.is_file() and "c" in path.parts and "step_size" not in path.parts
    )


class Counted:
    """Chunks that are computed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.chunks: list[range] = []
        write = Store.write

        def counted(store: Store, chunk: range, values: Any) -> None:
            self.chunks.append(chunk)
            write(store, chunk, values)

        monkeypatch.setattr(Store, "write", counted)

    @property
    def runs(self) -> int:
        return sum(map(len, self.chunks))


class DiedError(BaseException):
    """The process would be dead."""


def die_at(monkeypatch: pytest.MonkeyPatch, instant: int) -> list[int]:
    """From a call that changes the disk on, the disk stays as it is, as after a kill; returns a counter of calls."""
    count = [0]

    def counted(call: Any) -> Any:
        def instead(*arguments: Any, **options: Any) -> Any:
            count[0] += 1
            if 0 < instant <= count[0]:
                raise DiedError
            return call(*arguments, **options)

        return instead

    for name in CALLS:
        monkeypatch.setattr(os, name, counted(getattr(os, name)))
    return count
