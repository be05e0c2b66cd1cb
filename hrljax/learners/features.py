"""Linear features of states: the few that are active in a state, and their weights."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core import checks
from hrljax.core.numerics import take_row
from hrljax.envs.base import AnyTabularEnvironment, TabularEnvironment


class Active(NamedTuple):
    """The features of one state that may differ from 0, no two alike."""

    numbers: list[Array]  # K int32
    weights: list[Array]  # K float32


@dataclass(frozen=True, eq=False)
class Features:
    """n linear features of the states of an environment, at most K of which are not 0 in any state.

    Compares by value, so that equal ones share compiled code.

    Attributes:
        index: ``[S, K]`` int32, from 0 to ``size - 1``, no two alike in a row.
        weight: ``[S, K]`` float32.
        size: n.

    Raises:
        TypeError: an attribute is of the wrong kind.
        ValueError: a shape or a number does not fit, or a row has a feature twice.
    """

    index: np.ndarray
    weight: np.ndarray
    size: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", checks.integer("size", self.size, 1))
        index = checks.as_array("index", self.index, np.integer, (None, None), "integers")
        weight = checks.as_array("weight", self.weight, np.floating, index.shape, "numbers")
        if not (index.size and index.min() >= 0 and index.max() < self.size):
            raise ValueError(f"index must have numbers of features from 0 to {self.size - 1}")
        if not np.isfinite(weight).all():
            raise ValueError("weight must be finite")
        ordered = np.sort(index, axis=1)
        if twice := np.flatnonzero((ordered[:, 1:] == ordered[:, :-1]).any(1)).tolist():
            raise ValueError(f"index must name a feature once a state, got {index[twice[0]]} in state {twice[0]}")
        for name, array in (("index", index.astype(np.int32)), ("weight", weight.astype(np.float32))):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @staticmethod
    def from_dense(matrix: np.ndarray) -> "Features":
        """Features from ``[S, n]`` numbers, such as those of `BoyanChain.interpolation`."""
        matrix = checks.as_array("matrix", matrix, np.floating, (None, None), "numbers")
        active = max(int((matrix != 0).sum(1).max(initial=0)), 1)
        index = np.argsort(matrix == 0, axis=1, kind="stable")[:, :active]
        return Features(index.astype(np.int32), np.take_along_axis(matrix, index, 1), matrix.shape[1])

    def _contents(self) -> tuple[Any, ...]:
        return (self.size, self.index.shape, self.index.tobytes(), self.weight.tobytes())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Features) and self._contents() == other._contents()

    def __hash__(self) -> int:
        return hash(self._contents())

    def __repr__(self) -> str:
        return f"Features({self.size} features, {self.num_active} of them in a state)"

    @property
    def num_states(self) -> int:
        return len(self.index)

    @property
    def num_active(self) -> int:
        """K."""
        return self.index.shape[1]

    def of(self, state: Array) -> Active:
        """Those of a state (int32)."""
        start, length = state * self.num_active, self.num_active
        index = take_row(jnp.asarray(self.index.ravel()), start, length)
        weight = take_row(jnp.asarray(self.weight.ravel()), start, length)
        return Active([index[m] for m in range(length)], [weight[m] for m in range(length)])

    def dense(self) -> np.ndarray:
        """``[S, n]`` float32."""
        matrix = np.zeros((self.num_states, self.size), np.float32)
        np.put_along_axis(matrix, self.index, self.weight, 1)
        return matrix


def state_features(env: AnyTabularEnvironment) -> Features:
    """One feature a state: what is linear in them is a table.

    Raises:
        TypeError: `env` is no tabular environment.
    """
    _check(env)
    return one_each(env.num_states)


def features_for(env: AnyTabularEnvironment, features: Features | None) -> Features:
    """The features that were given for an environment, one a state if None.

    Raises:
        ValueError: they are over another number of states.
    """
    if features is None:
        return state_features(env)
    if features.num_states != env.num_states:
        raise ValueError(f"the features are over {features.num_states} states, {env.name} has {env.num_states}")
    return features


def one_each(num_states: int) -> Features:
    """A feature for each of so many states."""
    numbers = np.arange(num_states, dtype=np.int32)[:, None]
    return Features(numbers, np.ones(numbers.shape, np.float32), num_states)


def variable_features(env: AnyTabularEnvironment) -> Features:
    """One feature for every value of every variable of a state; what is linear in them adds up over V variables.

    The weights are ``1 / sqrt(V)``, so that the features of a state have length one.

    Args:
        env: its variables are those of `TabularEnvironment.factored`.

    Raises:
        TypeError, ValueError: it has none.
    """
    _check(env)
    factored = env.factored()
    first = np.cumsum([0, *factored.sizes[:-1]])
    index = factored.values + first
    return Features(index, np.full(index.shape, len(first) ** -0.5), sum(factored.sizes))


def tile_features(
    env: AnyTabularEnvironment,
    variables: Sequence[str] | None = None,
    *,
    width: int = 3,
    num_tilings: int = 3,
    apart: Sequence[str] = (),
) -> Features:
    """Tile coding of some variables (Albus 1975; Sutton and Barto 2018, section 9.5.4).

    Tiling t of T covers the variables with tiles that are `width` values wide in each, moved by
    ``t * width // T``; a state is in one tile of every tiling. The weights are ``1 / sqrt(T)``, so that the
    features of a state have length one. Tiles without a state are no features.

    Args:
        env: its variables are those of `TabularEnvironment.factored`.
        variables: names of those that are tiled; all if None, `apart` aside.
        width: of a tile, in values, at least 1.
        num_tilings: at least 1.
        apart: names of variables whose values share no tile.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: a number is out of range, or a name is unknown.
    """
    _check(env)
    factored = env.factored()
    apart = checks.names("apart", apart)
    tiled = [n for n in factored.names if n not in apart] if variables is None else checks.names("variables", variables)
    for name in (*tiled, *apart):
        checks.choice("variables" if name in tiled else "apart", name, factored.names)
    checks.integer("width", width, 1)
    checks.integer("num_tilings", num_tilings, 1)
    columns = {name: factored.values[:, number] for number, name in enumerate(factored.names)}
    tiles = np.stack(
        [
            np.stack(
                [np.full(env.num_states, tiling)]
                + [(columns[name] + tiling * width // num_tilings) // width for name in tiled]
                + [columns[name] for name in apart]
            )
            for tiling in range(num_tilings)
        ]
    )  # [T, 1 + variables, S]
    rows = tiles.transpose(2, 0, 1).reshape(-1, tiles.shape[1])
    kinds, number = np.unique(rows, axis=0, return_inverse=True)
    index = number.reshape(env.num_states, num_tilings)
    return Features(index, np.full(index.shape, num_tilings**-0.5), len(kinds))


def _check(env: object) -> None:
    checks.instance("env", env, TabularEnvironment, "a tabular environment such as hrljax.make('Bus')")
