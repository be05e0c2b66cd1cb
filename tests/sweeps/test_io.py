"""Results on disk: what is saved comes back, and nothing half-written or foreign is touched."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from hrljax.sweeps.io import load, save


def dataset(seeds: int = 3, **variables: Any) -> xr.Dataset:
    """Shaped as those of `hrljax.sweep`, with one unfinished run."""
    values = np.random.default_rng(seeds).normal(size=(2, seeds, 4))
    values[1, -1] = np.nan
    dims = ("env.slip_probability", "seed", "episode")
    found = {"return": (dims, values, {"long_name": "return per episode"}), "steps": (dims[:2], values[..., 0])}
    return xr.Dataset(
        {**found, **variables},
        {"env.slip_probability": [0.1, 0.25], "seed": np.arange(seeds), "episode": [5, 10, 15, 17]},
        {"learner": "HORDQ", "learner.epsilon": 0.1, "complete": 0, "key": "[0, 7]", "env.map": "+---+\n| 1SP|\n"},
    )


def entries(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("kind", [str, Path])
def test_what_is_saved_comes_back(tmp_path: Path, kind: type):
    path = kind(tmp_path / "new" / "folder" / "curve.zarr")
    save(dataset(), path)
    xr.testing.assert_identical(load(path), dataset())
    assert {name: variable.dtype for name, variable in load(path).variables.items()} == {
        name: variable.dtype for name, variable in dataset().variables.items()
    }
    assert entries(Path(path).parent) == ["curve.zarr"]


def test_a_loaded_dataset_can_be_saved_over_itself(tmp_path: Path):
    path = tmp_path / "curve.zarr"
    save(dataset(), path)
    save(load(path).assign_attrs(complete=1), path)
    xr.testing.assert_identical(load(path), dataset().assign_attrs(complete=1))


def test_a_store_is_replaced_as_a_whole(tmp_path: Path):
    path = tmp_path / "curve.zarr"
    save(dataset(5, extra=("seed", np.ones(5))), path)
    save(dataset(), path)
    xr.testing.assert_identical(load(path), dataset())
    assert entries(tmp_path) == ["curve.zarr"]


def test_what_lies_beside_a_store_is_left_alone(tmp_path: Path):
    for name in ("curve.zarr.partial", "curve.zarr.old"):
        (tmp_path / name).mkdir()
    save(dataset(), tmp_path / "curve.zarr")
    save(dataset(), tmp_path / "curve.zarr")
    assert entries(tmp_path) == ["curve.zarr", "curve.zarr.old", "curve.zarr.partial"]


def test_something_else_is_left_alone(tmp_path: Path):
    file, folder = tmp_path / "notes.txt", tmp_path / "thesis"
    file.write_text("mine")
    folder.mkdir()
    (folder / "chapter").write_text("one")
    for path in (file, folder):
        with pytest.raises(FileExistsError, match=f"{path.name} exists and is no Zarr store; it is left alone"):
            save(dataset(), path)
    assert entries(tmp_path) == ["notes.txt", "thesis"]
    assert file.read_text() == "mine"
    assert entries(folder) == ["chapter"]


def test_a_place_that_cannot_be_written_is_an_error(tmp_path: Path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OSError, match="file"):
        save(dataset(), tmp_path / "file" / "curve.zarr")
    assert entries(tmp_path) == ["file"]


@pytest.mark.parametrize("error", [OSError("the disk is full"), KeyboardInterrupt()])
def test_a_write_that_fails_leaves_the_old_store_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
):
    path = tmp_path / "curve.zarr"
    save(dataset(), path)
    write = xr.Dataset.to_zarr

    def fails(self: xr.Dataset, *arguments: Any, **options: Any) -> None:
        write(self[["steps"]], *arguments, **options)
        raise error

    monkeypatch.setattr(xr.Dataset, "to_zarr", fails)
    with pytest.raises(type(error)):
        save(dataset(5), path)
    xr.testing.assert_identical(load(path), dataset())
    assert entries(tmp_path) == ["curve.zarr"]


def test_a_store_that_cannot_be_put_in_place_does_not_cost_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "curve.zarr"
    save(dataset(), path)
    rename = Path.rename

    def fails(self: Path, target: Path) -> Path:
        if self.name.endswith(".partial"):
            raise OSError("no")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fails)
    with pytest.raises(OSError, match="no"):
        save(dataset(5), path)
    xr.testing.assert_identical(load(path), dataset())


def test_there_is_nothing_to_load(tmp_path: Path):
    (tmp_path / "folder").mkdir()
    for name in ("nowhere", "folder"):
        with pytest.raises(FileNotFoundError, match=f"no Zarr store at .*{name}"):
            load(tmp_path / name)


def test_what_is_no_dataset_or_no_path_is_refused(tmp_path: Path):
    for call, message in (
        (lambda: save(5, tmp_path / "x"), "dataset must be a dataset of hrljax.sweep, got 5"),
        (lambda: save(xr.DataArray([1.0]), tmp_path / "x"), "dataset must be .*got <xarray.DataArray"),
        (lambda: save(xr.Dataset(), 5), "path must be a path: .*got 5"),
        (lambda: load(None), "path must be a path: .*got None"),
    ):
        with pytest.raises(TypeError, match=message):
            call()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("damage", "reason"), [("truncated", ".*"), ("flipped", ".*[cC]hecksum.*"), ("absent", "it is not there")]
)
def test_a_damaged_file_is_named(tmp_path: Path, damage: str, reason: str):
    path = tmp_path / "curve.zarr"
    save(dataset(), path)
    file = path / "steps" / "c" / "0" / "0"
    content = file.read_bytes()
    if damage == "absent":
        file.unlink()
    else:
        file.write_bytes(content[:-1] if damage == "truncated" else content[:-5] + b"?" + content[-4:])
    with pytest.raises(ValueError, match=rf"curve.zarr is damaged: steps/c/0/0 \({reason}\)$"):
        load(path)
    (path / "zarr.json").write_text("?")
    with pytest.raises(ValueError, match=r"curve.zarr is damaged: zarr\.json"):
        load(path)


def test_datasets_of_before_had_no_file_for_empty_chunks(tmp_path: Path):
    path = tmp_path / "curve.zarr"
    with_zeros = dataset(zeros=("seed", np.zeros(3, np.int64)))
    with_zeros.to_zarr(path, consolidated=False)
    assert not (path / "zeros" / "c").exists()
    xr.testing.assert_identical(load(path), with_zeros)
    save(with_zeros, path)
    assert (path / "zeros" / "c" / "0").exists()
