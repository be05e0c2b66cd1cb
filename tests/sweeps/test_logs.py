"""What a sweep tells while it runs: datasets of finished runs, CSV files, events of TensorBoard."""

import csv
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import hrljax as hrl
from tests.maps import SMALL

AXES = {"step_size": [0.5, 0.125]}
OPTIONS: dict[str, Any] = {"seeds": 3, "num_episodes": 6, "bin_size": 4, "chunk_size": 2, "progress": False}


def swept(**options: Any) -> xr.Dataset:
    return hrl.sweep(SMALL, hrl.QLearning(), axes=AXES, **{**OPTIONS, **options})


def check_runs(told: list[xr.Dataset], curves: xr.Dataset) -> None:
    """Raises unless datasets of finished runs tell of every run of a sweep once, and what it gave."""
    runs = xr.concat(told, "run")
    settings = list(zip(runs["step_size"].values.tolist(), runs["seed"].values.tolist(), strict=True))
    assert sorted(settings) == [(size, seed) for size in sorted(AXES["step_size"]) for seed in range(3)]
    for number, (size, seed) in enumerate(settings):
        for name, values in curves.sel(step_size=size, seed=seed).data_vars.items():
            np.testing.assert_array_equal(runs[name].isel(run=number), values)
    assert runs["episode"].values.tolist() == [4, 6]


def test_every_run_is_told_of_once():
    told: list[xr.Dataset] = []
    curves = swept(callback=told.append, keep_learned=True)
    assert len(told) == 3
    check_runs(told, curves)


def test_runs_that_a_store_has_come_first(tmp_path: Path):
    swept(store=tmp_path / "store", seeds=2)
    told: list[xr.Dataset] = []
    curves = swept(store=tmp_path / "store", callback=told.append)
    assert told[0]["seed"].values.tolist() == [0, 1, 0, 1]
    check_runs(told, curves)


def test_an_error_of_the_callback_ends_the_sweep_and_the_store_has_the_chunk(tmp_path: Path):
    def fail(runs: xr.Dataset) -> None:
        raise RuntimeError("no space")

    with pytest.raises(RuntimeError, match="no space"):
        swept(store=tmp_path / "store", callback=fail)
    assert hrl.load(tmp_path / "store")["steps"].notnull().any()
    with pytest.raises(TypeError, match="callback must be a function of a dataset of finished runs"):
        swept(callback="curves.csv")


def test_a_csv_file_has_a_line_a_bin(tmp_path: Path):
    path = tmp_path / "logs" / "curves.csv"
    for _ in range(2):  # the second file replaces the first
        curves = swept(callback=hrl.CSVLog(path))
    with path.open() as file:
        lines = list(csv.DictReader(file))
    assert list(lines[0]) == ["step_size", "seed", "episode", "return", "length", *SMALL.metrics, "truncated"]
    assert len(lines) == 2 * 3 * 2
    for line in lines:
        at = {"step_size": float(line["step_size"]), "seed": int(line["seed"]), "episode": int(line["episode"])}
        assert float(line["return"]) == curves["return"].sel(at)
        assert float(line["truncated"]) == curves["truncated"].sel(at)


def events(folder: Path) -> Iterator[tuple[str, int, float]]:
    """Scalars in the file of a run: name, step, value. A record is a length, a checksum, bytes, a checksum."""
    from tensorboardX.proto.event_pb2 import Event

    (file,) = folder.iterdir()
    content = file.read_bytes()
    while content:
        (length,) = struct.unpack("<Q", content[:8])
        event = Event.FromString(content[12 : 12 + length])
        yield from ((value.tag, event.step, value.simple_value) for value in event.summary.value)
        content = content[16 + length :]


def test_tensorboard_has_a_folder_a_run_and_a_scalar_a_variable(tmp_path: Path):
    pytest.importorskip("tensorboardX")
    curves = swept(callback=hrl.TensorBoardLog(tmp_path / "events"), num_steps=1)
    names = {f"step_size={size:g},seed={seed}" for size in AXES["step_size"] for seed in range(3)}
    assert {folder.name for folder in (tmp_path / "events").iterdir()} == names
    of_run = list(events(tmp_path / "events" / "step_size=0.125,seed=2"))
    run = curves.sel(step_size=0.125, seed=2).isel(episode=0)  # a step more ends the run: the second bin is NaN
    variables = ["return", "length", *SMALL.metrics, "truncated"]
    assert sorted(of_run) == sorted((name, 4, float(np.float32(run[name]))) for name in variables)
    with pytest.raises(FileExistsError, match="is no empty folder"):
        hrl.TensorBoardLog(tmp_path / "events")
