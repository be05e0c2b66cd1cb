"""How the programs in scripts/ check their options and end."""

import json
import re
import runpy
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from hrljax.experiments import program


@dataclass(frozen=True)
class Options:
    runs: int = 3
    key: int = 0
    cores: int | None = None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (Options(runs=0), "--runs must be an integer from 1 to 2147483647, got 0"),
        (Options(key=-1), "--key must be an integer from 0 to 2147483647, got -1"),
        (Options(cores=0), "--cores must be an integer from 1 to 2147483647, got 0"),
    ],
)
def test_counts_are_checked_by_the_names_that_users_know(options: Options, message: str):
    with pytest.raises(ValueError, match=message):
        program.check_counts(options, "runs")
    program.check_counts(Options(cores=2), "runs")


@pytest.mark.parametrize("error", [ValueError("--runs is odd"), OSError("disk full")])
def test_an_error_of_the_users_ends_with_a_message(error: Exception, monkeypatch: pytest.MonkeyPatch):
    def fails(options: Options) -> int:
        raise error

    monkeypatch.setattr("sys.argv", ["program", "--runs", "5"])
    with pytest.raises(SystemExit, match=f"^error: {error}$"):
        program.run(fails, Options)


def test_a_program_ends_with_what_it_returns(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["program", "--runs", "5"])
    with pytest.raises(SystemExit) as ended:
        program.run(lambda options: options.runs, Options)
    assert ended.value.code == 5


def test_the_last_words_tell_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert program.ended(tmp_path) == 0
    said = capsys.readouterr()
    assert str(tmp_path) in said.out
    assert not said.err
    assert program.ended(tmp_path, complete=False) == 130
    assert "interrupted" in capsys.readouterr().err


def test_a_summary_is_json(tmp_path: Path):
    program.write_summary(tmp_path, [{"a": None}])
    assert json.loads((tmp_path / "summary.json").read_text()) == [{"a": None}]


@pytest.mark.parametrize(
    ("name", "package"), [("bus", "numba"), ("mario_planner", "numba"), ("mario_trees", "sklearn")]
)
def test_a_benchmark_without_its_extra_ends_with_a_sentence(
    name: str, package: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setitem(sys.modules, package, None)  # as if it were not installed
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / f"{name}.py"), run_name="__main__")
    assert ended.value.code == 2
    assert re.fullmatch(
        rf"error: this program needs .*{package}.*: pip install -e '\.\[bench\]' .*\n", capsys.readouterr().err
    )
