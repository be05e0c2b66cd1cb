"""Games on the host: policies, recorded actions, and the script that films them."""

import csv
import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hrljax.envs.mario.env import ALL_ACTIONS, Mario
from hrljax.envs.mario.play import play, random_policy, read_actions, recorded_policy, runner_policy, table

SCRIPT = runpy.run_path(str(Path(__file__).parents[3] / "scripts" / "play_mario.py"))
WIDTH = 40
LEVEL = (
    "type: overground\n"
    + ("." * WIDTH + "\n") * 11
    + ("." * WIDTH + "\n") * 2
    + ("#" * 16 + ".." + "#" * (WIDTH - 18) + "\n") * 2
    + "\n"
    + ("." * WIDTH + "\n") * 14
    + "." * 24 + "!" + "." * (WIDTH - 25) + "\n"
)  # fmt: skip


@pytest.mark.slow
def test_the_runner_jumps_over_a_pit_and_wins_and_the_film_shows_every_tick():
    env = Mario(levels=(LEVEL,), preset="competition", actions="all")
    steps = list(play(env, runner_policy(env.course)))
    assert steps[-1].terminated
    assert steps[-1].reward == 100
    for step in steps:
        for seen, after in zip(step.worlds[-1].player, step.episode.world.player, strict=True):
            np.testing.assert_array_equal(seen, after)
    assert [len(step.worlds) for step in steps[:-1]] == [5] * (len(steps) - 1)
    ticks = [int(world.active_ticks) for step in steps for world in step.worlds]
    assert ticks == list(range(6, 6 + len(ticks)))
    rows = table(steps)
    assert [row[0] for row in rows] == list(range(1, len(rows) + 1))
    assert float(rows[-1][5]) == pytest.approx(100 - 0.01 * (len(rows) - 1), rel=1e-5)
    assert float(rows[-1][6]) > 24

    standing = list(play(env, recorded_policy([(0, 0, 0)] * 2)))
    assert [step.action for step in standing] == [(0, 0, 0)] * 2
    assert not standing[-1].terminated


@pytest.mark.slow
def test_the_script_films_a_game_that_can_be_played_again(tmp_path):
    level = tmp_path / "level.txt"
    level.write_text(LEVEL)
    main, options = SCRIPT["main"], SCRIPT["Options"]
    first = options(policy="random", level=level, max_steps=6, out=tmp_path / "a", tile_pixels=8)
    assert main(first) == 0
    assert sorted(path.name for path in first.out.iterdir()) == ["game.gif", "level.png", "steps.csv", "summary.json"]
    again = options(policy="recorded", actions=first.out / "steps.csv", level=level, max_steps=6, out=tmp_path / "b",
                    tile_pixels=8)  # fmt: skip
    assert main(again) == 0
    assert (again.out / "steps.csv").read_text() == (first.out / "steps.csv").read_text()
    with (first.out / "steps.csv").open() as file:
        rows = list(csv.DictReader(file))
    summary = json.loads((first.out / "summary.json").read_text())
    assert (summary["steps"], summary["won"]) == (len(rows), False) == (6, False)
    assert summary["return"] == pytest.approx(-10.05)  # out of time in the last step
    with Image.open(first.out / "game.gif") as film:
        assert film.size == (160, 120)
        assert 13 <= film.n_frames <= summary["frames"] == 14


def test_random_actions_go_mostly_right_and_repeat():
    env = Mario(levels=(LEVEL,), actions="all")
    choose = random_policy(3)
    actions = [choose(None) for _ in range(2000)]  # type: ignore[arg-type]
    assert set(actions) == set(ALL_ACTIONS) == set(env.action_table)
    assert 0.7 < np.mean([direction == 1 for direction, _, _ in actions]) < 0.9
    assert 0.55 < np.mean([a == b for a, b in zip(actions, actions[1:], strict=False)]) < 0.75
    assert [random_policy(3)(None) for _ in range(3)] == [actions[0]] * 3  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("direction,jump\n1,0\n", "has no column speed; it must have direction, jump, speed"),
        ("direction,jump,speed\n1,0,x\n", "line 2: direction, jump, speed must be integers"),
        ("direction,jump,speed\n1,0,1\n2,0,0\n", "action 2 is (2, 0, 0); direction must be -1, 0 or 1"),
    ],
)
def test_bad_recorded_actions_are_refused(tmp_path, text, message):
    path = tmp_path / "actions.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=re.escape(message)):
        read_actions(path)


def test_actions_need_the_recorded_policy(tmp_path):
    main, options = SCRIPT["main"], SCRIPT["Options"]
    with pytest.raises(ValueError, match="--actions goes with --policy recorded"):
        main(options(policy="recorded", out=tmp_path))
    with pytest.raises(ValueError, match="--ticks-per-frame must be an integer from 1 to 2147483647, got 0"):
        main(options(ticks_per_frame=0, out=tmp_path))


def test_there_must_be_such_a_level():
    with pytest.raises(ValueError, match=r"level must be in 0..0, got 1"):
        next(play(Mario(levels=(LEVEL,), actions="all"), random_policy(0), level=1))


def test_fewer_actions_are_not_enough():
    with pytest.raises(ValueError, match='env must have actions="all"'):
        next(play(Mario(levels=(LEVEL,), preset="thesis"), random_policy(0)))
