"""`scripts/neighbours.py` as a program, its numbers by hand, and every learner on every domain that is small."""

import json
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import hrljax
from hrljax.experiments import neighbour_learners, neighbours

SCRIPT = Path(__file__).parents[2] / "scripts" / "neighbours.py"
ROOTS = ["model", "linear", "RL-DT"]


def call(monkeypatch: pytest.MonkeyPatch, *options: object) -> object:
    """Exit status of the script, run in this process."""
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *map(str, options)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(SCRIPT), run_name="__main__")
    return ended.value.code


def test_it_writes_a_picture_a_table_and_a_summary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Dyna-Q reaches 95 % on the Maze in 60 episodes, in fewer steps than Q-learning has needed then."""
    learners = ["Q-learning", "Dyna-Q", "shared HORDQ, model root"]
    options = ["--domains", "Maze", "--seeds", 8, "--scale", 0.3, "--cores", 1, "--out", tmp_path]
    assert call(monkeypatch, *options, "--learners", *learners) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["neighbours.md", "neighbours.png", "summary.json"]
    assert (tmp_path / "neighbours.png").read_bytes().startswith(b"\x89PNG")
    table = (tmp_path / "neighbours.md").read_text()
    assert table in capsys.readouterr().out
    summary = json.loads((tmp_path / "summary.json").read_text())
    exact = summary["exact"]["Maze"]
    assert exact["optimal"] == pytest.approx(-6.7857, abs=1e-4)
    assert exact["threshold"] == pytest.approx(0.95 * exact["optimal"] + 0.05 * exact["random"])
    q, dyna = summary["rows"]  # the maze has no abstraction for a root that plans
    assert (q["learner"], dyna["learner"]) == ("Q-learning", "Dyna-Q")
    assert (q["seeds"], q["episodes"]) == (8, 60)
    assert dyna["reached"] == 1 > q["reached"]
    assert 100 < dyna["steps_to_reach"]["lo"] <= dyna["steps_to_reach"]["median"] <= dyna["steps_to_reach"]["hi"]
    assert dyna["regret"]["hi"] < q["regret"]["lo"]
    assert dyna["final_return"] > q["final_return"]
    assert (q["memory"], dyna["memory"]) == (42 * 3 * 4, 42 * 3 * 4 * 5 + 4)
    assert all(row["seconds"] > 0 < row["microseconds_per_step"] for row in (q, dyna))
    assert [line.split(" | ")[1] for line in table.splitlines()[2:]] == ["Q-learning", "Dyna-Q"]


def test_steps_to_reach_by_hand(monkeypatch: pytest.MonkeyPatch):
    """Bins of 5 episodes, the last of 2; the average of two bins has to be at least -4."""
    monkeypatch.setattr(neighbours, "_WINDOW", 2)
    returns = [[-9.0, -5.0, -3.0, -1.0], [-9.0, -8.0, -7.0, -6.0], [-2.0, -4.0, -9.0, -9.0]]
    lengths = [[10.0, 6.0, 4.0, 2.0], [10.0] * 4, [3.0] * 4]
    dims = ("seed", "episode")
    dataset = xr.Dataset(
        {"return": (dims, returns), "length": (dims, lengths)}, {"episode": [5, 10, 15, 17], "seed": range(3)}
    )
    reached = neighbours.steps_to_reach(dataset, -4.0)
    assert reached.values.tolist() == [5 * (10 + 6 + 4), np.inf, 5 * (3 + 3)]
    dataset["steps"] = ("seed", [104, 170, 51])
    row = neighbours.row("Maze", "a", dataset, reached, -1.0, seconds=3.25, memory=500)
    losses = [5 * (8 + 4 + 2), 5 * (8 + 7 + 6) + 2 * 5, 5 * (1 + 3 + 8) + 2 * 8]
    assert row["regret"]["mean"] == pytest.approx(np.mean(losses))
    assert row["steps_to_reach"]["median"] == 100
    assert row["steps_to_reach"]["hi"] is None
    assert row["reached"] == pytest.approx(2 / 3)
    assert row["seconds"] == pytest.approx(3.25 / 3)
    assert row["microseconds_per_step"] == pytest.approx(1e6 * 3.25 / 325)
    assert row["final_return"] == pytest.approx((-1 - 6 - 9) / 3)
    line = neighbours.table([row]).splitlines()[-1]
    assert re.fullmatch(r"\| Maze \| a \| 100 \[\d+, never\] \| 67% \| .* \| -5.3 \| 1.1 \| 0 \|", line)


@pytest.mark.parametrize("name", neighbour_learners.LEARNERS)
def test_every_learner_is_made_for_the_domains_that_it_is_for(name: str):
    domains = neighbour_learners.domains()
    made = {domain: neighbour_learners.LEARNERS[name](domains[domain]) for domain in ("Maze", "Taxi")}
    nowhere = ["KWIK-R-MAX", *(f"shared HORDQ, {root} root" for root in ROOTS)]
    applies = {"feudal Q-learning": {"Maze"}, **{key: set() for key in nowhere}}
    assert {domain for domain, learner in made.items() if learner} == applies.get(name, made.keys())
    for domain, learner in made.items():
        if learner is not None:
            learner.prepare(domains[domain].env)


def test_what_is_for_chance_is_for_the_domains_with_chance():
    made = {name: neighbour_learners.LEARNERS["KWIK-R-MAX"](of) for name, of in neighbour_learners.domains().items()}
    assert {name for name, learner in made.items() if learner} == {"stochastic Taxi", "Bus"}


@pytest.mark.parametrize("root", ROOTS)
def test_a_root_that_plans_is_for_the_bus(root: str):
    """Elsewhere it has no abstraction, or no choice."""
    learner = neighbour_learners.LEARNERS[f"shared HORDQ, {root} root"](neighbour_learners.domains()["Bus"])
    assert isinstance(learner, hrljax.SharedHORDQ)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--domains", "Mars"], "--domains must be one of 'Maze', 'Four rooms'"),
        (["--learners", "Q-learning", "Q-learning"], "--learners must be at least one and different"),
        (["--seeds", "0"], "--seeds must be an integer from 1"),
        (["--scale", "0"], "--scale must be"),
    ],
)
def test_wrong_options_are_refused(options: list[str], message: str, monkeypatch: pytest.MonkeyPatch):
    assert message in str(call(monkeypatch, *options))
