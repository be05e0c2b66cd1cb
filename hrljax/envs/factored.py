"""Factored states: what the number of a state means, variable by variable."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core import checks, contract
from hrljax.core.environment import AnyTabularDynamics
from hrljax.core.tracing_errors import explain_tracing
from hrljax.hierarchy.tables import over_states

MAX_COMBINATIONS = 1 << 22
"""Combinations of values, some of which may belong to no state."""


class FactoredStates(NamedTuple):
    """States as values of V variables; a variable's values are 0, 1, ... below its size."""

    names: tuple[str, ...]  # V
    sizes: tuple[int, ...]  # V: number of values
    values: np.ndarray  # [S, V] int32: of each state number
    number: np.ndarray  # [product of sizes] int32: the state of each combination of values, -1 where there is none

    def place(self, values: Any) -> Any:
        """Where the state of some values stands in `number`: the last variable changes fastest.

        Args:
            values: V integers or int32 arrays of one shape, each from 0 to below its variable's size.
        """
        place = values[0]
        for size, value in zip(self.sizes[1:], values[1:], strict=True):
            place = place * size + value
        return place


def factored_states(env: AnyTabularDynamics, variables: Callable[[Any], Mapping[str, Array]]) -> FactoredStates:
    """What the variables of every state are.

    Args:
        env: whose states.
        variables: by name, of one state; `hrljax.TabularEnvironment.variables`.

    Raises:
        TypeError: a variable is no integer.
        ValueError: there is none, a value is negative or an array, two states have the same values, or there are
            more than `MAX_COMBINATIONS` combinations of values.
    """
    where = f"{env.name}: variables"
    with jax.ensure_compile_time_eval(), explain_tracing(where):
        names = tuple(variables(contract.decode(env, jnp.int32(0))))
    if not names:
        raise ValueError(f"{where} must name at least one variable")
    columns = {
        name: over_states(
            lambda state, name=name: variables(state)[name],
            env,
            f"{where}: {name!r}",
            (np.bool_, np.integer),
            "one integer",
        )
        for name in checks.names(where, names)
    }
    for name, column in columns.items():
        if column.min() < 0:
            raise ValueError(f"{where} must not be negative, got {column.min()} as {name!r}")
    values = np.stack(list(columns.values()), -1).astype(np.int32)
    sizes = tuple(int(most) + 1 for most in values.max(0))
    if math.prod(sizes) > MAX_COMBINATIONS:
        raise ValueError(
            f"{where} must have at most {MAX_COMBINATIONS} combinations of values, got sizes "
            + ", ".join(f"{name} {size}" for name, size in zip(columns, sizes, strict=True))
        )
    number = np.full(math.prod(sizes), -1, np.int32)
    factored = FactoredStates(names, sizes, values, number)
    places = factored.place(values.T.astype(np.int64))
    number[places] = np.arange(len(values))
    if len(twice := np.flatnonzero(number[places] != np.arange(len(values)))):
        first = int(twice[0])
        raise ValueError(
            f"{where} must tell all states apart: states {first} and {number[places[first]]} both have "
            + ", ".join(f"{name} {value}" for name, value in zip(columns, values[first].tolist(), strict=True))
        )
    return factored
