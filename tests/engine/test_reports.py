"""Columns that a learner reports: the mean absolute TD error of Q-learning and SARSA."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import hrljax
from hrljax.learners.base import LearnerState, Transition
from tests.contexts import learning
from tests.maps import SMALL

PARAMS = SMALL.default_params._replace(max_steps=50)
OPTIONS: dict[str, Any] = {"seeds": 3, "num_episodes": 12, "bin_size": 4, "params": PARAMS, "progress": False}


@pytest.mark.parametrize("old", [0.0, 20.0])
@pytest.mark.parametrize("learner", [hrljax.QLearning, hrljax.SARSA])
def test_a_step_reports_its_absolute_td_error(learner: Any, old: float):
    reporting = learner(step_size=0.5, discount=0.5, epsilon=0.0, report_td_error=True)
    state = reporting.init(SMALL, 4)
    state = LearnerState(state.tables.at[4 * 7].set(8.0).at[3 * 4 + 2].set(old), state.control)
    transition = Transition(*(np.int32(x) for x in (3, 2)), np.float32(-1), np.int32(7), np.bool_(False))
    after, report = reporting.learn(4, state, jax.tree.map(jax.numpy.asarray, transition), (np.uint32(5),), learning())
    error = -1 + 0.5 * 8 - old
    assert report == (abs(error),)
    assert after.tables[3 * 4 + 2] == old + 0.5 * error


@pytest.mark.parametrize("mapping", ["native", pytest.param("vmap", marks=pytest.mark.slow)])
def test_the_column_is_in_sweeps_and_stores_and_changes_nothing_else(mapping: Any, tmp_path: Path):
    plain = hrljax.sweep(SMALL, hrljax.QLearning(), mapping=mapping, **OPTIONS)
    told = hrljax.sweep(
        SMALL, hrljax.QLearning(report_td_error=True), mapping=mapping, store=tmp_path / "told", **OPTIONS
    )
    assert "td_error" not in plain
    for name in plain.data_vars:
        np.testing.assert_array_equal(plain[name], told[name])
    assert told["td_error"].dims == ("seed", "episode")
    assert 0 < float(told["td_error"].min()) < float(told["td_error"].max()) < 60
    np.testing.assert_array_equal(hrljax.load(tmp_path / "told")["td_error"], told["td_error"])


def test_the_column_is_the_mean_over_the_steps_of_a_bin():
    """With a step size of 1 and no discount each error is what a value moves by."""
    learner = hrljax.QLearning(step_size=1.0, discount=0.0, epsilon=0.0, report_td_error=True)
    params = PARAMS._replace(max_steps=1, slip_probability=0.0)
    run = hrljax.train(SMALL, learner, jax.random.key(1), 1, params=params)
    (moved,) = np.flatnonzero(np.asarray(run.learned))
    assert run.metrics["td_error"].tolist() == [abs(float(run.learned[moved]))]
