"""Scripts as programs: what they write, and how they refuse bad options."""

import csv
import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import hrljax

ROOT = Path(__file__).parents[1]
FIGURE_4_2 = ROOT / "scripts" / "figure_4_2.py"


@pytest.mark.slow
def test_figure_4_2_writes_its_picture_its_table_and_its_summary(tmp_path: Path):
    """The only whole run: about half a minute, nearly all of it compilation of sixteen curves."""
    out = tmp_path / "new" / "folder"
    options = ["--seeds", "2", "--episodes", "400", "--out", str(out), "--cores", "1"]
    done = subprocess.run([sys.executable, FIGURE_4_2, *options], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr

    assert (out / "figure_4_2.png").read_bytes().startswith(b"\x89PNG")
    summary = json.loads((out / "summary.json").read_text())
    assert set(summary) == {"exact", "curves"}
    exact = summary["exact"]
    assert exact.pop("optimal") == pytest.approx({"none": -22.14, "A": -24.08, "B": -27.53, "mean": -24.59}, abs=0.01)
    expected = {"blind": -46.99, "avoid": -35.75, "no_sites": -19.90, "epsilon_soft": -27.75}
    assert exact == pytest.approx(expected, abs=0.01)

    planned = ["HORDQ(0)", "HORDQ(5)", "HORDQ(60)", "HORDQ(5 to 0)", "MAXQ(60)", "shared, fading"]
    by_panel = {panel: [c["name"] for c in summary["curves"] if c["panel"] == panel] for panel in ("model", "random")}
    assert by_panel == {"model": planned, "random": planned}
    assert [c["name"] for c in summary["curves"] if c["panel"] == "both"] == ["SARSA(0)", "Q-learning"]
    assert len({c["panel"] for c in summary["curves"]}) == 4
    keys = {"name", "panel", "mean_return", "ci95", "bins", "damage_per_episode", "steps_per_second", "seconds"}
    for entry in summary["curves"]:
        assert keys <= set(entry)
        assert entry["ci95"][0] < entry["mean_return"] < entry["ci95"][1]
        assert -1000 < entry["mean_return"] < -20
        assert [(b["from"], b["to"]) for b in entry["bins"]] == [(0, 400)]
        assert all(b["lo"] < b["mean"] < b["hi"] for b in entry["bins"])
        assert 0 < entry["damage_per_episode"] <= 1
        assert entry["steps_per_second"] > 0
        assert (entry["seeds"], entry["episodes"]) == (2, 400)

    with (out / "figure_4_2.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert list(rows[0]) == ["panel", "curve", "variable", "episode", "mean", "low", "high"]
    assert len({(row["panel"], row["curve"]) for row in rows}) == len(summary["curves"])
    returns = {(row["panel"], row["curve"]): float(row["mean"]) for row in rows if row["variable"] == "return"}
    for entry in summary["curves"]:
        assert returns[entry["panel"], entry["name"]] == pytest.approx(entry["mean_return"], rel=1e-5)

    stores = sorted((out / "curves").iterdir())
    assert len(stores) == len(summary["curves"])
    curve = hrljax.load(stores[0])
    assert curve.attrs["curve"] == summary["curves"][0]["name"]
    assert float(curve["return"].mean()) == pytest.approx(summary["curves"][0]["mean_return"])
    assert sorted(path.name for path in out.iterdir()) == ["curves", "figure_4_2.csv", "figure_4_2.png", "summary.json"]
    for text in ("(a) model-based root", "(b) random root", "HORDQ(5 to 0)", "optimum -24.59", str(out)):
        assert text in done.stdout
    assert all(len(line) < 160 for line in done.stdout.splitlines())


def refusal(monkeypatch: pytest.MonkeyPatch, *options: str) -> object:
    """Exit status of the script, run in this process."""
    monkeypatch.setattr(sys, "argv", [str(FIGURE_4_2), *options])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(FIGURE_4_2), run_name="__main__")
    return ended.value.code


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seeds", "-1"], "--seeds must be an integer from 1 to 2147483647, got -1"),
        (["--seeds", "0"], "--seeds must be an integer from 1 to 2147483647, got 0"),
        (["--episodes", "0"], "--episodes must be an integer from 1 to 2147483647, got 0"),
        (["--cores", "0"], "--cores must be an integer from 1 to 2147483647, got 0"),
        (["--key", "-5"], "(--)?key must be .*an integer .*got -5"),
    ],
    ids=str,
)
def test_a_bad_number_is_one_line_of_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], message: str
):
    code = refusal(monkeypatch, "--out", str(tmp_path / "out"), *options)
    assert isinstance(code, str)
    assert re.fullmatch(f"error: {message}", code), code
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [["--sedes", "3"], ["--seeds", "many"], ["--mapping", "gpu"]], ids=str)
def test_an_option_that_cannot_be_read_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], options: list[str]
):
    assert refusal(monkeypatch, "--out", str(tmp_path / "out"), *options) == 2
    assert options[0] in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_file_in_the_place_of_the_folder_is_told_by_the_program(tmp_path: Path):
    (tmp_path / "file").write_text("mine")
    options = ["--seeds", "2", "--episodes", "5", "--out", str(tmp_path / "file")]
    done = subprocess.run([sys.executable, FIGURE_4_2, *options], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert str(tmp_path / "file") in done.stderr
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.slow
def test_three_kinds_of_optimality_and_what_was_reached(tmp_path: Path):
    script, out = FIGURE_4_2.with_name("optimality.py"), tmp_path / "runs"
    options = ["--seeds", "5", "--domains", "Maze", "--out", str(out)]
    done = subprocess.run([sys.executable, script, *options], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in out.iterdir()} == {"maze.png", "task_graph.png", "optimality.csv", "summary.json"}
    summary = json.loads((out / "summary.json").read_text())
    (exact,) = summary["exact"]
    assert exact["hierarchically_optimal"] == pytest.approx(-6.7857, abs=1e-4)
    assert exact["recursively_optimal"] == pytest.approx(-7.0714, abs=1e-4)
    reached = {row["learner"]: row["greedy"]["mean"] for row in summary["reached"]}
    assert reached["HORDQ"] == pytest.approx(exact["hierarchically_optimal"], abs=1e-3)
    assert reached["MAXQ-Q"] < exact["hierarchically_optimal"] - 0.2
    assert "recursively optimal" in done.stdout


@pytest.mark.slow
def test_how_good_advice_has_to_be(tmp_path: Path):
    script, out = FIGURE_4_2.with_name("advice_quality.py"), tmp_path / "runs"
    options = ["--seeds", "2", "--scale", "0.005", "--cores", "1", "--out", str(out)]
    done = subprocess.run([sys.executable, script, *options], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in out.iterdir()} == {"advice_quality.png", "summary.json"}
    assert (out / "advice_quality.png").read_bytes().startswith(b"\x89PNG")
    summary = json.loads((out / "summary.json").read_text())
    assert set(summary) == {"worth", "runs", "break_even"}
    worths = [row["worth"] for row in summary["worth"]]
    assert len(worths) == 8
    assert worths == sorted(worths, reverse=True)
    learners = list(dict.fromkeys(row["learner"] for row in summary["runs"]))
    assert len(summary["runs"]) == 8 * len(learners)
    assert set(summary["break_even"]) == {name for name in learners if not name.endswith("(0)")}
    assert all(row["gain"]["mean"] == 0 for row in summary["runs"] if row["pseudo_reward"] == 0)
    for text in (*learners, "worth of the root", str(out)):
        assert text in done.stdout
    assert all(len(line) < 160 for line in done.stdout.splitlines())


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("optimality", ["--domains", "Moon"], "--domains must be among Maze, Taxi, Bus, got 'Moon'"),
        ("optimality", ["--scale", "0"], r"--scale must be a finite number in \(0, 1000\), got 0.0"),
        ("advice_quality", ["--seeds", "0"], "--seeds must be an integer from 1 to 2147483647, got 0"),
        ("advice_quality", ["--scale", "nan"], r"--scale must be a finite number in \(0, 1000\), got nan"),
    ],
    ids=str,
)
def test_a_bad_option_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, options: list[str], message: str
):
    script = FIGURE_4_2.with_name(f"{name}.py")
    monkeypatch.setattr(sys, "argv", [str(script), "--out", str(tmp_path / "out"), *options])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(script), run_name="__main__")
    assert re.fullmatch(f"error: {message}", str(ended.value.code))
    assert not (tmp_path / "out").exists()
