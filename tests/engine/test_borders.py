"""A learner that gives back something else than it was given is told which class, which field, and how it differs."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import pytest

import hrljax
from hrljax.engine.borders import check_given_back
from hrljax.learners.base import LearnerState, Reported
from tests.maps import SMALL


@dataclass(frozen=True)
class Faulty(hrljax.SARSALambda):
    """Breaks what `learn` or `plan` returns."""

    fault: str = "none"

    name = "faulty"

    @property
    def planning_interval(self) -> int:
        return 1

    @property
    def reports(self) -> tuple[str, ...]:
        return ("nothing",) if self.fault in ("report", "vector") else ()

    def learn(self, *arguments: Any) -> Any:
        tables, control = super().learn(*arguments)
        if self.fault == "dtype":
            control = control._replace(visits=control.visits.astype(jnp.float32))
        if self.fault == "shape":
            tables = tables._replace(values=tables.values.reshape(-1, 4))
        if self.fault == "field":
            control = control.action
        if self.fault == "vector":
            return Reported(LearnerState(tables, control), (jnp.zeros(2),))
        return (tables, control) if self.fault == "type" else LearnerState(tables, control)

    def plan(self, prepared: Any, tables: Any, context: Any) -> Any:
        return tables._replace(values=tables.values[1:]) if self.fault == "plan" else tables


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("dtype", r"Faulty: learn must return arrays as .*: control.visits was int32 \[\], now it is float32 \[\]"),
        ("shape", r"Faulty: learn .*: tables.values was float32 \[1536\], now it is float32 \[384, 4\]"),
        ("field", r"Faulty: learn must return the same fields as it was given: control.action is missing"),
        ("type", r"Faulty: learn must return a LearnerState, got a tuple"),
        ("plan", r"Faulty: plan .*: values was float32 \[1536\], now it is float32 \[1535\]"),
        ("vector", r"Faulty: learn must report one number as 'nothing', got float32 \[2\]"),
        ("report", r"Faulty: learn must report a number for each of \('nothing',\), got 0"),
    ],
)
def test_what_a_learner_gives_back_is_checked(fault: str, message: str):
    with pytest.raises(TypeError, match=message):
        hrljax.train(SMALL, Faulty(fault=fault), jax.random.key(0), 2)


def test_what_is_as_it_was_passes():
    hrljax.train(SMALL, Faulty(), jax.random.key(0), 1, params=SMALL.default_params._replace(max_steps=3))
    check_given_back("x", {"a": jnp.zeros(2)}, {"a": jnp.ones(2)})
    with pytest.raises(TypeError, match=r"x must return the same fields as it was given: .'b'. was not given"):
        check_given_back("x", {"a": jnp.zeros(2)}, {"a": jnp.ones(2), "b": 1})
