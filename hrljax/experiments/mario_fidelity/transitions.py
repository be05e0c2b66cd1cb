"""Recorded games as transitions: what a model of Mario's movement learns from (thesis 4.2.3)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hrljax.envs.mario.competition import COLUMNS, ROWS
from hrljax.envs.mario.env import ALL_ACTIONS
from hrljax.envs.mario.features import NUM_SYMBOLS, SYMBOL_OF_KIND, TILE_CHARACTERS
from hrljax.envs.mario.recordings import Episode

TILES_PER_STEP = 25 / 16
"""What a velocity of 1 of the competition's program means."""
_REACH = 2
INPUT_CATEGORIES = (NUM_SYMBOLS,) * (2 * _REACH + 1) ** 2 + (0, 0)
"""Kinds of the inputs: the symbols of the 5 x 5 tiles around Mario row by row, then his velocity."""
TARGETS = ("x", "y", "dx", "dy")


class Transitions(NamedTuple):
    """Steps of many episodes, one after the other."""

    inputs: np.ndarray  # [N, 27] float32: INPUT_CATEGORIES; velocities to the right and up in tiles a step
    actions: np.ndarray  # [N] int32: numbers of hrljax.envs.mario.env.ALL_ACTIONS
    targets: np.ndarray  # [N, 4] float32: displacement in tiles, then the next velocity
    rewards: np.ndarray  # [N] float32
    episodes: np.ndarray  # [N] int32: which episode


def read_transitions(episodes: Sequence[Episode]) -> Transitions:
    """The steps of recorded episodes.

    Raises:
        ValueError: there is no episode.
    """
    if not episodes:
        raise ValueError("episodes must hold at least one recorded episode, got none")
    steps = [episode.num_steps for episode in episodes]
    marios = [np.stack([episode.objects(row)[1][0] for row in range(episode.num_steps + 1)]) for episode in episodes]
    velocities = [numbers[:, 2:] * TILES_PER_STEP for numbers in marios]
    windows = [_windows(episode) for episode in episodes]
    inputs = [np.concatenate([w, v[:-1]], axis=1) for w, v in zip(windows, velocities, strict=True)]
    targets = [
        np.concatenate([np.diff(n[:, :2], axis=0), v[1:]], axis=1) for n, v in zip(marios, velocities, strict=True)
    ]
    actions = [ALL_ACTIONS.index(tuple(map(int, row))) for episode in episodes for row in episode.actions[1:]]
    return Transitions(
        np.concatenate(inputs).astype(np.float32),
        np.array(actions, np.int32),
        np.concatenate(targets).astype(np.float32),
        np.concatenate([episode.rewards[1:] for episode in episodes]).astype(np.float32),
        np.repeat(np.arange(len(episodes), dtype=np.int32), steps),
    )


def _windows(episode: Episode) -> np.ndarray:
    """``[steps, 25]`` int: the symbols around Mario before every step."""
    size = 2 * _REACH + 1
    windows = np.zeros((episode.num_steps, size * size), int)
    for row in range(episode.num_steps):
        types, numbers = episode.objects(row)
        screen = np.array([[TILE_CHARACTERS.find(chr(c)) for c in line] for line in episode.symbols[row]])
        screen = np.maximum(screen, 0)  # Mario hides what is behind him
        columns = numbers[:, 0].astype(int) - int(episode.camera_tiles[row])
        lines = ROWS - 1 - numbers[:, 1].astype(int)
        for i in range(len(types) - 1, 0, -1):
            if 0 <= columns[i] < COLUMNS and 0 <= lines[i] < ROWS:
                screen[lines[i], columns[i]] = types[i, 0] + SYMBOL_OF_KIND
        around = np.arange(-_REACH, _REACH + 1)
        down, right = np.clip(lines[0] + around, -1, ROWS - 1), np.clip(columns[0] + around, 0, COLUMNS - 1)
        # Above the screen it is empty; elsewhere it goes on as it ends.
        above = np.concatenate([screen, np.zeros((1, COLUMNS), int)])
        windows[row] = above[down][:, right].ravel()
    return windows
