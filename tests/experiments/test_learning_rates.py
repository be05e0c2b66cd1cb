"""`scripts/learning_rates.py` as a program, and its numbers by hand."""

import csv
import json
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import hrljax
from hrljax.experiments import learning_rates
from hrljax.experiments.learning_rates import best, comparisons, measured, setting_row, setting_rows
from tests.curves import EPISODES

SCRIPT = Path(__file__).parents[2] / "scripts" / "learning_rates.py"


def call(monkeypatch: pytest.MonkeyPatch, *options: object) -> object:
    """Exit status of the script, run in this process."""
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *map(str, options)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(SCRIPT), run_name="__main__")
    return ended.value.code


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a run on the Maze writes."""
    out = tmp_path_factory.mktemp("learning_rates") / "new" / "folder"
    with pytest.MonkeyPatch.context() as patch:
        options = ["--domains", "Maze", "--seeds", 3, "--scale", 0.12, "--cores", 1, "--out", out]
        code = call(patch, *options, "--step-sizes", 0.1, 0.5, "--pseudo-rewards", 0, 20)
    assert code == 0
    return out


@pytest.mark.slow
def test_it_writes_pictures_a_table_and_stores(written: Path):
    pictures = ["heat_maps.png", "intervals.png", "sensitivity.png"]
    expected = ["heat_maps.png", "intervals.png", "learning_rates.csv", "sensitivity.png", "stores", "summary.json"]
    assert sorted(path.name for path in written.iterdir()) == expected
    for name in pictures:
        assert (written / name).read_bytes().startswith(b"\x89PNG")
        assert (written / name).stat().st_size > 10_000
    learners = ["HORDQ", "MAXQ-Q", "Q-learning", "SARSA(0)", "shared HORDQ"]
    assert sorted(path.name for path in (written / "stores").iterdir()) == [f"Maze-{name}.zarr" for name in learners]


@pytest.mark.slow
def test_its_summary_and_its_csv_are_those_of_its_stores(written: Path):
    summary = json.loads((written / "summary.json").read_text())
    assert set(summary) == {"exact", "best", "comparisons"}
    exact = summary["exact"]["Maze"]
    assert exact["random"] < exact["epsilon_soft"] < exact["optimal"] < 0
    assert [row["learner"] for row in summary["best"]] == [
        "Q-learning",
        "SARSA(0)",
        "MAXQ-Q",
        "HORDQ",
        "shared HORDQ",
    ]
    assert [row["second"] for row in summary["comparisons"]] == ["Q-learning", "SARSA(0)", "MAXQ-Q", "shared HORDQ"]
    with (written / "learning_rates.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) == 2 + 2 + 4 + 4 + 2
    for row in summary["best"]:
        store = hrljax.load(written / "stores" / f"Maze-{row['learner']}.zarr")
        assert store.attrs["learner"] == row["learner"]
        assert store["step_size"].values.tolist() == [0.1, 0.5]
        means = store["mean_return"].mean("seed")
        assert row["mean_return"]["mean"] == pytest.approx(float(means.max()))
        own = [line for line in rows if line["learner"] == row["learner"]]
        found = [float(line["mean_return"]) for line in own]
        np.testing.assert_allclose(found, means.values.ravel(), rtol=1e-5)
        assert {line["pseudo_reward"] for line in own} == ({""} if row["pseudo_reward"] is None else {"0", "20"})
        assert row["seeds"] == 3
        assert row["steps_per_second"] > 0


@pytest.mark.slow
def test_its_numbers_are_those_of_one_sweep_over_both_axes(written: Path):
    (maze,) = (domain for domain in learning_rates.domains() if domain.name == "Maze")
    axes = {"step_size": [0.1, 0.5], "pseudo_reward": [0.0, 20.0]}
    learner = maze.learners()["HORDQ"]
    whole = hrljax.sweep(
        maze.env, learner, seeds=3, num_episodes=12, axes=axes, bin_size=1, params=maze.params, cores=1, progress=False
    )
    store = hrljax.load(written / "stores" / "Maze-HORDQ.zarr")
    expected = measured(whole, learning_rates.exact(maze))
    xr.testing.assert_equal(store, expected.transpose("step_size", ...))


@pytest.mark.parametrize(("before", "learners"), [(0, []), (3, ["Q-learning"])])
def test_an_interrupted_run_writes_what_was_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: int, learners: list[str]
):
    calls = iter(range(before))

    def interrupted(*arguments: object, **options: object) -> xr.Dataset:
        if next(calls, None) is None:
            raise KeyboardInterrupt
        return hrljax.sweep(*arguments, **options)

    monkeypatch.setattr(learning_rates, "sweep", interrupted)
    options = ["--domains", "Maze", "Taxi", "--seeds", 3, "--scale", 0.12, "--cores", 1, "--out", tmp_path]
    code = call(monkeypatch, *options, "--step-sizes", 0.1, 0.5, "--pseudo-rewards", 0, 20)
    assert code == 130
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [row["learner"] for row in summary["best"]] == learners
    assert (tmp_path / "intervals.png").exists() == bool(learners)


def results() -> xr.Dataset:
    """Two step sizes, two seeds; bins of 10 episodes, the last of 5."""
    values = np.array([[[-9.0, -8, -7, -6, -5], [-9, -9, -9, -9, -9]], [[-9, -6, -3, -2, -1], [np.nan] * 5]])
    coordinates = {"step_size": [0.1, 0.5], "seed": [0, 1], "episode": EPISODES}
    steps = np.array([[100.0, 200.0], [300.0, np.nan]])
    variables = {"return": (("step_size", "seed", "episode"), values), "steps": (("step_size", "seed"), steps)}
    return xr.Dataset(variables, coordinates, {"seconds": 2.0, "compile_seconds": 1.0})


def test_numbers_of_a_run_by_hand():
    found = measured(results(), {"random": -11.0, "epsilon_soft": -2.0})  # the threshold is -6.5
    np.testing.assert_allclose(found["mean_return"], [[-325 / 45, -9], [-205 / 45, np.nan]])
    np.testing.assert_allclose(found["final_return"], [[-5, -9], [-1, np.nan]])
    np.testing.assert_array_equal(found["episodes_to_reach"], [[45, np.inf], [30, np.nan]])
    np.testing.assert_allclose(found["curve"].sel(step_size=0.5), results()["return"][1, 0])
    assert best(found) == {"step_size": 0.5}
    assert [row["step_size"] for row in setting_rows("Maze", "SARSA(0)", found)] == [0.1, 0.5]
    row = setting_row("Maze", "SARSA(0)", found, {"step_size": 0.5})
    assert row["mean_return"] == {"mean": pytest.approx(-205 / 45), "lo": None, "hi": None}
    assert (row["reached"], row["episodes_to_reach"], row["seeds"], row["pseudo_reward"]) == (1, 30, 1, None)
    other = setting_row("Maze", "SARSA(0)", found, {"step_size": 0.1})
    assert (other["reached"], other["episodes_to_reach"], other["seeds"]) == (0.5, None, 2)


def test_comparisons_are_of_the_best_settings():
    found = measured(results().isel(step_size=[0]), {"random": -10.0, "epsilon_soft": -2.0})
    better = found.assign(mean_return=found["mean_return"] + 1)
    (row,) = comparisons("Maze", {"Q-learning": found, "HORDQ": better})
    assert (row["first"], row["second"]) == ("HORDQ", "Q-learning")
    assert row["paired_difference"]["mean"] == pytest.approx(1)
    assert row["probability_of_improvement"]["mean"] == 0.75
    assert comparisons("Maze", {"Q-learning": found}) == []


def test_what_random_actions_and_good_ones_are_worth():
    for domain in learning_rates.domains():
        values = learning_rates.exact(domain)
        assert -200 * 11 < values["random"] < values["epsilon_soft"] < values["optimal"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seeds", 0], "--seeds must be an integer from 1 to 2147483647, got 0"),
        (["--cores", 0], "--cores must be an integer from 1 to 2147483647, got 0"),
        (["--key", -1], "--key must be an integer from 0 to 2147483647, got -1"),
        (["--scale", 0], r"--scale must be a finite number in \(0, 1000\), got 0.0"),
        (["--domains", "Mase"], "--domains must be among Maze, Taxi, Bus, got 'Mase'"),
        (["--step-sizes", 0.5, 0.5], "--step-sizes must be at least one and different, got 0.5 0.5"),
        (["--step-sizes", 0.5, 1.5], r"--step-sizes must be a finite number in \(0, 1\], got 1.5"),
        (["--step-sizes"], "--step-sizes must be at least one and different, got none"),
        (["--pseudo-rewards", "inf"], "--pseudo-rewards must be a finite number in .*, got inf"),
    ],
    ids=str,
)
def test_a_bad_option_is_one_line_of_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[object], message: str
):
    code = call(monkeypatch, "--out", tmp_path / "out", *options)
    assert isinstance(code, str)
    assert re.fullmatch(f"error: {message}", code), code
    assert not (tmp_path / "out").exists()
