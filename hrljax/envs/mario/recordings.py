"""Recordings of the original program, case by case: levels, ticks and competition steps.

The files are NumPy archives (``.npz``) of flat arrays; here every case becomes a small record whose
arrays are views of them, with row numbers that count from the start of the case.
"""

from collections.abc import Mapping
from os import PathLike
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np

from hrljax.envs.mario.levels.level import Level
from hrljax.envs.mario.levels.tiles import HEIGHT

MARIO_FLOATS = ("x", "y", "xa", "ya", "x_old", "y_old", "x_jump_speed", "y_jump_speed", "x_cam")
"""Columns of `Trajectory.mario_floats`."""
MARIO_INTS = (
    "keys", "flags", "facing", "jump_time", "power_up_time", "invulnerable_time", "death_time", "win_time",
    "coins", "kills", "carried_id", "active_tick", "fireballs_on_screen", "n_sprites", "status",
)  # fmt: skip
"""Columns of `Trajectory.mario_ints`."""
SPRITE_FLOATS = ("x", "y", "xa", "ya")
SPRITE_INTS = ("kind", "facing", "flags", "dead_time", "aux", "id")

KEY_BITS = {"left": 1, "right": 2, "down": 4, "up": 8, "jump": 16, "speed": 32}
"""Bits of ``keys``."""
MARIO_FLAG_BITS = {
    "on_ground": 1, "was_on_ground": 2, "may_jump": 4, "sliding": 8, "can_shoot": 16,
    "ducking": 32, "large": 64, "fire": 128, "paused": 256,
}  # fmt: skip
"""Bits of Mario's ``flags``."""
SPRITE_FLAG_BITS = {"on_ground": 1, "winged": 2, "flying_death": 4, "carried": 8, "dead": 16}
"""Bits of a sprite's ``flags``."""

Path = str | PathLike[str]


class LevelId(NamedTuple):
    """What a level is generated from."""

    seed: int
    level_type: int
    difficulty: int
    width: int  # nominal, in tiles; the level has 50 columns more


class RecordedLevel(NamedTuple):
    """A generated level."""

    id: LevelId
    level: Level
    exit_row: int  # top row of the ground at the exit


class Trajectory(NamedTuple):
    """One game, tick by tick; row 0 is the state before the first tick, row t that after tick t."""

    id: LevelId
    agent: str
    mode: int  # Mario at the start: 0 small, 1 large, 2 fire
    no_enemies: bool  # all monsters were taken out of the level
    exit_column: int
    final_status: int  # 0 alive, 1 dead, 2 won
    mario_floats: np.ndarray  # [T + 1, 9] float32, columns MARIO_FLOATS
    mario_ints: np.ndarray  # [T + 1, 15] int16, columns MARIO_INTS; keys were held during the tick
    sprite_starts: np.ndarray  # [T + 2] int32: sprites of row t are rows starts[t]:starts[t + 1]
    sprite_floats: np.ndarray  # [sprites, 4] float32, columns SPRITE_FLOATS
    sprite_ints: np.ndarray  # [sprites, 6] int16, columns SPRITE_INTS
    tile_events: np.ndarray  # [events, 4] int32: row, tile x, tile y, new byte

    @property
    def num_ticks(self) -> int:
        return len(self.mario_floats) - 1

    @property
    def keys(self) -> np.ndarray:
        """``[T]`` int16: the keys held during tick 1, 2, ... (`KEY_BITS`)."""
        return self.mario_ints[1:, MARIO_INTS.index("keys")]

    def sprites(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        """The sprites after a tick, newest first: ``[n, 4]`` float32 and ``[n, 6]`` int16."""
        rows = slice(self.sprite_starts[row], self.sprite_starts[row + 1])
        return self.sprite_floats[rows], self.sprite_ints[rows]


class Episode(NamedTuple):
    """One game, step by step of the competition; row 0 is the first observation."""

    id: LevelId
    agent: str
    max_steps: int
    total_reward: float
    end: int  # 1 lost, 2 won
    actions: np.ndarray  # [N + 1, 3] int8: direction, jump, speed of the step that led to the row
    rewards: np.ndarray  # [N + 1] float64
    terminals: np.ndarray  # [N + 1] int8
    camera_tiles: np.ndarray  # [N + 1] int16
    symbols: np.ndarray  # [N + 1, 16, 21] uint8: the characters of the screen
    object_starts: np.ndarray  # [N + 2] int32: objects of row t are rows starts[t]:starts[t + 1]
    object_types: np.ndarray  # [objects, 2] int8: type, winged; Mario first
    object_numbers: np.ndarray  # [objects, 4] float64: x, y, dx, dy in the competition's units

    @property
    def num_steps(self) -> int:
        return len(self.rewards) - 1

    def objects(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        """The objects of a row, Mario first: ``[n, 2]`` int8 and ``[n, 4]`` float64."""
        rows = slice(self.object_starts[row], self.object_starts[row + 1])
        return self.object_types[rows], self.object_numbers[rows]


_IDS = ("type", "difficulty", "seed")
_LEVELS = (*_IDS, "x_exit", "y_exit", "width_param", "tiles", "spawns")
_CASES = ("case_seed", "case_type", "case_difficulty", "case_width_param", "case_agent", "case_row0", "case_n_rows")
_TRAJECTORIES = (
    *(*_CASES, "case_mode", "case_no_enemies", "case_final_status", "case_x_exit"),
    *("mario_f", "mario_i", "spr_off", "spr_f", "spr_i", "tile_events"),
)
_EPISODES = (
    *(*_CASES, "case_max_steps", "case_total_reward", "case_end"),
    *("action", "reward", "terminal", "cam_tile", "chars", "obj_off", "obj_type_winged", "obj_xyv"),
)


def read_levels(path: Path) -> list[RecordedLevel]:
    """Reads recorded levels.

    Raises:
        ValueError: the file is no archive of arrays, lacks an array, or one has another shape; names both.
    """
    arrays = _load(path, "levels", _LEVELS)
    count, width = len(arrays["seed"]), int(arrays["width_param"])
    columns = arrays["tiles"].shape[1] if arrays["tiles"].ndim == 3 else 0
    _check_shapes(path, arrays, dict.fromkeys((*_IDS, "x_exit", "y_exit"), (count,)))
    _check_shapes(path, arrays, dict.fromkeys(("tiles", "spawns"), (count, columns, HEIGHT)))
    return [
        RecordedLevel(
            LevelId(int(arrays["seed"][i]), int(arrays["type"][i]), int(arrays["difficulty"][i]), width),
            Level(arrays["tiles"][i], arrays["spawns"][i], np.int32(arrays["x_exit"][i])),
            int(arrays["y_exit"][i]),
        )
        for i in range(count)
    ]


def read_trajectories(path: Path) -> list[Trajectory]:
    """Reads games recorded tick by tick.

    Raises:
        ValueError: the file is no archive of arrays, lacks an array, or one has another shape; names both.
    """
    arrays = _load(path, "trajectories", _TRAJECTORIES)
    rows, sprites = len(arrays["mario_f"]), len(arrays["spr_f"])
    _check_shapes(path, arrays, {"mario_f": (rows, len(MARIO_FLOATS)), "mario_i": (rows, len(MARIO_INTS))})
    _check_shapes(path, arrays, {"spr_f": (sprites, len(SPRITE_FLOATS)), "spr_i": (sprites, len(SPRITE_INTS))})
    _check_shapes(path, arrays, {"spr_off": (rows + 1,), "tile_events": (len(arrays["tile_events"]), 4)})
    events = arrays["tile_events"]
    cases = []
    for i, (first, end) in enumerate(_case_rows(path, arrays, rows)):
        starts, (low, high) = _part(arrays["spr_off"], first, end)
        case_events = events[(events[:, 0] >= first) & (events[:, 0] < end)]
        cases.append(
            Trajectory(
                _case_id(arrays, i),
                str(arrays["case_agent"][i]),
                int(arrays["case_mode"][i]),
                bool(arrays["case_no_enemies"][i]),
                int(arrays["case_x_exit"][i]),
                int(arrays["case_final_status"][i]),
                arrays["mario_f"][first:end],
                arrays["mario_i"][first:end],
                starts,
                arrays["spr_f"][low:high],
                arrays["spr_i"][low:high],
                case_events - np.array([first, 0, 0, 0], case_events.dtype),
            )
        )
    return cases


def read_episodes(path: Path) -> list[Episode]:
    """Reads games recorded step by step of the competition.

    Raises:
        ValueError: the file is no archive of arrays, lacks an array, or one has another shape; names both.
    """
    arrays = _load(path, "competition steps", _EPISODES)
    rows, objects = len(arrays["reward"]), len(arrays["obj_xyv"])
    _check_shapes(path, arrays, {"action": (rows, 3), "terminal": (rows,), "cam_tile": (rows,), "chars": (rows, 352)})
    _check_shapes(path, arrays, {"obj_off": (rows + 1,), "obj_type_winged": (objects, 2), "obj_xyv": (objects, 4)})
    cases = []
    for i, (first, end) in enumerate(_case_rows(path, arrays, rows)):
        starts, (low, high) = _part(arrays["obj_off"], first, end)
        cases.append(
            Episode(
                _case_id(arrays, i),
                str(arrays["case_agent"][i]),
                int(arrays["case_max_steps"][i]),
                float(arrays["case_total_reward"][i]),
                int(arrays["case_end"][i]),
                arrays["action"][first:end],
                arrays["reward"][first:end],
                arrays["terminal"][first:end],
                arrays["cam_tile"][first:end],
                arrays["chars"][first:end].reshape(-1, 16, 22)[:, :, :21],
                starts,
                arrays["obj_type_winged"][low:high],
                arrays["obj_xyv"][low:high],
            )
        )
    return cases


def _load(path: Path, what: str, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    try:
        archive = np.load(path)
        arrays = {name: archive[name] for name in archive} if isinstance(archive, Mapping) else {}
    except FileNotFoundError:
        raise
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise ValueError(f"{path} cannot be read as recorded {what}: {error}") from error
    missing = [name for name in names if name not in arrays]
    if missing:
        raise ValueError(
            f"{path} holds no recorded {what}: no array {', '.join(missing)}; it has {', '.join(arrays) or 'none'}"
        )
    return arrays


def _check_shapes(path: Path, arrays: dict[str, np.ndarray], shapes: dict[str, tuple[int, ...]]) -> None:
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise ValueError(f"{path}: {name} must have shape {list(shape)}, got {list(arrays[name].shape)}")


def _case_rows(path: Path, arrays: dict[str, np.ndarray], rows: int) -> list[tuple[int, int]]:
    """First and end row of every case, checked."""
    count = len(arrays["case_row0"])
    _check_shapes(path, arrays, {name: (count,) for name in arrays if name.startswith("case_")})
    cases = [(int(a), int(a) + int(n)) for a, n in zip(arrays["case_row0"], arrays["case_n_rows"], strict=True)]
    for i, (first, end) in enumerate(cases):
        if not 0 <= first < end <= rows:
            raise ValueError(f"{path}: case {i} has rows {first}..{end - 1}, but there are {rows} rows")
    return cases


def _case_id(arrays: dict[str, np.ndarray], case: int) -> LevelId:
    seed, level_type, difficulty, width = (
        int(arrays[f"case_{name}"][case]) for name in ("seed", "type", "difficulty", "width_param")
    )
    return LevelId(seed, level_type, difficulty, width)


def _part(offsets: np.ndarray, first: int, end: int) -> tuple[np.ndarray, tuple[int, int]]:
    """The offsets of rows ``first:end``, counted from the first one, and the range that they cover."""
    part = offsets[first : end + 1]
    return part - part[0], (int(part[0]), int(part[-1]))
