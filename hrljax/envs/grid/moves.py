"""Moves on a grid that may slip sideways."""

import numpy as np
from jax import Array

from hrljax.core.numerics import take
from hrljax.core.random import count_below

_TURNS = (0, 1, 3)
"""Quarter turns to the right of the three outcomes of a move: straight on, to the right, to the left."""


def move_table(neighbour: np.ndarray, directions: tuple[int | None, ...], blocked_moves_slip: bool) -> np.ndarray:
    """``[cells * actions * 3]`` int32: cells that the outcomes of every action reach.

    Args:
        neighbour: ``[cells, 4]``, as of `hrljax.envs.grid.ascii_map.neighbours`.
        directions: for each action its index in `hrljax.envs.grid.ascii_map.MOVES`; None for one that does not move.
        blocked_moves_slip: whether a move against a wall may slip, or stays where it is.
    """
    cells = np.arange(len(neighbour))
    table = np.empty((len(neighbour), len(directions), len(_TURNS)), np.int32)
    for action, direction in enumerate(directions):
        for outcome, turn in enumerate(_TURNS):
            if direction is None:
                table[:, action, outcome] = cells
                continue
            reached = neighbour[:, (direction + turn) % 4]
            stays = (neighbour[:, direction] == cells) & (not blocked_moves_slip)
            table[:, action, outcome] = np.where(stays, cells, reached)
    return table.ravel()


def moved(table: Array, num_actions: int, cell: Array, action: Array, word: Array, slip: Array | float) -> Array:
    """The cell (int32) that an action reaches: with probability `slip` a move turns to either side, equally often."""
    outcome = count_below(word, slip_cuts(slip))
    return take(table, (cell * num_actions + action) * len(_TURNS) + outcome)


def slip_cuts(slip: Array | float) -> tuple[Array | float, ...]:
    """The probabilities at which the outcome of a move changes."""
    return slip * 0.5, slip


def row_and_column(cell: Array, width: int) -> dict[str, Array]:
    """The two variables of a cell."""
    return {"row": cell // width, "column": cell % width}
