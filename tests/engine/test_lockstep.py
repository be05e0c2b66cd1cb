"""Runs that take their steps together: bins, plans and ends at times of their own, in batches of any size."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

import hrljax
from hrljax.core.numerics import put_row
from hrljax.engine import batch
from hrljax.learners.base import Context, Learner, LearnerState, Transition, Words

MAZE = hrljax.make("Maze")
EPISODES, INTERVAL = 13, 3


class Log(NamedTuple):
    steps: Array  # int32
    plans: Array  # int32
    steps_before: Array  # [plans] int32: steps before each plan


class Planner(Learner[None, Log, Array]):
    """Walks at random, and notes how many steps it had taken before each of its plans."""

    name = "planner"
    num_words = 1
    num_begin_words = 1
    planning_interval = INTERVAL

    def prepare(self, env: Any) -> None:
        return None

    def init(self, env: Any, prepared: None) -> LearnerState:
        log = Log(jnp.int32(0), jnp.int32(0), jnp.full(EPISODES, -1, jnp.int32))
        return LearnerState(log, jnp.int32(0))

    def begin(self, prepared: None, tables: Log, first: Array, words: Words, context: Context) -> Array:
        return (words[0] % 4).astype(jnp.int32)

    def action(self, control: Array) -> Array:
        return control

    def learn(
        self, prepared: None, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        tables: Log = state.tables
        steps = tables.steps + jnp.asarray(context.learns).astype(jnp.int32)
        return LearnerState(tables._replace(steps=steps), (words[0] % 4).astype(jnp.int32))

    def plan(self, prepared: None, tables: Log, context: Context) -> Log:
        before = put_row(tables.steps_before, tables.plans, tables.steps[None])
        return Log(tables.steps, tables.plans + 1, before)


@pytest.mark.parametrize("mapping", ["native", "vmap"])
@pytest.mark.parametrize("bin_size", [1, 4, EPISODES])
def test_runs_that_plan_together_plan_when_they_would_alone(mapping: Any, bin_size: int):
    """Before the first step of every third episode, once, wherever bins and blocks of random words end."""
    options = {"params": MAZE.default_params._replace(max_steps=150), "seeds": 5, "num_episodes": EPISODES}
    swept = hrljax.sweep(
        MAZE, Planner(), **options, bin_size=bin_size, keep_learned=True, mapping=mapping, progress=False
    )
    each = hrljax.sweep(MAZE, Planner(), **options, bin_size=1, mapping="native", progress=False)
    steps_before = np.cumsum(np.pad(each["length"].values, ((0, 0), (1, 0))), axis=1)[:, :EPISODES:INTERVAL]
    assert len(np.unique(steps_before[:, 1:])) > 10
    log = swept["learned.steps_before"].values
    np.testing.assert_array_equal(log[:, : steps_before.shape[1]], steps_before)
    assert (log[:, steps_before.shape[1] :] == -1).all()
    np.testing.assert_array_equal(swept["learned.plans"], steps_before.shape[1])


@pytest.mark.parametrize("bin_size", [1, pytest.param(7, marks=pytest.mark.slow)])
def test_a_run_that_waits_does_not_begin_another_episode(bin_size: int):
    """Where a step from the start may be the last one, a run that waits for others would take it over and over."""
    beside_the_goal = hrljax.make("Gridworld", map="SG\n..\n..\n")
    options = {"seeds": 5, "num_episodes": 28, "bin_size": bin_size, "keep_learned": True, "chunk_size": 5}
    native, vmap = (
        hrljax.sweep(beside_the_goal, hrljax.QLearning(), **options, mapping=mapping, progress=False)
        for mapping in ("native", "vmap")
    )
    for variable in native:
        np.testing.assert_array_equal(native[variable], vmap[variable], err_msg=str(variable))


def test_runs_may_end_at_very_different_times():
    options = {"seeds": 2, "num_episodes": 40, "bin_size": 7, "axes": {"epsilon": [0.0, 1.0]}, "keep_learned": True}
    native, vmap = (
        hrljax.sweep(MAZE, hrljax.QLearning(), **options, mapping=mapping, chunk_size=4, progress=False)
        for mapping in ("native", "vmap")
    )
    assert native["steps"].max() > 2 * native["steps"].min()
    for variable in native:
        np.testing.assert_array_equal(native[variable], vmap[variable], err_msg=str(variable))


@pytest.mark.parametrize("num_rows", [1, 3, 4, 5, 7, 9])
def test_a_chunk_of_any_size_is_cut_into_groups(num_rows: int):
    rows = {"x": np.arange(num_rows, dtype=np.int32), "y": np.ones((num_rows, 2), np.float32)}
    sizes = []

    def function(row: dict[str, Array]) -> dict[str, Array]:
        total = jax.custom_batching.custom_vmap(lambda x: x)
        total.def_vmap(lambda size, _, x: (sizes.append(size), (x, True))[1])
        return {"twice": total(row["x"]) * 2, "y": row["y"] + 1}

    after = batch.compile_mapped(function, "vmap", group=4)(rows)
    np.testing.assert_array_equal(after["twice"], 2 * np.arange(num_rows))
    np.testing.assert_array_equal(after["y"], np.full((num_rows, 2), 2))
    assert max(sizes) <= 4


def test_runs_in_several_groups_are_those_of_one(monkeypatch: pytest.MonkeyPatch):
    def swept(mapping: Any) -> Any:
        options = {"seeds": 5, "num_episodes": 9, "mapping": mapping, "chunk_size": 5, "key": 3}
        return hrljax.sweep(MAZE, hrljax.SARSA(), **options, keep_learned=True, progress=False)

    native = swept("native")
    monkeypatch.setattr(batch, "group_length", lambda table_bytes: 2)
    vmap = swept("vmap")
    for variable in native:
        np.testing.assert_array_equal(native[variable], vmap[variable], err_msg=str(variable))


def test_the_tables_of_a_group_stay_in_a_cores_cache():
    assert [batch.group_length(size) for size in (0, 1, 100_000, 300_000, 900_000, 1 << 30)] == [64, 64, 64, 27, 9, 8]
