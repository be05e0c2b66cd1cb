"""How far the game with positions and velocities on a lattice strays from the exact one."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from hrljax.envs.mario.engine.quantum import check_quantum
from hrljax.envs.mario.recordings import MARIO_INTS, Trajectory
from hrljax.experiments.mario_fidelity.parity import courses, replay


class Drift(NamedTuple):
    """Of one quantum over recorded games, the same keys played in both. Distances are Mario's, in pixels."""

    quantum: int
    within_pixel: float  # share of ticks in which he is less than a pixel away
    within_tile: float  # share of ticks in which he is less than a tile (16 pixels) away
    median_ticks_within_tile: float  # after how many ticks, in the median game, he is farther
    same_end: float  # share of games that end in the same way: alive, dead, won
    same_kills_and_coins: float  # share of games


def drift(trajectories: Iterable[Trajectory], quantum: int) -> Drift:
    """Plays the keys of recorded games on a lattice and compares Mario with the recordings.

    Raises:
        ValueError: `quantum` is not one of `hrljax.envs.mario.engine.quantum.QUANTA`.
    """
    check_quantum(quantum)
    games = list(trajectories)
    of = courses([game.id for game in games])
    distances, first_away, ends, counts = [], [], [], []
    for game in games:
        record = replay(*of[game.id], game, quantum)
        player = record.player
        apart = np.abs(np.stack([player.x, player.y], axis=1) - game.mario_floats[1:, :2]).max(axis=1)
        distances.append(apart)
        away = np.flatnonzero(apart >= 16)
        first_away.append(away[0] if len(away) else len(apart))
        end = 2 if player.win_time[-1] > 0 else int(player.death_time[-1] > 0)
        ends.append(end == game.final_status)
        totals = [record.counts["kills"][-1], record.counts["coins"][-1]]
        counts.append(totals == [game.mario_ints[-1, MARIO_INTS.index(name)] for name in ("kills", "coins")])
    every = np.concatenate(distances)
    return Drift(
        quantum, float(np.mean(every < 1)), float(np.mean(every < 16)), float(np.median(first_away)),
        float(np.mean(ends)), float(np.mean(counts)),
    )  # fmt: skip


def table(rows: Iterable[Drift]) -> str:
    """The rows as text."""
    lines = [f"{'quantum':>8}{'< 1 px':>9}{'< 1 tile':>10}{'ticks < 1 tile':>16}{'same end':>10}{'same counts':>13}"]
    for row in rows:
        lines.append(
            f"{row.quantum:8}{row.within_pixel:9.1%}{row.within_tile:10.1%}{row.median_ticks_within_tile:16.0f}"
            f"{row.same_end:10.1%}{row.same_kills_and_coins:13.1%}"
        )
    return "\n".join(lines)
