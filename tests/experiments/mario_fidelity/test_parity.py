"""The engine against recordings of the original program: identical, and differences are found."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hrljax.envs.mario.recordings import read_episodes, read_trajectories
from hrljax.experiments.mario_fidelity import parity
from hrljax.experiments.mario_fidelity.drift import drift, table
from tests.mario_data import EXCERPT, LEVEL_FILES, recording

TRAJECTORIES, EPISODES = EXCERPT / "mario_trajectories.npz", EXCERPT / "mario_rl_steps.npz"


def differences(verdicts) -> list[str]:
    verdicts = list(verdicts)
    assert all(0 <= v.identical <= v.total for v in verdicts)
    assert all((v.identical == v.total) == (not v.first_difference) for v in verdicts)
    return [v.first_difference for v in verdicts if v.first_difference]


@pytest.mark.slow
def test_recorded_ticks():
    assert differences(parity.check_trajectories(TRAJECTORIES)) == []


@pytest.mark.slow
def test_recorded_steps():
    assert differences(parity.check_episodes(EPISODES)) == []


@pytest.mark.parametrize("name", sorted(LEVEL_FILES))
def test_all_recorded_levels(name: str):
    assert differences(parity.check_levels(recording(name))) == []


def test_all_recorded_ticks():
    assert differences(parity.check_trajectories(recording("trajectories.npz"))) == []


def test_all_recorded_steps():
    assert differences(parity.check_episodes(recording("rl_steps.npz"))) == []


def test_the_excerpt_holds_the_thesis_level_and_every_kind_of_agent():
    games, episodes = read_trajectories(TRAJECTORIES), read_episodes(EPISODES)
    assert any(game.id == (1247, 0, 3, 320) for game in games)
    assert any(episode.id == (1247, 0, 3, 320) and episode.end == 2 for episode in episodes)
    agents = {game.agent.split(":")[0] for game in games}
    assert agents == {"sticky", "uniform", "runner", "rlstep", "idle", "search"}
    assert {game.final_status for game in games} == {0, 1, 2}
    assert {episode.end for episode in episodes} == {1, 2}
    assert {int(kind) for game in games for kind in game.sprite_ints[:, 0]} == set(range(1, 10))


@pytest.fixture(scope="module")
def short_game():
    """The shortest recorded game with sprites, on the course of all games, which is compiled for already."""
    games = read_trajectories(TRAJECTORIES)
    game = min((game for game in games if len(game.sprite_ints)), key=lambda game: game.num_ticks)
    return *parity.courses([game.id for game in games])[game.id], game


@pytest.fixture(scope="module")
def short_episode():
    """The same for the shortest recorded episode."""
    episodes = read_episodes(EPISODES)
    episode = min(episodes, key=lambda episode: episode.num_steps)
    return *parity.courses([episode.id for episode in episodes])[episode.id], episode


@pytest.mark.slow
def test_one_changed_bit_is_found(short_game):
    course, index, game = short_game
    floats = game.mario_floats.copy()
    floats.view(np.uint32)[7, 1] ^= 1
    verdict = parity.compare_trajectory(course, index, game._replace(mario_floats=floats))
    assert verdict[:2] == (game.num_ticks - 1, game.num_ticks)
    assert "after tick 7 Mario's y is" in verdict.first_difference


@pytest.mark.slow
def test_a_changed_tile_and_a_lost_sprite_are_found(short_game):
    course, index, game = short_game
    tile = game._replace(tile_events=np.array([[3, 5, 6, 4]], np.int32))
    assert "after tick 3 the tile at (5, 6) is 0x00, not 0x04" in parity.compare_trajectory(
        course, index, tile
    ).first_difference  # fmt: skip
    row = int(np.argmax(np.diff(game.sprite_starts)))
    starts = game.sprite_starts.copy()
    starts[row + 1 :] -= 1
    lost = game._replace(
        sprite_starts=starts,
        sprite_floats=np.delete(game.sprite_floats, game.sprite_starts[row], 0),
        sprite_ints=np.delete(game.sprite_ints, game.sprite_starts[row], 0),
    )
    found = parity.compare_trajectory(course, index, lost).first_difference
    assert f"after tick {row} the kinds of sprites are" in found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("field", "change", "text"),
    [
        ("rewards", 0.25, "the reward is "),
        ("terminals", 1, "the episode is not over"),
        ("camera_tiles", 1, "the camera is at column"),
        ("symbols", 1, "the character in row 0, column 0 is "),
        ("object_numbers", 1.0, "object 0: x is"),
    ],
)
def test_a_changed_step_is_found(field: str, change: float, text: str, short_episode):
    course, index, episode = short_episode
    values = getattr(episode, field).copy()
    row = int(episode.object_starts[2]) if field == "object_numbers" else 2
    values[(row, *[0] * (values.ndim - 1))] += change
    changed = episode._replace(**{field: values})
    verdict = parity.compare_episode(course, index, changed)
    assert verdict.identical == verdict.total - 1
    assert "after step 2 " + text in verdict.first_difference


@pytest.mark.slow
def test_a_game_on_a_lattice_and_its_drift(short_game):
    course, index, game = short_game
    record = parity.replay(course, index, game, quantum=8)
    listed = np.arange(record.sprites.x.shape[1]) < record.counts["n_sprites"][:, None]
    for name in ("x", "y", "xa", "ya"):
        values = np.concatenate([getattr(record.player, name), getattr(record.sprites, name)[listed]]) * 8
        np.testing.assert_array_equal(values, np.round(values))
    games = read_trajectories(TRAJECTORIES)
    row = drift(games, 8)
    assert 0 < row.within_pixel < row.within_tile < 1
    assert f"{row.within_tile:.1%}" in table([row])
    with pytest.raises(ValueError, match=r"quantum must be one of None, 1, 2, .*got 3"):
        drift([game], 3)


def script(*arguments: str) -> subprocess.CompletedProcess:
    path = Path(__file__).parents[3] / "scripts" / "check_mario_parity.py"
    return subprocess.run([sys.executable, path, *arguments], capture_output=True, text=True)


@pytest.mark.slow
def test_script_without_files_and_with_a_damaged_level(tmp_path: Path):
    nothing = script()
    assert nothing.returncode == 1
    assert "nothing to compare" in nothing.stderr
    arrays = dict(np.load(EXCERPT / "mario_levels_w150.npz"))
    arrays["tiles"][0, 3, 2] = 0x22
    np.savez(tmp_path / "damaged.npz", **arrays)
    good = str(EXCERPT / "mario_levels_w150.npz")
    result = script("--levels", good, str(tmp_path / "damaged.npz"))
    count = len(arrays["seed"])
    assert result.returncode == 1
    assert f"{good}: levels {count}/{count}" in result.stdout
    assert f"damaged.npz: levels {count - 1}/{count}" in result.stdout
    assert "tiles at column 3, row 2 is 0x00, not 0x22" in result.stdout
