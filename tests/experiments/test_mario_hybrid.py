"""Rows, tables and pictures of the Mario experiments, from made-up curves; and what the scripts refuse."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from hrljax.experiments import mario_ablation, mario_hybrid, mario_search
from hrljax.learners.relational.learned_model import MarioModel
from hrljax.learners.relational.learner import RelationalHORDQ

SCRIPTS = Path(__file__).parents[2] / "scripts"


def curve(wins: list[list[float]]) -> xr.Dataset:
    """Seeds' episodes: the level finished or not; a finished one is 316 tiles long, another 100."""
    won = np.array(wins)
    bins = {"win": won, "death": 1 - won, "distance": 100 + 216 * won, "return": 50 + 360 * won}
    return xr.Dataset(
        {name: (("seed", "episode"), values) for name, values in bins.items()} | {"steps": ("seed", [400.0, 600.0])},
        coords={"seed": range(len(wins)), "episode": range(1, len(wins[0]) + 1)},
        attrs={"complete": True},
    )


def test_a_row_counts_levels_per_run():
    row = mario_hybrid.summary_row("Model+HORDQ(10)", curve([[0, 1, 1, 0], [1, 1, 1, 1]]))
    assert row["finished"]["mean"] == 3
    assert row["finished_by_seed"] == [2, 4]
    assert row["thesis"] == 277
    assert row["deaths"] == 1  # 2 of 8 episodes, in a run of 4
    assert row["distance"]["mean"] == 100 + 216 * 0.75
    assert (row["steps"], row["seeds"], row["episodes"]) == (500, 2, 4)
    text = mario_hybrid.table([row])
    assert "Model+HORDQ(10)" in text
    assert "of 4 episodes, mean of 2 seeds" in text


def test_differences_are_of_runs_of_the_same_seed():
    curves = {
        "A": curve([[1, 1, 1], [0, 1, 0]]),
        "B": curve([[0, 1, 0], [0, 0, 0]]),
        "C": curve([[1, 1, 0], [0, 1, 1]]),
    }
    ahead = mario_hybrid.differences(curves, "A")
    assert list(ahead) == ["B", "C"]
    assert ahead["B"]["mean"] == (2 + 1) / 2
    assert ahead["C"]["mean"] == 0
    assert ahead["B"]["lo"] is not None
    text = mario_hybrid.differences_table(ahead, "A").splitlines()
    assert text[0].split() == ["A", "less", "levels", "95", "%"]
    assert text[1].split()[:2] == ["B", "1.5"]


def test_names_and_the_model_alone():
    assert mario_hybrid.name_of(10.0) == "Model+HORDQ(10)"
    assert mario_hybrid.name_of(mario_hybrid.FOLLOWS) == "Model"
    assert set(mario_hybrid.THESIS) == {"SARSA", "Model", "Model+HORDQ(10)", "Model+HORDQ(20)"}


def test_pictures_show_every_row_and_curve():
    rows = [mario_hybrid.summary_row(name, curve([[0, 1], [1, 1]])) for name in ("SARSA", "Model")]
    (counts,) = mario_hybrid.counts_picture(rows).axes
    assert [label.get_text() for label in counts.get_xticklabels()] == ["SARSA", "Model"]
    curves = {name: curve([[0, 1] * 20, [1, 1] * 20]) for name in ("SARSA", "Model")}
    (distance,) = mario_hybrid.distance_picture(curves).axes
    assert len(distance.get_lines()) >= 2
    assert "tiles" in distance.get_ylabel()


def test_every_reading_of_the_search_is_tried_once():
    tried = [tuple(options.items()) for options in mario_search.settings((1000,))]
    assert len(tried) == len(set(tried)) == 9
    (level,) = mario_search.empty_level().level_list
    assert not level.spawns.any()
    row = {"priority": "cumulative", "answer": "leaf", "count": "generated", "max_nodes": 300}
    line = mario_search.table_line(row | {"stop_reward": None, "win": True, "distance": 316.0, "length": 118})
    assert line.split() == ["cumulative", "leaf", "300", "generated", "-", "316.0", "118", "finished"]


def test_an_ablation_changes_what_it_says_and_nothing_else():
    base = mario_ablation.CHANGES["as read by default"]
    assert base.search_root() == mario_hybrid.ROOTS["learned"]
    assert base.environment() == mario_hybrid.environment()
    roots = {name: change.search_root() for name, change in mario_ablation.CHANGES.items()}
    together = roots["search and trees"]
    assert (together.priority, together.answer, together.max_nodes) == ("last_reward", "leaf", 1000)
    assert isinstance(together.model, MarioModel)
    assert (together.model.min_leaf, together.model.offsets) == (1, True)
    assert roots["trees grown out"].priority == roots["as read by default"].priority
    in_the_game = {"a death costs 10", "quantum 16"}
    for name, change in mario_ablation.CHANGES.items():
        same = change.search_root() == base.search_root()
        assert same == (name in in_the_game | {"as read by default"})
        assert bool(change.env or change.params) == (name in in_the_game)


def test_every_change_to_the_best_configuration_is_one():
    of_best = dict(mario_ablation.OF_BEST)
    assert of_best.pop("as it is") == mario_hybrid.BEST_LEARNED
    for learner in of_best.values():
        best = mario_hybrid.BEST_LEARNED
        differ = [name for name, value in vars(best).items() if value != getattr(learner, name)]
        assert len(differ) == 1 or sorted(differ) == ["trace_decay", "trace_length"]
    assert len(set(of_best.values())) == len(of_best)


def test_an_ablations_table_has_a_line_for_every_row():
    rows = [mario_hybrid.summary_row(name, curve([[0, 1], [1, 1]])) for name in ("quantum 16", "1000 nodes")]
    lines = mario_ablation.table(rows).splitlines()
    assert lines[1].split() == ["quantum", "16", "1.5", "262.0", "500"]
    assert lines[-1] == "of 2 episodes, mean of 2 seeds; distance in tiles"


def test_a_film_is_of_a_learner_with_a_root():
    script = runpy.run_path(str(SCRIPTS / "table_4_1.py"))
    options = script["Options"](pseudo_rewards=(10.0,), model="given")
    root = mario_hybrid.ROOTS["given"]
    of = {name: script["_learner"](name, root, options) for name in ("SARSA", "Model+HORDQ(10)", *mario_hybrid.BEST)}
    assert of["SARSA"] == RelationalHORDQ(root, pseudo_reward=mario_hybrid.FOLLOWS)
    assert of["Model+HORDQ(10)"] == RelationalHORDQ(root, pseudo_reward=10.0)
    assert [of[name] for name in mario_hybrid.BEST] == [mario_hybrid.BEST_GIVEN, mario_hybrid.BEST_LEARNED]


@pytest.mark.parametrize(
    ("script", "arguments", "message"),
    [
        ("table_4_1.py", ["--seeds", "0"], "--seeds must be"),
        ("mario_search.py", ["--more-nodes", "0"], "--more-nodes must be"),
        ("mario_ablation.py", ["--episodes", "0"], "--episodes must be"),
        ("mario_ablation.py", ["--only", "luck"], "there is no change 'luck'"),
        ("mario_generalisation.py", ["--levels", "0"], "--levels must be"),
        ("figure_4_5.py", ["--runs", "nowhere"], "run scripts/table_4_1.py"),
    ],
)
def test_the_scripts_refuse_without_a_traceback(
    script: str, arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr(sys, "argv", [script, "--out", str(tmp_path / "out"), *arguments])
    with pytest.raises(SystemExit) as left:
        runpy.run_path(str(SCRIPTS / script), run_name="__main__")
    assert message in str(left.value)
    assert not (tmp_path / "out").exists()
