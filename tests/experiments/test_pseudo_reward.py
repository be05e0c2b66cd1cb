"""The comparison of pseudo-rewards: what it runs, what is best in hindsight, and what the script writes."""

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import hrljax as hrl
from hrljax.experiments import pseudo_reward
from hrljax.experiments.random_tasks import random_task

SCRIPT = Path(__file__).parents[2] / "scripts" / "pseudo_reward.py"
FIXED = (0, 1, 2, 5, 10, 20, 60)
RULES = {
    "Q-learning",
    "SARSA(0)",
    "MAXQ-Q(60)",
    *(f"{values}, {rule}" for values in ("shared", "apart") for rule in (*FIXED, "5 to 0", "fading")),
    "shared, fading, all active",
}
NUM_RULES = 3 + 2 * 7 + 2 * 2 + 1


def call(patch: pytest.MonkeyPatch, *options: object) -> object:
    """Exit status of the script, run in this process."""
    patch.setattr(sys, "argv", [str(SCRIPT), *map(str, options)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(SCRIPT), run_name="__main__")
    return ended.value.code


@pytest.mark.slow
def test_the_script_writes_a_row_for_every_rule_and_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    options = ["--domains", "Maze", "--seeds", 3, "--scale", 0.05, "--cores", 1, "--out", tmp_path]
    assert call(monkeypatch, *options) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pseudo_reward.png", "summary.json"]
    rows = json.loads((tmp_path / "summary.json").read_text())
    assert {row["rule"] for row in rows} == RULES
    assert len(rows) == len(RULES) == NUM_RULES
    whole = {row["rule"]: row["whole"]["mean"] for row in rows}
    in_hindsight = max(value for rule, value in whole.items() if rule == "Q-learning" or rule[-1].isdigit())
    for row in rows:
        assert whole[row["best_whole"]] == in_hindsight
        regret = in_hindsight - row["whole"]["mean"]
        assert row["regret_whole"]["mean"] == pytest.approx(regret, abs=1e-4)
        assert row["percent_whole"] == pytest.approx(100 * regret / abs(in_hindsight), abs=1e-2)
        assert row["seeds"] == 3
    assert pseudo_reward.table(rows).splitlines()[1].startswith("Maze, learning")


def test_a_domain_that_is_not_known_is_refused(monkeypatch: pytest.MonkeyPatch):
    assert "error: --domains must be among 'Bus', 'Bus, loop'" in str(call(monkeypatch, "--domains", "Pond"))


def test_regrets_are_those_of_paired_runs():
    case = pseudo_reward.cases()[0]
    episode = np.arange(100)
    curves = {
        "Q-learning": -30 - 0.1 * episode,
        "shared, 5": -40 + 0.1 * episode,
        "shared, fading": -33.0 + 0 * episode,
    }
    returns = {
        rule: xr.DataArray(np.stack([curve, curve - 1]), dims=("seed", "episode")) for rule, curve in curves.items()
    }
    fading = pseudo_reward.rows(case, returns)[-1]
    assert fading["rule"] == "shared, fading"
    assert (fading["best_whole"], fading["best_last_tenth"]) == ("Q-learning", "shared, 5")
    assert fading["regret_whole"]["mean"] == pytest.approx(-34.95 + 33)
    assert fading["regret_whole"]["lo"] == fading["regret_whole"]["hi"]
    assert fading["percent_last_tenth"] == pytest.approx(100 * (-30.55 + 33) / 31.05)


def test_cases_are_what_they_are_called():
    cases = pseudo_reward.cases()
    assert len({case.name for case in cases}) == len(cases) == 23
    for case in cases:
        assert case.hierarchy.is_total_leaf_cover()
        learners = case.learners(100)
        swept = {f"{name}, {k:g}" for name in ("shared", "apart") for k in pseudo_reward.FIXED}
        assert (learners.keys() - {"shared", "apart"}) | swept == RULES


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 3, 17])
def test_random_tasks_keep_the_contract_and_differ(number: int):
    env, hierarchy = random_task(number)
    hrl.check(env)
    assert not hrl.inaccessible(hierarchy, hrl.tabulate(hierarchy, env).active)
    assert env.table != random_task(number + 1)[0].table
    assert random_task(number)[0] is env
    assert 40 < env.num_states <= 120
