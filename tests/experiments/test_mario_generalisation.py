"""Playing levels that nothing was trained on: the compiled games are those of the host, and the rows count them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.levels.generator import generate_level
from hrljax.envs.mario.play import play
from hrljax.experiments import mario_generalisation as generalisation
from hrljax.experiments import mario_hybrid
from hrljax.sweeps.learned import Learned, StatePolicy

LEVELS = generalisation.LevelSet((0, 2), (0, 3), each=1, first_seed=5)


def test_a_set_has_every_type_and_difficulty_with_its_own_seeds():
    assert LEVELS.table == [(0, 0, 5), (0, 3, 5), (2, 0, 5), (2, 3, 5)]
    for level, (level_type, difficulty, seed) in zip(LEVELS.environment.level_list, LEVELS.table, strict=True):
        drawn = generate_level(seed, level_type, difficulty)
        np.testing.assert_array_equal(level.tiles, drawn.tiles)
        np.testing.assert_array_equal(level.spawns, drawn.spawns)


def test_what_is_played_was_not_trained_on():
    highest = max(seed for levels in generalisation.TRAINED_ON.values() for _, _, seed in levels.table)
    assert highest < generalisation.PLAYED_FROM


@pytest.mark.slow
def test_games_are_those_that_the_learned_policy_plays_step_by_step(quick_compiler: None):
    root = hrl.SearchRoot(model=hrl.MarioDynamics(), priority="last_reward", answer="leaf", max_nodes=60)
    learner = hrl.RelationalHORDQ(root, pseudo_reward=10.0)
    env = LEVELS.environment
    tables = learner.init(env, learner.prepare(env)).tables
    # Weights that matter beside the pseudo-reward where things are near, so that a wrong one changes a game.
    weights = jax.random.normal(jax.random.key(1), tables.weights.shape, jnp.float32) * np.float32(4)
    tables = tables._replace(weights=weights.at[-env.num_actions :].set(0))
    player = generalisation.LevelPlayer(env, generalisation.frozen(learner), cores=1)
    games = player.play(tables)

    policy = Learned(env, learner, tables).policy()
    assert isinstance(policy, StatePolicy)
    twin = Mario(levels=env.levels, preset="thesis", actions="all")
    for level in (0, 3):
        steps = list(play(twin, lambda episode: env.action_table[policy(episode)], level=level))
        assert games["length"][level] == len(steps)
        assert games["return"][level] == pytest.approx(sum(step.reward for step in steps), abs=1e-2)
        assert games["win"][level] == (int(steps[-1].episode.world.player.win_time) > 0)
    without = player.play(tables._replace(weights=weights * 0))
    assert (without["distance"] != games["distance"]).any()
    assert (games["distance"] > 5).any()
    assert player.play(tables, [3])["return"] == games["return"][3]


def test_rows_are_means_over_levels_and_intervals_over_seeds():
    played = generalisation.LevelSet((1,), (0, 4), each=2, first_seed=1)
    by_level = {name: np.array([[1, 0, 0, 0], [1, 1, 0, 0]], np.float32) for name in ("win", "distance")}
    by_level |= {name: np.ones((2, 4), np.float32) for name in ("return", "length")}
    by_level["distance"] *= 200
    easy, hard = generalisation.by_kind("some levels", played, by_level)
    assert (easy["level_type"], easy["difficulty"], hard["difficulty"]) == (1, 0, 4)
    assert (easy["levels"], easy["seeds"]) == (2, 2)
    assert easy["finished"]["mean"] == 0.75
    assert easy["finished"]["lo"] < 0.75 < easy["finished"]["hi"]
    assert hard["finished"]["mean"] == 0
    text = generalisation.table([easy, hard])
    assert text.splitlines()[1].split() == ["some", "levels", "1", "75", "0", "38"]
    assert generalisation.table([easy, hard], "distance").splitlines()[1].split()[3:] == ["150", "0", "75"]
    figure = generalisation.picture([easy, hard])
    assert figure.axes[0].get_title() == "trained on some levels"
    assert [text.get_text() for text in figure.axes[0].texts] == ["150", "0"]


@pytest.mark.slow
def test_the_model_alone_is_not_trained(monkeypatch, quick_compiler: None):
    monkeypatch.setattr(generalisation, "trained_tables", lambda *args, **kwargs: pytest.fail("trained"))
    played = generalisation.LevelSet((0,), (0,), each=1, first_seed=5)
    ((row,),) = generalisation.rows([], played, mario_hybrid.BEST_VALUES, seeds=3, num_episodes=1, cores=1)
    assert (row["trained_on"], row["seeds"], row["levels"]) == (generalisation.UNTRAINED, 1, 1)
