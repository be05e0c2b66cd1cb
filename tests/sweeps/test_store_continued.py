"""Stores that are damaged, of other versions, or to be given more seeds: what they say is true."""

import gzip
import io
import json
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import hrljax
from hrljax.sweeps import versions
from hrljax.sweeps.store_attributes import chunk_size_of
from tests.kill_sweep import sweep
from tests.stores import Counted, DiedError, chunk_files, contents, die_at, written

FIRST_VERSION = Path(__file__).parents[1] / "data" / "store_version_1.zip"
"""What the first version of the format made of `tests.kill_sweep.sweep`."""


@pytest.fixture(scope="module")
def five(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes | None]:
    """The files of a store of five seeds."""
    path = tmp_path_factory.mktemp("five") / "x.zarr"
    sweep(store=path)
    return contents(path)


@pytest.fixture(scope="module")
def seven(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes | None]:
    """The files of a store of seven seeds, made in one go."""
    path = tmp_path_factory.mktemp("seven") / "x.zarr"
    sweep(store=path, seeds=7)
    return contents(path)


@pytest.fixture(scope="module")
def expected() -> xr.Dataset:
    """Seven seeds."""
    return sweep(seeds=7)


@pytest.fixture
def copy(five: dict[str, bytes | None], tmp_path: Path) -> Path:
    return written(tmp_path / "x.zarr", five)


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A store of the first version, as if of the versions of this process."""
    path = tmp_path / "old.zarr"
    with zipfile.ZipFile(FIRST_VERSION) as file:
        file.extractall(path)
    with_attributes(path, {f"version.{package}": version for package, version in versions.installed().items()})
    return path


def with_attributes(store: Path, attributes: Mapping[str, Any]) -> None:
    root = json.loads((store / "zarr.json").read_bytes())
    root["attributes"] |= attributes
    (store / "zarr.json").write_text(json.dumps(root, indent=2))


def of_other_versions(monkeypatch: pytest.MonkeyPatch, **others: str) -> None:
    other = {**versions.installed(), **others}
    monkeypatch.setattr(versions, "installed", lambda: other)


# More seeds


def test_more_seeds_are_computed_alone(
    copy: Path, seven: dict[str, bytes | None], expected: xr.Dataset, monkeypatch: pytest.MonkeyPatch
):
    """The last chunk of five seeds holds one of two: it is filled up."""
    counted = Counted(monkeypatch)
    xr.testing.assert_equal(sweep(store=copy, seeds=7, chunk_size=None), expected)
    assert counted.runs == 2 * 2
    assert contents(copy) == seven
    xr.testing.assert_equal(xr.open_zarr(copy, consolidated=False).load(), expected)


def test_an_unfinished_store_takes_more_seeds(copy: Path, seven: dict[str, bytes | None]):
    for name in ("return/c/0/0/0", "steps/c/1/2"):
        (copy / name).unlink()
    sweep(store=copy, seeds=7)
    assert contents(copy) == seven


def consistent(store: Path, expected: xr.Dataset) -> None:
    """Whatever was there when the disk died can be read, and is right."""
    loaded, opened = hrljax.load(store), xr.open_zarr(store).load()
    seeds = loaded.sizes["seed"]
    assert seeds in (5, 7)
    np.testing.assert_array_equal(opened["seed"], range(seeds))
    is_finished = loaded["steps"].notnull()
    xr.testing.assert_equal(loaded, expected.isel(seed=slice(seeds)).where(is_finished))
    assert bool(is_finished.isel(seed=slice(5)).all())
    assert loaded.attrs["complete"] == int(is_finished.all())
    assert opened.attrs["complete"] <= int(opened.notnull().all().to_array().all())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("version", "instants"),
    [("first", [3, 6, 12, 30, 34, 50]), ("newest", [2, 3, 5, 6, 9, 14, 27, 28, 30, 33, 36, 45, 60, 75, 91])],
)
def test_a_kill_while_seeds_are_added_loses_nothing(
    five: dict[str, bytes | None], old: Path, expected: xr.Dataset, tmp_path: Path, version: str, instants: list[int]
):
    """At the instants where what is written next is of another kind, and some between."""
    before = five if version == "newest" else contents(old)
    path, ends = tmp_path / "x.zarr", {}
    for instant in (0, *instants):
        written(path, before)
        with pytest.MonkeyPatch.context() as patch:
            count = die_at(patch, instant)
            try:
                sweep(store=path, seeds=7)
            except DiedError:
                pass
            else:
                assert instant == 0 or instant > count[0]  # calls that a kill can come before are at most these
        consistent(path, expected)
        if instant:
            sweep(store=path, seeds=7)
        ends[instant] = contents(path)
        shutil.rmtree(path)
    assert all(end == ends[0] for end in ends.values())


def test_fewer_seeds_are_refused(copy: Path):
    before = contents(copy)
    with pytest.raises(ValueError, match=r"has 5 seeds, more than seeds=3; ask for seeds=5 and select .*slice\(2\)"):
        sweep(store=copy, seeds=3)
    assert contents(copy) == before


def test_the_size_of_chunks_is_the_stores(copy: Path):
    """A store of few seeds has smaller chunks than it was asked for; asked for the same again, it keeps its own."""
    assert chunk_size_of(copy, None) == 2
    assert chunk_size_of(copy, 3) == 3
    with_attributes(copy, {"seeds": 2})
    assert chunk_size_of(copy, 3) == 2
    assert chunk_size_of(copy / "nowhere", 3) == 3


# Damage


@pytest.mark.parametrize("damage", ["truncated", "garbled", "flipped", "empty"])
def test_a_damaged_chunk_is_named(copy: Path, damage: str):
    file = copy / "return" / "c" / "1" / "1" / "0"
    content = file.read_bytes()
    for position in (0, 11, 40, len(content) - 20, len(content) - 1) if damage == "flipped" else (0,):
        flipped = content[:position] + bytes([content[position] ^ 1]) + content[position + 1 :]
        spoilt = {"truncated": content[:-7], "garbled": b"?" * len(content), "flipped": flipped, "empty": b""}
        file.write_bytes(spoilt[damage])
        message = r"x.zarr is damaged: return/c/1/1/0 \(step_size=0.5, seeds 2 to 3\): its checksum does not match; the"
        with pytest.raises(ValueError, match=message):
            hrljax.load(copy)


def test_a_chunk_in_the_place_of_another_is_no_chunk(
    five: dict[str, bytes | None], copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    sweep(store=tmp_path / "other.zarr", key=1)
    steps = copy / "steps" / "c"
    shutil.copy(steps / "0" / "1", steps / "1" / "1")
    shutil.copy(tmp_path / "other.zarr" / "steps" / "c" / "0" / "0", steps / "0" / "0")
    reasons = (
        r"steps/c/0/0 \(step_size=0.125, seeds 0 to 1\): it belongs to another store; "
        r"steps/c/1/1 \(step_size=0.5, seeds 2 to 3\): it belongs to steps/c/0/1"
    )
    with pytest.raises(ValueError, match=f"is damaged: {reasons}"):
        hrljax.load(copy)
    counted = Counted(monkeypatch)
    with pytest.warns(RuntimeWarning, match=f"2 files of the store .* are corrupt, .*: {reasons}"):
        sweep(store=copy)
    assert counted.runs == 4
    assert contents(copy) == five


def test_missing_chunks_are_never_complete(copy: Path, expected: xr.Dataset, monkeypatch: pytest.MonkeyPatch):
    """A run of which one value is missing is not finished."""
    (copy / "length" / "c" / "0" / "2" / "0").unlink()
    loaded = hrljax.load(copy)
    assert xr.open_zarr(copy).attrs["complete"] == 1
    assert loaded.attrs["complete"] == 0
    is_finished = xr.ones_like(loaded["steps"], bool)
    is_finished[0, 4] = False
    xr.testing.assert_equal(loaded, expected.isel(seed=slice(5)).where(is_finished))

    def stopped(*_: Any) -> None:
        raise OSError("enough")

    with monkeypatch.context() as patch:
        patch.setattr("hrljax.sweeps.store.Store.write", stopped)
        with pytest.raises(OSError, match="enough"):
            sweep(store=copy)
    assert xr.open_zarr(copy).attrs["complete"] == 0


@pytest.mark.parametrize("damage", [None, b"", b'{"attributes": {"seeds', b"\xff?"])
def test_a_lost_root_is_written_again(
    five: dict[str, bytes | None], copy: Path, monkeypatch: pytest.MonkeyPatch, damage: bytes | None
):
    root = copy / "zarr.json"
    root.unlink() if damage is None else root.write_bytes(damage)
    (copy / "steps" / "zarr.json").unlink()
    (copy / "return" / "c" / "0" / "0" / "0").write_bytes(b"?")
    with pytest.raises((ValueError, FileNotFoundError), match=r"zarr\.json.*the same hrljax\.sweep.* mends it"):
        hrljax.load(copy)
    counted = Counted(monkeypatch)
    with pytest.warns(RuntimeWarning, match="1 files"):
        sweep(store=copy, chunk_size=None)
    assert counted.runs == 2
    assert contents(copy) == five


def test_a_store_without_root_is_left_alone_unless_it_is_of_this_sweep(copy: Path, old: Path, tmp_path: Path):
    for path in (copy, old):
        (path / "zarr.json").unlink()
    before = contents(tmp_path)
    with pytest.raises(ValueError, match=r"has lost its zarr.json, and its chunks belong to another sweep"):
        sweep(store=copy, key=1)
    with pytest.raises(ValueError, match="has 5 seeds, more than seeds=3"):
        sweep(store=copy, seeds=3)
    no_chunk_tells = "has lost its zarr.json, or it is damaged, and no chunk tells .*; it is left alone"
    with pytest.raises(FileExistsError, match=no_chunk_tells):
        sweep(store=old)
    assert contents(tmp_path) == before
    sweep(store=tmp_path / "other.zarr", key=1)
    shutil.copy(tmp_path / "other.zarr" / "steps" / "c" / "0" / "0", copy / "steps" / "c" / "0" / "0")
    with pytest.raises(FileExistsError, match=no_chunk_tells):
        sweep(store=copy)


def test_a_store_without_root_takes_more_seeds(copy: Path, seven: dict[str, bytes | None]):
    (copy / "zarr.json").unlink()
    sweep(store=copy, seeds=7)
    assert contents(copy) == seven


def test_a_damaged_setting_is_mended(five: dict[str, bytes | None], copy: Path):
    """The digest of the settings says that they are the same, whatever one of them has become."""
    with_attributes(copy, {"num_episodes": 13})
    sweep(store=copy)
    assert contents(copy) == five


@pytest.mark.parametrize("damage", ["absent", "truncated"])
def test_a_damaged_coordinate_is_named_and_mended(five: dict[str, bytes | None], copy: Path, damage: str):
    for name in ("seed", "step_size", "episode"):
        file = copy / name / "c" / "0"
        file.unlink() if damage == "absent" else file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(ValueError, match=r"is damaged: episode/c/0 \(.*\); the same hrljax.sweep.* mends it"):
        hrljax.load(copy)
    sweep(store=copy)
    assert contents(copy) == five


def test_arrays_without_description_are_read_all_the_same(copy: Path):
    for name in ("return", "steps", "seed"):
        (copy / name / "zarr.json").unlink()
    xr.testing.assert_equal(hrljax.load(copy), sweep())


def test_what_is_loaded_and_saved_is_no_store(copy: Path, tmp_path: Path):
    loaded, saved, old = hrljax.load(copy), tmp_path / "saved.zarr", tmp_path / "old.zarr"
    hrljax.save(loaded, saved)
    loaded.to_zarr(old, consolidated=False)  # as it was saved before
    root = json.loads((old / "zarr.json").read_bytes())
    (old / "zarr.json").write_text(json.dumps({**root, "consolidated_metadata": None}))  # as Zarr 3.0 has it
    for path in (saved, old):
        xr.testing.assert_equal(hrljax.load(path), loaded)
        with pytest.raises(FileExistsError, match="was not written by hrljax"):
            sweep(store=path)


def test_chunk_files_are_plain_gzip(copy: Path):
    """Any program reads them; what is in the header is skipped."""
    steps = np.frombuffer(gzip.decompress((copy / "steps" / "c" / "1" / "2").read_bytes()), "<f8")
    assert steps[0] == sweep()["steps"][1, 4]
    assert np.isnan(steps[1])


# Other versions


def test_other_versions_have_to_be_allowed(copy: Path, monkeypatch: pytest.MonkeyPatch):
    for file in chunk_files(copy):
        if file.parts[-3:-1] == ("c", "1") or file.parts[-4:-2] == ("c", "1"):
            file.unlink()
    before = contents(copy)
    installed = versions.installed()
    of_other_versions(monkeypatch, jax="99.1", numpy="88.2")
    ours = installed["jax"]
    way_out = "here; allow_other_versions=True continues it nevertheless"
    with pytest.raises(ValueError, match=rf"another sweep: version.jax is '{ours}' there and '99.1' {way_out}"):
        sweep(store=copy)
    with pytest.raises(ValueError, match=r"num_episodes is 12 there and 13 here; version.jax is .* '99.1' here$"):
        sweep(store=copy, num_episodes=13)
    assert contents(copy) == before
    swept = sweep(store=copy, allow_other_versions=True)
    loaded = hrljax.load(copy)
    for dataset in (swept, loaded, xr.open_zarr(copy)):
        assert dataset.attrs["version.jax"] == f"{ours}, 99.1"
        assert dataset.attrs["version.jaxlib"] == installed["jaxlib"]
        assert json.loads(dataset.attrs["versions"]) == [installed, versions.installed()]
    xr.testing.assert_equal(swept, loaded)
    np.testing.assert_array_equal(swept["version_set"], [[0] * 5, [1] * 5])
    xr.testing.assert_equal(swept.drop_vars("version_set"), sweep())
    with pytest.raises(ValueError, match=rf"version.jax is '{ours}, 99.1' there and '99.1' {way_out}"):
        sweep(store=copy)


def test_seeds_of_one_chunk_may_have_two_versions(copy: Path, monkeypatch: pytest.MonkeyPatch):
    of_other_versions(monkeypatch, jaxlib="99.1")
    swept = sweep(store=copy, seeds=7, allow_other_versions=True)
    np.testing.assert_array_equal(swept["version_set"], [[0] * 5 + [1] * 2] * 2)
    xr.testing.assert_equal(hrljax.load(copy), swept)


def test_what_is_read_keeps_its_versions(five: dict[str, bytes | None], copy: Path, monkeypatch: pytest.MonkeyPatch):
    """A finished store computes nothing; versions that cannot change a number need no permission, but are told."""
    installed = versions.installed()
    of_other_versions(monkeypatch, jax="99.1", numpy="88.2")
    assert sweep(store=copy, allow_other_versions=True).attrs["version.jax"] == installed["jax"]
    assert contents(copy) == five
    monkeypatch.undo()
    of_other_versions(monkeypatch, numpy="88.2")
    assert sweep(store=copy).attrs["version.numpy"] == installed["numpy"]
    assert contents(copy) == five
    assert sweep(store=copy, seeds=7).attrs["version.numpy"] == f"{installed['numpy']}, 88.2"


def test_versions_that_computed_nothing_are_forgotten(copy: Path, monkeypatch: pytest.MonkeyPatch):
    of_other_versions(monkeypatch, jax="99.1")
    for file in (copy / "steps").rglob("*/*/*"):
        file.unlink(missing_ok=True) if file.is_file() else None
    swept = sweep(store=copy, allow_other_versions=True)
    assert swept.attrs["version.jax"] == hrljax.load(copy).attrs["version.jax"] == "99.1"
    assert "versions" not in swept.attrs
    assert "version_set" not in swept


# The first version of the format


def test_a_store_of_the_first_version_opens_and_continues(
    old: Path, expected: xr.Dataset, monkeypatch: pytest.MonkeyPatch
):
    before, plain = contents(old), expected.isel(seed=slice(5))
    xr.testing.assert_equal(hrljax.load(old), plain)
    counted = Counted(monkeypatch)
    xr.testing.assert_equal(sweep(store=old), plain)
    assert not counted.chunks
    assert contents(old) == before
    (old / "steps" / "c" / "0" / "0").unlink()
    (old / "return" / "c" / "1" / "2" / "0").write_bytes(b"?" * 40)
    with pytest.raises(ValueError, match=r"is damaged: return/c/1/2/0 \(step_size=0.5, seeds 4 to 4\)"):
        hrljax.load(old)
    with pytest.warns(RuntimeWarning, match=r"return/c/1/2/0 \(step_size=0.5, seeds 4 to 4\)"):
        xr.testing.assert_equal(sweep(store=old), plain)
    assert counted.runs == 3
    xr.testing.assert_equal(xr.open_zarr(old).load(), plain)
    xr.testing.assert_equal(hrljax.load(old), plain)
    assert hrljax.load(old).attrs["store_version"] == 1
    assert set(contents(old)) == set(before)


def test_the_first_version_records_other_versions(old: Path, monkeypatch: pytest.MonkeyPatch):
    """Which of them computed what, its files cannot tell."""
    of_other_versions(monkeypatch, jax="99.1")
    (old / "steps" / "c" / "0" / "0").unlink()
    swept = sweep(store=old, allow_other_versions=True)
    xr.testing.assert_equal(swept, hrljax.load(old))
    assert len(json.loads(swept.attrs["versions"])) == len(json.loads(hrljax.load(old).attrs["versions"])) == 2


def test_a_version_that_is_not_known_is_refused(copy: Path):
    with_attributes(copy, {"store_version": 3})
    for use in (hrljax.load, lambda path: sweep(store=path)):
        with pytest.raises(ValueError, match="has version 3 of the format, known are 1 and 2"):
            use(copy)


def test_the_first_version_is_what_it_was():
    """The data of these tests are small, and of version 1."""
    assert FIRST_VERSION.stat().st_size < 8000
    with zipfile.ZipFile(io.BytesIO(FIRST_VERSION.read_bytes())) as file:
        attributes = json.loads(file.read("zarr.json"))["attributes"]
    assert (attributes["store_version"], attributes["seeds"], attributes["complete"]) == (1, 5, 1)
