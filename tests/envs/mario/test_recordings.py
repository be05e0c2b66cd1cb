"""Recordings become small records, and damaged ones clear errors."""

from pathlib import Path

import numpy as np
import pytest

from hrljax.envs.mario.recordings import LevelId, read_episodes, read_levels, read_trajectories
from tests.mario_data import EXCERPT, recording

CASES = {
    "case_seed": [7, 8], "case_type": [0, 2], "case_difficulty": [3, 4], "case_width_param": [320, 150],
    "case_row0": [0, 3], "case_n_rows": [3, 2], "case_agent": ["first", "second"],
}  # fmt: skip
ROWS = 5
OFFSETS = np.array([0, 0, 1, 3, 4, 6], np.int32)  # sprites of the five rows: 0, 1, 2, 1, 2

TRAJECTORIES = CASES | {
    "case_mode": [0, 2], "case_no_enemies": [0, 1], "case_final_status": [1, 2], "case_x_exit": [318, 150],
    "mario_f": np.arange(9 * ROWS, dtype=np.float32).reshape(ROWS, 9),
    "mario_i": np.arange(15 * ROWS, dtype=np.int16).reshape(ROWS, 15),
    "spr_off": OFFSETS,
    "spr_f": np.arange(24, dtype=np.float32).reshape(6, 4),
    "spr_i": np.arange(36, dtype=np.int16).reshape(6, 6),
    "tile_events": np.array([[1, 5, 6, 0], [4, 7, 8, 4]], np.int32),
}  # fmt: skip
SCREEN = np.full((16, 22), ord(" "), np.uint8)
SCREEN[:, 21] = ord("\n")
SCREEN[3, 20] = ord("M")
EPISODES = CASES | {
    "case_max_steps": [1000, 20], "case_total_reward": [1.5, -10.0], "case_end": [2, 1],
    "action": np.arange(3 * ROWS, dtype=np.int8).reshape(ROWS, 3), "reward": np.arange(ROWS, dtype=np.float64),
    "terminal": np.zeros(ROWS, np.int8), "cam_tile": np.arange(ROWS, dtype=np.int16),
    "chars": np.tile(SCREEN.ravel(), (ROWS, 1)), "obj_off": OFFSETS,
    "obj_type_winged": np.arange(12, dtype=np.int8).reshape(6, 2),
    "obj_xyv": np.arange(24, dtype=np.float64).reshape(6, 4),
}  # fmt: skip


def written(path: Path, arrays: dict) -> Path:
    np.savez(path, **arrays)
    return path


def test_levels():
    recorded = read_levels(EXCERPT / "mario_levels.npz")
    thesis = next(case for case in recorded if case.id.seed == 1247)
    assert thesis.id == LevelId(1247, 0, 3, 320)
    assert thesis.level.tiles.shape == (370, 15)
    assert (thesis.level.exit_column, thesis.exit_row) == (318, 11)


def test_trajectories_are_cut_into_cases(tmp_path):
    first, second = read_trajectories(written(tmp_path / "t.npz", TRAJECTORIES))
    assert (first.id, first.agent, first.mode, first.no_enemies) == (LevelId(7, 0, 3, 320), "first", 0, False)
    assert (second.id, second.agent, second.mode, second.no_enemies) == (LevelId(8, 2, 4, 150), "second", 2, True)
    assert (first.exit_column, first.final_status, second.exit_column, second.final_status) == (318, 1, 150, 2)
    assert (first.num_ticks, second.num_ticks) == (2, 1)
    assert second.mario_floats[:, 0].tolist() == [27, 36]
    assert first.keys.tolist() == [15, 30]
    assert first.tile_events.tolist() == [[1, 5, 6, 0]]
    assert second.tile_events.tolist() == [[1, 7, 8, 4]]
    counts = [len(case.sprites(row)[0]) for case in (first, second) for row in range(len(case.mario_floats))]
    assert counts == [0, 1, 2, 1, 2]
    assert second.sprites(1)[0][:, 0].tolist() == [16, 20]
    assert second.sprites(0)[1].tolist() == [[18, 19, 20, 21, 22, 23]]


def test_episodes_are_cut_into_cases(tmp_path):
    first, second = read_episodes(written(tmp_path / "e.npz", EPISODES))
    assert (first.max_steps, first.total_reward, first.end) == (1000, 1.5, 2)
    assert (second.id, second.num_steps) == (LevelId(8, 2, 4, 150), 1)
    assert second.actions.tolist() == [[9, 10, 11], [12, 13, 14]]
    assert second.rewards.tolist() == [3, 4]
    assert second.symbols.shape == (2, 16, 21)
    assert chr(second.symbols[1, 3, 20]) == "M"
    assert second.objects(1)[0].tolist() == [[8, 9], [10, 11]]
    assert second.objects(0)[1].tolist() == [[12, 13, 14, 15]]


def test_the_full_recordings():
    trajectories = read_trajectories(recording("trajectories.npz"))
    assert len(trajectories) == 329
    assert sum(len(case.mario_floats) for case in trajectories) == 108_447
    assert all(case.tile_events[:, 0].min(initial=1) > 0 for case in trajectories)
    assert all(case.sprite_starts[-1] == len(case.sprite_ints) for case in trajectories)
    episodes = read_episodes(recording("rl_steps.npz"))
    assert len(episodes) == 104
    assert sum(case.num_steps + 1 for case in episodes) == 6657
    assert all(case.rewards.sum() == pytest.approx(case.total_reward) for case in episodes)


@pytest.mark.parametrize(
    ("read", "arrays", "change", "message"),
    [
        (
            read_trajectories,
            TRAJECTORIES,
            {"spr_off": None},
            "no recorded trajectories: no array spr_off; it has case_s",
        ),
        (read_episodes, EPISODES, {"reward": None}, "no recorded competition steps: no array reward;"),
        (read_levels, EPISODES, {}, "no recorded levels: no array type, difficulty, seed"),
        (
            read_trajectories,
            TRAJECTORIES,
            {"mario_i": np.zeros((5, 14))},
            r"mario_i must have shape \[5, 15\], got \[5, 14\]",
        ),
        (read_trajectories, TRAJECTORIES, {"spr_off": OFFSETS[:-1]}, r"spr_off must have shape \[6\], got \[5\]"),
        (read_episodes, EPISODES, {"case_n_rows": [3, 9]}, "case 1 has rows 3..11, but there are 5 rows"),
        (read_episodes, EPISODES, {"case_end": [3]}, r"case_end must have shape \[2\], got \[1\]"),
    ],
)
def test_recordings_with_something_missing_are_refused(tmp_path, read, arrays, change, message):
    arrays_left = {name: value for name, value in (arrays | change).items() if value is not None}
    with pytest.raises(ValueError, match=message):
        read(written(tmp_path / "r.npz", arrays_left))


def test_what_is_no_recording_is_refused(tmp_path):
    text = tmp_path / "notes.npz"
    text.write_text("no archive")
    with pytest.raises(ValueError, match=r"notes.npz cannot be read as recorded levels"):
        read_levels(text)
    np.save(tmp_path / "one.npy", np.zeros(3))
    with pytest.raises(ValueError, match=r"no array type, .*; it has none"):
        read_levels(tmp_path / "one.npy")
    with pytest.raises(FileNotFoundError):
        read_levels(tmp_path / "absent.npz")
