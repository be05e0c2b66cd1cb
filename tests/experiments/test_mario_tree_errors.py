"""Errors of Mario's trees on held-back steps and on the nodes of a search, on a few steps of a game."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.envs.mario.competition import PLAYING
from hrljax.envs.mario.play import Step, play
from hrljax.experiments import mario_hybrid, mario_tree_errors
from hrljax.experiments.mario_tree_errors import Judged, Material
from hrljax.experiments.mario_tree_models import MODELS
from hrljax.learners.relational.multiway_model import MultiwayModel
from hrljax.learners.relational.screen_model import ModelTables, body_of

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("quick_compiler")]

ENV = mario_hybrid.environment()
MODEL = MultiwayModel()


def games(number: int) -> list[list[Step]]:
    everything, random = replace(ENV, actions="all"), np.random.default_rng(0)
    actions = [action for action in ENV.action_table if action[0] >= 0]

    def policy(_: object) -> tuple[int, int, int]:
        return actions[random.integers(len(actions))]

    return [list(play(everything, policy)) for _ in range(number)]


@pytest.fixture(scope="module")
def of() -> Material:
    """Steps of some games at random, as a model would have kept them, and three moments of one."""
    described = jax.jit(lambda episode: (MODEL.inputs(ENV.course, episode.world), jnp.stack(body_of(episode)[:4])))
    rows, moments = [], []
    for game in games(12):
        for before, step in zip(game, game[1:], strict=False):
            (inputs, old), (_, new) = described(before.episode), described(step.episode)
            change = [*(np.asarray(new[:2]) - np.asarray(old[:2])) / 16, *np.asarray(new[2:])]
            action = ENV.action_table.index(step.action)
            rows.append([*np.asarray(inputs), action, *change, step.reward, step.terminated])
            if int(before.episode.phase) == PLAYING:
                moments.append(before.episode)
    chosen = [moments[i] for i in (0, 5, len(moments) - 1)]
    return Material(np.array(rows, np.float32), jax.tree.map(lambda *leaves: jnp.stack(leaves), *chosen))


def judged(name: str, rows: np.ndarray) -> tuple[Judged, ModelTables]:
    fitted = Judged(ENV, replace(MODELS[name], rows=len(rows)))
    return fitted, fitted.fit(jnp.asarray(np.concatenate([rows, np.zeros_like(rows[:1])])), jnp.int32(len(rows)))


def test_trees_that_are_grown_out_know_what_they_were_fitted_to(of: Material):
    _, first = np.unique(of.rows[:, :28], axis=0, return_index=True)
    rows = of.rows[first]
    grown, tables = judged("multiway, A", rows)
    errors = mario_tree_errors.errors(rows[:, 28:], np.asarray(grown.predictions(tables, rows)))
    assert max(errors[name] for name in ("x", "y", "reward")) < 1e-4
    assert errors["deaths_foreseen"] == 1
    forest, tables = judged("five of A, bagged", rows)
    of_forest = mario_tree_errors.errors(rows[:, 28:], np.asarray(forest.predictions(tables, rows)))
    # Each tree leaves out a third of the rows.
    assert 0.01 < of_forest["x"] < rows[:, 28].std() / 2
    classes, tables = judged("classes (RL-DT)", rows)
    predicted = np.asarray(classes.predictions(tables, rows))
    lasts = rows[:, 33] > 0
    # A class is an eighth wide, and most rows have a leaf for themselves.
    assert np.median(np.abs(predicted[~lasts, :2] - rows[~lasts, 28:30])) < 1 / 8
    assert (predicted[lasts, 5] == 1).mean() > 0.8


def test_a_search_is_held_against_the_game(of: Material):
    grown, tables = judged("multiway, A", of.rows)
    episode = jax.tree.map(lambda leaf: leaf[0], of.moments)
    result = grown.search(tables, episode)
    seen = mario_tree_errors.looked_at(result, mario_tree_errors.along(ENV)(result.tree, episode))
    inputs = grown.model.inputs(ENV.course, episode.world)
    rows = np.array([[*np.asarray(inputs), action] for action in range(ENV.num_actions)], np.float32)
    predicted = np.asarray(grown.predictions(tables, rows))
    transition = jax.jit(lambda action: ENV.transition(episode, action, (), ENV.default_params)[:2])
    for action in range(ENV.num_actions):
        after, reward = transition(jnp.int32(action))
        moved = (float(after.world.player.x) - float(episode.world.player.x)) / 16
        assert seen["depth"][action] == 1
        assert seen["x"][action] == pytest.approx(predicted[action, 0] - moved, abs=1e-4)
        assert seen["reward"][action] == pytest.approx(predicted[action, 4] - float(reward), abs=1e-4)


def test_a_row_for_every_model(of: Material):
    (row,) = mario_tree_errors.compared(ENV, {"binary (CART)": MODELS["binary (CART)"]}, of)
    assert (row["rows"], row["searches"]) == (len(of.rows) - len(of.rows) // mario_tree_errors.HELD_BACK, 3)
    lines = mario_tree_errors.table([row]).splitlines()
    assert lines[2].startswith("binary (CART)")
    assert len(lines) == 4
