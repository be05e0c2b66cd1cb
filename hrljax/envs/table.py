"""Environments from tables: any finite decision process whose probabilities are known."""

import hashlib
import math
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.environment import Cuts, Events, Words
from hrljax.core.numerics import take, take_row
from hrljax.core.random import WORD_RANGE
from hrljax.envs.base import TabularEnvironment
from hrljax.solvers.model import Model, check_model


class TableState(NamedTuple):
    """All fields are int32 scalars."""

    number: Array
    time: Array  # steps taken in this episode


class TableParams(NamedTuple):
    """A table has no numbers to change but the limit of steps."""

    max_steps: int


class Table:
    """A model and where episodes begin; immutable, equal to every other with the same content.

    Args:
        model: S states, A actions, K outcomes.
        initial: ``[S]`` probabilities of the first state.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: a shape does not fit, a next state does not exist, probabilities are negative or
            do not sum to one, or a reward is not finite.
    """

    def __init__(self, model: Model, initial: np.ndarray):
        check_model(model)
        self.model = Model(*(_frozen(field) for field in model))
        self.initial = _frozen(checks.probabilities("initial", initial, model.num_states))
        digest = hashlib.sha256(repr([field.shape for field in self.model]).encode())
        for field in (*self.model, self.initial):
            digest.update(field.tobytes())
        self._digest = digest.hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Table) and self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    def __repr__(self) -> str:
        return f"Table({self.model.num_states} states, {self.model.num_actions} actions, {self._digest[:12]})"

    def outcome_words(self) -> np.ndarray:
        """``[S, A, K - 1]`` uint32: the first word of every outcome but the first one."""
        return _first_words(self.model.probability)

    def initial_words(self) -> tuple[np.ndarray, np.ndarray]:
        """States (int32 ``[n]``) where episodes begin, and the first word of each but the first one."""
        states = np.flatnonzero(self.initial).astype(np.int32)
        return states, _first_words(self.initial[states])


@dataclass(frozen=True)
class TableEnvironment(TabularEnvironment[TableState, TableParams]):
    """A `Table` to act in.

    The model is the table's, exactly. In simulation, one word decides among the outcomes, so that
    their probabilities are rounded to multiples of ``2**-24``.

    Attributes:
        table: the process.
        name: of the environment.
        max_steps: default limit of steps.
        action_names: one for each action; their numbers if empty.
        shape: if states are the cells of a map, numbered row by row, its rows and columns. Then pictures show it, and
            `variables` are row and column.

    Raises:
        TypeError, ValueError: an attribute is of the wrong kind, or does not fit the table.
    """

    table: Table
    name: str = "Table"  # type: ignore[misc]
    max_steps: int = 1000
    action_names: tuple[str, ...] = ()  # type: ignore[misc]
    shape: tuple[int, int] | None = None

    num_words = 1
    num_initial_words = 1

    def __post_init__(self) -> None:
        checks.instance("table", self.table, Table, "a Table(model, initial)")
        checks.text("name", self.name, "'Table'")
        object.__setattr__(self, "max_steps", checks.integer("max_steps", self.max_steps, 1))
        object.__setattr__(self, "action_names", checks.names("action_names", self.action_names))
        count = self.table.model.num_actions
        if not self.action_names:
            object.__setattr__(self, "action_names", tuple(map(str, range(count))))
        if len(self.action_names) != count:
            raise ValueError(f"action_names must have {count} names, got {self.action_names!r}")
        if self.shape is not None:
            shape = checks.sequence_of("shape", self.shape, int, "integers")
            if len(shape) != 2 or min(shape) < 1 or math.prod(shape) != self.num_states:
                raise ValueError(f"shape must be rows and columns of {self.num_states} cells, got {shape}")
            object.__setattr__(self, "shape", shape)

    @property
    def renderer(self) -> str | None:  # pyright: ignore[reportIncompatibleVariableOverride] (depends on a field)
        return "hrljax.envs.grid.variable_render" if self.shape else None

    def variables(self, state: TableState) -> dict[str, Array]:
        """Row and column if there is a `shape`; else the number."""
        if self.shape is None:
            return {"number": state.number}
        columns = np.int32(self.shape[1])
        return {"row": lax.div(state.number, columns), "column": lax.rem(state.number, columns)}

    @property
    def default_params(self) -> TableParams:
        return TableParams(self.max_steps)

    @property
    def num_states(self) -> int:
        return self.table.model.num_states

    def encode(self, state: TableState) -> Array:
        return state.number

    def decode(self, index: Array) -> TableState:
        return TableState(jnp.asarray(index, jnp.int32), jnp.int32(0))

    def initial(self, words: Words, params: TableParams) -> TableState:
        states, firsts = self.table.initial_words()
        return self.decode(take(jnp.asarray(states), _number_of_outcome(words[0], jnp.asarray(firsts))))

    def initial_word_cuts(self, params: TableParams) -> Cuts:
        return (_cuts(self.table.initial_words()[1]),)

    def word_cuts(self, params: TableParams) -> Cuts:
        return (_cuts(self.table.outcome_words()),)

    def transition(
        self, state: TableState, action: Array, words: Words, params: TableParams
    ) -> tuple[TableState, Array, Array, Events]:
        model, firsts = self.table.model, self.table.outcome_words()
        pair, count = state.number * self.num_actions + action, firsts.shape[-1]
        row = take_row(jnp.asarray(firsts.ravel()), pair * count, count) if count else jnp.zeros(0, jnp.uint32)
        place = pair * (count + 1) + _number_of_outcome(words[0], row)

        def drawn(field: np.ndarray, dtype: type) -> Array:
            return take(jnp.asarray(field.astype(dtype).ravel()), place)

        after = TableState(drawn(model.next_state, np.int32), state.time + 1)
        return after, drawn(model.reward, np.float32), drawn(model.terminated, np.bool_), {}

    def model(self, params: TableParams | None = None) -> Model:
        """The table."""
        return self.table.model

    def initial_distribution(self, params: TableParams | None = None) -> np.ndarray:
        """Probability of each state number at the start of an episode, float64 ``[S]``."""
        return self.table.initial


def _frozen(array: np.ndarray) -> np.ndarray:
    copy = np.array(array)
    copy.flags.writeable = False
    return copy


def _first_words(probability: np.ndarray) -> np.ndarray:
    """``[..., K - 1]`` uint32: where the words of outcomes 1, 2, ... begin."""
    return np.rint(np.cumsum(probability, -1)[..., :-1] * WORD_RANGE).astype(np.uint32)


def _number_of_outcome(word: Array, firsts: Array) -> Array:
    return (word >= firsts).sum(dtype=jnp.int32)


def _cuts(first_words: np.ndarray) -> tuple[float, ...]:
    return tuple((np.unique(first_words) / WORD_RANGE).tolist())
