"""How the programs in scripts/ check their options and end."""

import json
import re
import runpy
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from hrljax.experiments import program

SCRIPTS = Path(__file__).parents[2] / "scripts"


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


def test_the_last_words_tell_where_results_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert program.ended(tmp_path) == 0
    assert program.ended(status=1) == 1
    said = capsys.readouterr()
    assert said.out == f"\nwritten to {tmp_path}\n"
    assert not said.err


STOPPING = "stopping; interrupt again to stop at once"
KEPT = "interrupted: {} kept in out, the last one as far as it came"
ENDS = {
    "before": (130, [STOPPING, "interrupted: no result was finished"]),
    "between": (130, [STOPPING, "result 1", "all is written", KEPT.format("1 result is")]),
    "terminated": (143, [STOPPING, "result 1", "all is written", KEPT.format("1 result is")]),
    "in a destructor": (130, [STOPPING, "result 1", "all is written", KEPT.format("1 result is")]),
    "as another error": (130, [STOPPING, "result 1", "all is written", KEPT.format("1 result is")]),
    "with a result": (130, [STOPPING, "result 1", "result 2", "all is written", KEPT.format("2 results are")]),
    "afterwards": (130, [STOPPING, "result 1", "result 2", "result 3", "all is written", KEPT.format("3 results are")]),
    "twice": (130, [STOPPING, "interrupted twice: stopped at once", "result 1", "before the second"]),
    "full disk": (1, [STOPPING, "error: the disk is full"]),
}


def test_an_interrupt_ends_a_program_with_what_was_finished(ends: dict[str, dict[str, Any]]):
    """Whenever it comes, and whatever Python makes of it."""
    for case, (status, lines) in ENDS.items():
        assert ends[case]["status"] == status, case
        assert set(lines) <= set(ends[case]["lines"]), case
        assert not [line for line in ends[case]["lines"] if "Traceback" in line], case
        assert ("all is written" in ends[case]["lines"]) == ("all is written" in lines), case


def test_an_error_without_an_interrupt_has_a_traceback(ends: dict[str, dict[str, Any]]):
    error = ends["own error"]
    assert error["status"] == 1
    assert error["lines"][-1] == "RuntimeError: not made of an interrupt"


@pytest.fixture(scope="module")
def ends() -> dict[str, dict[str, Any]]:
    """Of every case in `interrupt_program.py`: its status, and the lines that it printed."""
    cases = [*ENDS, "own error"]
    command = [sys.executable, Path(__file__).parents[1] / "interrupt_program.py", *cases]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return dict(zip(cases, map(json.loads, printed.splitlines()), strict=True))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_during_imports_is_quiet(number: signal.Signals):
    text = f"import signal, interruptible; signal.raise_signal({int(number)}); print('alive')"
    text = f"import signal; signal.signal({int(number)}, signal.default_int_handler); {text}"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, cwd=SCRIPTS)
    assert (done.returncode, done.stdout) == (128 + number, "")
    assert done.stderr == "\ninterrupted: nothing was begun\n"


@pytest.mark.parametrize("script", sorted(SCRIPTS.glob("*.py")), ids=lambda path: path.name)
def test_every_program_takes_interrupts_before_it_imports_what_takes_long(script: Path):
    imports = re.findall(r"^(?:from|import) (\w+)", script.read_text(), re.MULTILINE)
    others = [name for name in imports if name not in sys.stdlib_module_names]
    assert others[:1] == ["interruptible"] or script.name == "interruptible.py"


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
        runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / f"{name}.py"), run_name="__main__")
    assert ended.value.code == 2
    assert re.fullmatch(
        rf"error: this program needs .*{package}.*: pip install -e '\.\[bench\]' .*\n", capsys.readouterr().err
    )
