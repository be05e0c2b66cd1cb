"""Maps, and what tests do with them."""

import numpy as np

import hrljax
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.solvers import Model

SMALL = hrljax.make(
    "Bus",
    map="""\
+---+---+---+---+
| 1   1P| 2   2 |
+   +   +   +   +
| 1S  1 A 2   2P|
+---+   +---+ B +
| 3   3   4   4 |
+---+---+---+---+
""",
)
"""A Bus domain small enough to compile and solve in a moment, with everything that the large one has."""


def written_over(text: str, row: int, column: int, new: str) -> str:
    """`text` with `new` written over what begins at a row and column, both counted from 1."""
    lines = text.splitlines()
    lines[row - 1] = lines[row - 1][: column - 1] + new + lines[row - 1][column - 1 + len(new) :]
    return "\n".join(lines)


def optimum(env: AnyTabularEnvironment) -> float:
    """What the best policy earns in an episode without a limit of steps."""
    return float(env.initial_distribution() @ hrljax.solvers.value_iteration(env.model()).value)


def occurring(model: Model, starts: np.ndarray) -> np.ndarray:
    """``[S]`` bool: states in which an episode can have a next step; `starts` are probabilities of first states."""
    successors = model.successors().reshape(model.num_states, -1)
    occurs, before = starts > 0, np.zeros(model.num_states, np.bool_)
    while (occurs != before).any():
        before = occurs.copy()
        following = successors[before]
        occurs[following[following >= 0]] = True
    return occurs
