"""Hyper-parameters and schedules: what they may be, and what is said of the others before anything is compiled."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.learners.hyperparameters import Tabulated, with_tabulated_schedules


@pytest.mark.parametrize("value", [np.float32(0.25), np.array(0.25), jnp.float32(0.25), np.float16(0.25)], ids=repr)
def test_numpys_numbers_become_plain(value: Any):
    learner = hrljax.QLearning(step_size=value)
    assert learner == hrljax.QLearning(step_size=0.25)
    assert hash(learner) == hash(hrljax.QLearning(step_size=0.25))


def test_numpys_integers_become_plain():
    assert type(hrljax.DynaQ(planning_steps=np.int64(3)).planning_steps) is int  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "schedule", [lambda e: 0.5, lambda e: 1, lambda e: jnp.where(e < 0, 1.0, 0.5), lambda e: np.float64(0.5)]
)
def test_a_schedule_may_return_any_number(schedule: Any):
    table = with_tabulated_schedules(hrljax.QLearning(step_size=schedule), 3).step_size  # type: ignore[attr-defined]
    assert isinstance(table, Tabulated)
    assert table.values.dtype == np.float32
    assert table.values.tolist() == [float(schedule(jnp.int32(0)))] * 3


@pytest.mark.parametrize(
    ("schedule", "message"),
    [
        (lambda e: None, "the schedule of QLearning: step_size must return one number for an episode, not None"),
        (lambda e: "a", "the schedule of QLearning: step_size must return one number for an episode, not 'a'"),
        (lambda e: e < 5, r"the schedule of QLearning: step_size must return one number for an episode, not bool\[\]"),
        (lambda e: jnp.ones(3), r"the schedule of QLearning: step_size must return one number .* not float32\[3\]"),
        (lambda e: (0.1,), r"the schedule of QLearning: step_size must return one number for an episode, not \(0.1,\)"),
        (
            lambda e: 0.1 if e < 5 else 0.2,
            "the schedule of QLearning: step_size decides in Python .*jnp.where .* if, and &",
        ),
        (lambda e: 0.1 * (e > 1 and e < 3), "the schedule of QLearning: step_size decides in Python .*&, | and ~"),
        (lambda e: math.exp(-e), "the schedule of QLearning: step_size gives Python or NumPy .*use jax.numpy"),
        (lambda e: [0.1, 0.2, 0.3][e], "the schedule of QLearning: step_size gives Python or NumPy .*use jax.numpy"),
    ],
)
def test_what_is_no_schedule_is_refused_with_what_to_write(schedule: Any, message: str):
    with pytest.raises(TypeError, match=message) as refused:
        with_tabulated_schedules(hrljax.QLearning(step_size=schedule), 3)
    assert "Tracer" not in str(refused.value)


@pytest.mark.parametrize(
    ("schedule", "message"),
    [
        (lambda e: 0.0, r"step_size must be .* in \(0, 1\], got 0.0 by its schedule at episode 0"),
        (lambda e: math.nan, r"step_size must be .* in \(0, 1\], got nan by its schedule at episode 0"),
        (
            lambda e: 0.5 + e.astype(jnp.float32),
            r"step_size must be .* in \(0, 1\], got 2.5 by its schedule at episode 2",
        ),
    ],
)
def test_a_schedule_stays_in_its_interval(schedule: Any, message: str):
    with pytest.raises(ValueError, match=message):
        with_tabulated_schedules(hrljax.QLearning(step_size=schedule), 3)
