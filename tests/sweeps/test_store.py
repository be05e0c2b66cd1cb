"""Stores of sweeps: killed, damaged and refused, they never give a wrong number."""

import dataclasses
import errno
import os
import random
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import optax
import pytest
import xarray as xr

import hrljax
from hrljax.core import files
from hrljax.sweeps import fingerprint
from hrljax.sweeps.store import Store
from tests import kill_sweep
from tests.kill_sweep import sweep
from tests.stores import Counted, chunk_files, contents, written


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store that was written in one go."""
    path = tmp_path_factory.mktemp("whole") / "x.zarr"
    sweep(store=path)
    return path


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    """Another such store, to be damaged."""
    return written(tmp_path / "x.zarr", contents(whole))


def test_a_store_holds_what_the_sweep_returns(whole: Path):
    plain = sweep()
    for opened in (hrljax.load(whole), xr.open_zarr(whole), xr.open_zarr(whole, consolidated=False)):
        xr.testing.assert_equal(opened, plain)
        assert opened.attrs["complete"] == 1
        for name in plain.variables:
            assert opened[name].attrs == plain[name].attrs
            assert opened[name].dtype == plain[name].dtype
    timing = {"seconds", "compile_seconds", "mapping"}
    assert timing.isdisjoint(opened.attrs)
    assert {k: v for k, v in plain.attrs.items() if k not in timing}.items() <= opened.attrs.items()


def test_a_finished_store_computes_nothing(whole: Path, monkeypatch: pytest.MonkeyPatch):
    before, counted = contents(whole), Counted(monkeypatch)
    xr.testing.assert_equal(sweep(store=whole), sweep())
    assert not counted.chunks
    assert contents(whole) == before


def lives(path: Path, *instants: float) -> list[str]:
    """How each of a sweep's lives ended; see `tests/kill_sweep.py`. What one has compiled the next ones load."""
    cache = {
        "JAX_COMPILATION_CACHE_DIR": str(path.parent / "cache"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    program = [sys.executable, "-m", "tests.kill_sweep", str(path), *map(str, instants)]
    folder = Path(kill_sweep.__file__).parents[1]
    options = {"capture_output": True, "text": True, "cwd": folder, "check": True, "env": os.environ | cache}
    return subprocess.run(program, **options).stdout.split()


@pytest.mark.slow
def test_a_sweep_that_is_killed_again_and_again_ends_as_one_that_is_not(whole: Path, tmp_path: Path):
    """Every life ends before some call that changes the disk; the next one goes on from there."""
    draw, path = random.Random(0), tmp_path / "x.zarr"
    instants = [draw.randrange(1, 16) for _ in range(20)]
    assert lives(tmp_path / "compiled.zarr", 0) == ["finished"]
    assert lives(path, *instants) == ["killed"] * 20
    half = contents(path)
    assert {name for name in half if not name.endswith(".partial")} < set(contents(whole))
    assert lives(path, 0) == ["finished"]
    assert contents(path) == contents(whole)


@pytest.mark.slow
def test_a_sweep_that_is_killed_from_outside_ends_as_one_that_is_not(whole: Path, tmp_path: Path):
    """When depends on the machine; what remains must not."""
    path = tmp_path / "x.zarr"
    assert lives(path, 0.9, 0.5, 1.1, 0)[-1] == "finished"
    assert contents(path) == contents(whole)


@pytest.mark.parametrize("damage", ["truncated", "empty", "flipped", "absent"])
def test_damaged_chunks_are_reported_and_computed_again(
    whole: Path, copy: Path, monkeypatch: pytest.MonkeyPatch, damage: str
):
    victims = chunk_files(copy)[3], chunk_files(copy)[-1]
    for file in victims:
        content = file.read_bytes()
        spoilt = {"truncated": content[:-7], "empty": b"", "flipped": bytes([content[0] ^ 1]) + content[1:]}
        if damage == "absent":
            file.unlink()
        else:
            file.write_bytes(spoilt[damage])
    counted = Counted(monkeypatch)
    if damage == "absent":
        found = sweep(store=copy)  # an interrupted sweep; a warning would be an error
    else:
        with pytest.warns(RuntimeWarning, match=f"2 files of the store .* are corrupt.*: .*{victims[0].name}"):
            found = sweep(store=copy)
    assert len(counted.chunks) == 2
    xr.testing.assert_equal(found, sweep())
    assert contents(copy) == contents(whole)


def test_readers_refuse_a_damaged_chunk(copy: Path):
    file = copy / "return" / "c" / "1" / "0" / "0"
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(ValueError, match=r"(?i)checksum"):
        hrljax.load(copy)


def test_damaged_descriptions_are_mended(whole: Path, copy: Path):
    (copy / "seed" / "c" / "0").write_bytes(b"")
    (copy / "return" / "zarr.json").unlink()
    sweep(store=copy)
    assert contents(copy) == contents(whole)


OTHER: list[tuple[dict[str, Any], str]] = [
    ({"num_episodes": 13}, "num_episodes is 12 there and 13 here"),
    ({"bin_size": 3}, "bin_size is 4 there and 3 here"),
    ({"key": 1}, r"key is '\[0, 0\]' there and '\[0, 1\]' here"),
    ({"axes": {"step_size": [0.125, 0.25]}}, r"axes is '.*0\.5.*' there and '.*0\.25.*' here"),
    (
        {"axes": {"epsilon": [0.125]}},
        "learner.step_size is 'swept' there and 0.1 here; learner.epsilon is 0.1 there and",
    ),
    ({"evaluate_every": 1}, "evaluate_every is 0 there and 1 here"),
    ({"keep_learned": True}, "keep_learned is 0 there and 1 here"),
    ({"chunk_size": 3}, "chunk_size is 2 there and 3 here"),
    ({"params": hrljax.make("Maze").default_params._replace(max_steps=99)}, "env.max_steps is 1000 there and 99 here"),
]


@pytest.mark.parametrize(("options", "message"), OTHER, ids=[str(options) for options, _ in OTHER])
def test_a_store_of_other_settings_is_refused(whole: Path, options: dict[str, Any], message: str):
    before = contents(whole)
    with pytest.raises(ValueError, match=f"the store .*x.zarr belongs to another sweep: .*{message}"):
        sweep(store=whole, **options)
    assert contents(whole) == before


def test_what_cannot_change_a_number_may_differ(whole: Path):
    before = contents(whole)
    sweep(store=whole, chunk_size=None, cores=1, mapping="native")
    assert contents(whole) == before


def test_schedules_and_hierarchies_are_told_apart_by_what_they_do(tmp_path: Path):
    env, options = hrljax.make("Maze"), {"seeds": 1, "num_episodes": 2, "mapping": "vmap", "progress": False}

    def store(name: str, learner: Any) -> None:
        hrljax.sweep(env, learner, **options, store=tmp_path / name)

    store("flat", hrljax.QLearning(epsilon=optax.linear_schedule(0.5, 0.1, 2)))
    store("flat", hrljax.QLearning(epsilon=optax.linear_schedule(0.5, 0.1, 2)))
    with pytest.raises(ValueError, match=r"another sweep: digest.learner.epsilon is .* there and .* here$"):
        store("flat", hrljax.QLearning(epsilon=optax.linear_schedule(0.5, 0.2, 2)))
    standard = env.hierarchy()
    ends = [dataclasses.replace(task, goal=None) for task in standard.subtasks]
    kinds = [standard, hrljax.Hierarchy(standard.actions, ends)]
    one, other = (fingerprint.digests(env, hrljax.MAXQ(kind), 2) for kind in kinds)
    assert set(one) == set(other) == {"digest.learner.hierarchy"}
    assert one != other
    again = hrljax.Hierarchy(standard.actions, standard.subtasks)
    assert fingerprint.digests(env, hrljax.MAXQ(again), 2) == one


def test_options_are_told_apart_by_what_they_do(tmp_path: Path):
    """Their text has their names only."""
    env = hrljax.make("Maze")
    options = hrljax.options_from(env.hierarchy(), env)
    run = partial(hrljax.sweep, env, seeds=1, num_episodes=2, mapping="vmap", progress=False, store=tmp_path / "x.zarr")
    run(hrljax.OptionQ(options))
    run(hrljax.OptionQ(hrljax.options_from(env.hierarchy(), env)))
    for field in ("policy", "termination", "initiation"):
        array = getattr(options, field).copy()
        array[0, 1] = 1 - array[0, 1]
        other = dataclasses.replace(options, **{field: array})
        assert repr(other) == repr(options)
        with pytest.raises(ValueError, match=r"another sweep: digest.learner.options is .* there and .* here$"):
            run(hrljax.OptionQ(other))


def test_something_else_is_left_alone(tmp_path: Path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "chapter").write_text("one")
    hrljax.save(sweep(), tmp_path / "saved.zarr")
    before = contents(tmp_path)
    for name in ("file", "folder", "saved.zarr"):
        with pytest.raises(FileExistsError, match=f"{name} exists and was not written by .*it is left alone"):
            sweep(store=tmp_path / name)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("file/x.zarr", r"Not a directory\): .*file is a file"),
        ("file/below/x.zarr", r"Not a directory\): .*file is a file"),
        ("new/" + "x" * 300, r"File name too long\): its folder cannot be made"),
        ("locked/new/x.zarr", r"Permission denied\): its folder cannot be made"),
    ],
)
def test_a_store_that_cannot_be_made_is_an_error_before_compilation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str, reason: str
):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "locked").mkdir()
    before, mkdir = contents(tmp_path), os.mkdir

    def guarded(path: Any, *arguments: Any) -> None:
        if Path(path).name == "x.zarr" and "locked" in Path(path).parts and Path(path).parent.exists():
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))  # root may do everything
        mkdir(path, *arguments)

    monkeypatch.setattr(os, "mkdir", guarded)
    monkeypatch.setattr("hrljax.engine.batch.compile_mapped", lambda *_: pytest.fail("the sweep went on to compile"))
    with pytest.raises(OSError, match=rf"the store cannot be (written|opened) \({reason}.*: '{tmp_path / place}'"):
        sweep(store=tmp_path / place, seeds=7)
    assert contents(tmp_path) == before


def test_a_name_that_is_too_long_is_an_error(tmp_path: Path):
    with pytest.raises(OSError, match=r"the store cannot be .* \(File name too long\).*xxxx'"):
        sweep(store=tmp_path / ("x" * 300))


def test_a_full_disk_costs_no_finished_chunk(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The disk is full in the middle of the fourth chunk."""
    path, write = tmp_path / "x.zarr", files.write_atomically

    def fills_up(file: Path, content: bytes) -> None:
        if len(chunk_files(path)) == 4 * 3 + 2:
            monkeypatch.setattr(os, "fsync", full)
        write(file, content)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("hrljax.sweeps.store.write_atomically", fills_up)
        with pytest.raises(
            OSError, match=r"cannot be written \(No space left on device\); its finished chunks are"
        ) as found:
            sweep(store=path, cores=1)
    monkeypatch.undo()
    assert found.value.errno == errno.ENOSPC
    assert not list(path.rglob("*.partial"))
    assert len(chunk_files(path)) == 4 * 3 + 2
    kept = hrljax.load(path)
    assert kept["return"].notnull().all("episode").sum() in (5, 6)
    counted = Counted(monkeypatch)
    sweep(store=path)
    assert len(counted.chunks) == 3
    assert contents(path) == contents(whole)


def test_one_process_at_a_time(copy: Path):
    pytest.importorskip("fcntl")
    import fcntl

    descriptor = os.open(copy, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        with pytest.raises(BlockingIOError, match="another process writes it"):
            sweep(store=copy)
    finally:
        os.close(descriptor)
    sweep(store=copy)


def test_what_another_process_has_just_written_is_not_overwritten(copy: Path, monkeypatch: pytest.MonkeyPatch):
    """It made more seeds between this one's look at the store and its lock."""
    pytest.importorskip("fcntl")
    import fcntl

    lock = fcntl.flock

    def after_another(*arguments: Any) -> None:
        monkeypatch.setattr(fcntl, "flock", lock)
        sweep(store=copy, seeds=7)
        lock(*arguments)

    monkeypatch.setattr(fcntl, "flock", after_another)
    with pytest.raises(BlockingIOError, match="another process has just written it"):
        sweep(store=copy)
    assert hrljax.load(copy).sizes["seed"] == 7


def test_an_interrupted_sweep_is_continued(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path, write = tmp_path / "x.zarr", Store.write
    chunks: list[range] = []

    def interrupted(store: Store, chunk: range, values: Any) -> None:
        chunks.append(chunk)
        if len(chunks) == 3:
            raise KeyboardInterrupt
        write(store, chunk, values)

    monkeypatch.setattr(Store, "write", interrupted)
    kept = sweep(store=path, cores=1)  # with two, all chunks may have begun
    assert len(set(chunks)) == 4
    assert (kept.attrs["complete"], hrljax.load(path).attrs["complete"]) == (0, 0)
    xr.testing.assert_equal(hrljax.load(path), kept)
    assert 0 < int(np.isnan(kept["steps"]).sum()) < 10
    sweep(store=path)
    assert contents(path) == contents(whole)
