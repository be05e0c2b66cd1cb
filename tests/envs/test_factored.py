"""Factored states: the variables of the library's environments, and what is no factored state."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from tests.envs.corridor import Corridor
from tests.envs.test_every_environment import all_states, each_variant, made


@each_variant
def test_numbers_and_variables_lead_to_each_other(variant: str):
    env, _ = made(variant)
    factored = env.factored()
    states = np.arange(env.num_states)
    np.testing.assert_array_equal(factored.number[factored.place(factored.values.T)], states)
    assert (factored.number >= 0).sum() == env.num_states
    assert factored.number.shape == (np.prod(factored.sizes),)
    by_name = jax.vmap(env.variables)(all_states(env))
    assert tuple(factored.names) == tuple(env.variables(env.decode(0)))
    for name, size, column in zip(factored.names, factored.sizes, factored.values.T, strict=True):
        np.testing.assert_array_equal(column, by_name[name])
        assert (column.min(), column.max()) == (0, size - 1)


@pytest.mark.parametrize(
    ("env", "state", "expected"),
    [
        (
            hrl.make("Bus"),
            {"cell": 14, "damaged": 1, "picked": 0b101, "road": 2},
            {"row": 2, "column": 2, "damaged": 1, "passenger_1": 1, "passenger_2": 0, "passenger_3": 1, "road": 2},
        ),
        (
            hrl.make("Taxi"),
            {"cell": 13, "passenger": 4, "destination": 1, "fickle": 0},
            {"row": 2, "column": 3, "passenger": 4, "destination": 1},
        ),
        (
            hrl.make("Taxi", fickle=True),
            {"cell": 24, "passenger": 0, "destination": 3, "fickle": 1},
            {"row": 4, "column": 4, "passenger": 0, "destination": 3, "fickle": 1},
        ),
        (hrl.make("Maze"), {"cell": 11}, {"row": 1, "column": 5}),
        (hrl.make("Gridworld", map="S..\n..G"), {"cell": 4}, {"row": 1, "column": 1}),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_the_variables_of_one_state(env: Any, state: dict[str, int], expected: dict[str, int]):
    fields = {name: jnp.int32(value) for name, value in state.items()}
    number = int(env.encode(type(env.decode(0))(**fields, time=jnp.int32(3))))
    factored = env.factored()
    assert dict(zip(factored.names, factored.values[number].tolist(), strict=True)) == expected


def test_the_fields_of_the_state_are_variables_by_default():
    env = hrl.make("Taxi", fickle=True)
    factored = hrl.TabularEnvironment.variables(env, env.decode(jnp.int32(987)))
    assert {name: int(value) for name, value in factored.items()} == {
        "cell": 24,
        "passenger": 1,
        "destination": 3,
        "fickle": 1,
    }
    assert Corridor().factored().number.max() == Corridor().num_states - 1


@pytest.mark.parametrize(
    ("said", "error", "message"),
    [
        (lambda s: {}, ValueError, "must name at least one variable"),
        (lambda s: {"cell": s.cell.astype(jnp.float32)}, TypeError, "variables: 'cell' must return one integer"),
        (lambda s: {"cell": jnp.stack([s.cell, s.cell])}, TypeError, "variables: 'cell' must return one integer"),
        (lambda s: {"cell": s.cell - 1}, ValueError, "must not be negative, got -1 as 'cell'"),
        (lambda s: {"half": s.cell // 2}, ValueError, "must tell all states apart: states 0 and 9 both have half 0"),
        (lambda s: {"cell": s.cell, "far": s.cell * 2_000_000}, ValueError, "at most 4194304 combinations"),
    ],
)
def test_what_is_no_set_of_variables_is_refused(said: Any, error: type[Exception], message: str):
    class Wrong(Corridor):
        def variables(self, state: Any) -> Any:
            return said(state)

    with pytest.raises(error, match=message):
        Wrong().factored()


def test_check_looks_at_variables():
    class Wrong(Corridor):
        def variables(self, state: Any) -> Any:
            return {"cell": state.cell}

    with pytest.raises(ValueError, match="must tell all states apart"):
        hrl.check(Wrong())
