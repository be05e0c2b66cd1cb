"""Training that goes on: a run and its continuation are the run without a break, bit for bit."""

import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import xarray as xr

import hrljax as hrl
from hrljax.sweeps.continuation import continuation
from hrljax.sweeps.schema import Grid
from tests.maps import SMALL

MAZE = hrl.make("Maze")
KEY = jax.random.key(5)
FIRST, SECOND = 12, 18
LEARNERS: dict[str, tuple[Any, Any]] = {
    "Q-learning, schedules": (
        SMALL,
        hrl.QLearning(step_size=optax.linear_schedule(0.5, 0.1, 30), epsilon=optax.linear_schedule(0.3, 0.0, 20)),
    ),
    "HORDQ, model": (SMALL, hrl.HORDQ(SMALL.hierarchy(), hrl.ModelRoot(interval=4), pseudo_reward=5.0)),
    "HORDQ, random": (SMALL, hrl.HORDQ(SMALL.hierarchy(), hrl.RandomRoot(), bootstrap="on_policy")),
    "MAXQ-Q": (MAZE, hrl.MAXQ(MAZE.hierarchy(), pseudo_reward=2.0)),
    "options": (MAZE, hrl.OptionQ(hrl.options_from(MAZE.hierarchy(), MAZE))),
    "Q(lambda)": (MAZE, hrl.QLambda()),
    "Dyna-Q": (MAZE, hrl.DynaQ()),
    "R-MAX": (MAZE, hrl.RMax()),
}


def assert_same(one: Any, other: Any) -> None:
    jax.tree.map(np.testing.assert_array_equal, one, other)


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
def test_a_run_in_two_parts_is_the_run_in_one(name: str):
    env, learner = LEARNERS[name]

    @jax.jit
    def runs(key: jax.Array) -> Any:
        first = hrl.train(env, learner, key, FIRST, bin_size=3)
        rest = hrl.train(env, learner, key, SECOND, bin_size=3, start=first._replace(episodes=FIRST))
        return hrl.train(env, learner, key, FIRST + SECOND, bin_size=3), first, rest

    whole, first, rest = runs(KEY)
    assert_same(whole.learned, rest.learned)
    assert (whole.steps, whole.episodes) == (rest.steps, rest.episodes)
    assert first.steps < whole.steps
    both = jax.tree.map(lambda a, b: np.concatenate([a, b]), first.metrics, rest.metrics)
    assert_same(whole.metrics, both)


@pytest.fixture(scope="module")
def halves() -> tuple[xr.Dataset, xr.Dataset, xr.Dataset, Any]:
    """A sweep, its continuation, the same in one, and the learner."""
    learner = hrl.HORDQ(SMALL.hierarchy(), hrl.ModelRoot(interval=4))
    options: Any = {
        "seeds": 3, "axes": {"pseudo_reward": [0.0, 5.0]}, "bin_size": 3, "keep_learned": True, "progress": False,
        "key": 4,
    }  # fmt: skip
    first = hrl.sweep(SMALL, learner, num_episodes=FIRST, **options)
    rest = hrl.sweep(SMALL, learner, num_episodes=SECOND, start=first, **options)
    return first, rest, hrl.sweep(SMALL, learner, num_episodes=FIRST + SECOND, **options), learner


def test_a_sweep_in_two_parts_is_the_sweep_in_one(halves: tuple[xr.Dataset, ...]):
    first, rest, whole, _ = halves
    np.testing.assert_array_equal(np.concatenate([first["episode"], rest["episode"]]), whole["episode"])
    for name in whole.data_vars:
        if "episode" in whole[name].dims:
            xr.testing.assert_identical(xr.concat([first[name], rest[name]], "episode"), whole[name])
        else:
            xr.testing.assert_equal(rest[name], whole[name])


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"mapping": "vmap"}, {"chunk_size": 1}])
def test_a_continuation_does_not_depend_on_the_batch(halves: tuple[xr.Dataset, ...], options: Any):
    first, rest, _, learner = halves
    again = hrl.sweep(
        SMALL, learner, seeds=2, num_episodes=SECOND, axes={"pseudo_reward": [5.0]}, bin_size=3, key=4,
        start=first, progress=False, **options,
    )  # fmt: skip
    expected = rest.sel(pseudo_reward=[5.0], seed=[0, 1])
    xr.testing.assert_equal(again, expected.drop_vars([v for v in rest.data_vars if v not in again]))


@pytest.mark.slow
def test_a_continued_run_can_be_saved_and_continued_again(halves: tuple[xr.Dataset, ...], tmp_path: Path):
    first, rest, whole, learner = halves
    for dataset, episodes in ((first, FIRST), (rest, FIRST + SECOND), (whole, FIRST + SECOND)):
        one = hrl.Learned.of(dataset, SMALL, learner, seed=1, at={"pseudo_reward": 5.0})
        assert (one.episodes, one.steps) == (episodes, int(dataset["steps"].sel(seed=1, pseudo_reward=5.0)))
    one = hrl.Learned.of(first, SMALL, learner, seed=1, at={"pseudo_reward": 5.0})
    one.save(tmp_path / "one.npz")
    loaded = hrl.Learned.load(tmp_path / "one.npz", SMALL, one.learner)
    key = jax.random.fold_in(jax.random.key(4), 1)
    run = jax.jit(lambda: hrl.train(SMALL, one.learner, key, SECOND, bin_size=3, start=loaded))()
    assert_same(run.metrics["return"], rest["return"].sel(seed=1, pseudo_reward=5.0).values.astype(np.float32))


@pytest.mark.slow
def test_every_run_of_a_sweep_goes_on_from_one_that_was_learned(halves: tuple[xr.Dataset, ...]):
    first, _, _, learner = halves
    one = hrl.Learned.of(first, SMALL, learner, seed=1, at={"pseudo_reward": 5.0})
    again = hrl.sweep(SMALL, one.learner, seeds=3, num_episodes=SECOND, bin_size=3, key=4, start=one, progress=False)
    expected = halves[1]["return"].sel(pseudo_reward=5.0)
    np.testing.assert_array_equal(again["return"].sel(seed=1), expected.sel(seed=1))
    assert (again["return"].sel(seed=0) != expected.sel(seed=0)).any()  # it went on from the tables of seed 1
    assert again["episode"].values[0] == FIRST + 3


@pytest.mark.slow
def test_a_store_knows_what_its_sweep_started_from(halves: tuple[xr.Dataset, ...], tmp_path: Path):
    first, rest, _, learner = halves
    options: Any = {"seeds": 2, "num_episodes": SECOND, "axes": {"pseudo_reward": [0.0, 5.0]}, "bin_size": 3}
    options |= {"key": 4, "store": tmp_path / "store", "progress": False}
    hrl.sweep(SMALL, learner, start=first, **options)
    np.testing.assert_array_equal(hrl.load(tmp_path / "store")["return"], rest["return"].sel(seed=[0, 1]))
    with pytest.raises(ValueError, match=r"digest\.start"):
        hrl.sweep(SMALL, learner, start=rest.assign_attrs(first.attrs), **options)
    with pytest.raises(ValueError, match="a store whose runs start from a dataset keeps its number of seeds, 2"):
        hrl.sweep(SMALL, learner, start=first, **(options | {"seeds": 3}))


def test_a_store_whose_runs_start_alike_takes_more_seeds(halves: tuple[xr.Dataset, ...]):
    """Their number is not part of what they start with."""
    first, _, _, learner = halves
    one = hrl.Learned.of(first, SMALL, learner, seed=1, at={"pseudo_reward": 5.0})
    grids = [Grid({}, seeds) for seeds in (2, 3)]
    few, many = (continuation(one, SMALL, one.learner, grid, SECOND).digest() for grid in grids)
    assert few == many


def test_starts_that_do_not_fit_are_refused_before_anything_is_compiled(halves: tuple[xr.Dataset, ...]):
    first, _, _, learner = halves
    flat = hrl.QLearning()

    def start(**changes: Any) -> None:
        arguments: Any = {"seeds": 2, "num_episodes": 5, "axes": {"pseudo_reward": [5.0]}, "progress": False}
        hrl.sweep(SMALL, learner, **(arguments | changes))

    with pytest.raises(TypeError, match=re.escape("start must be a dataset of hrljax.sweep(..., keep_learned=True)")):
        start(start=3)
    with pytest.raises(TypeError, match=r"start must be what .* or a .*Learned, got 3"):
        hrl.train(SMALL, flat, KEY, 5, start=3)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"start must be what .* or a .*Learned, got <class 'hrljax.engine.run.Run'>"):
        hrl.train(SMALL, flat, KEY, 5, start=hrl.Run)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no tables; sweep with keep_learned=True"):
        start(start=first[["return", "steps"]])
    with pytest.raises(ValueError, match="start has no runs with seed = 3"):
        start(start=first, seeds=4)
    with pytest.raises(ValueError, match="start has no runs with pseudo_reward = 1"):
        start(start=first, axes={"pseudo_reward": [1.0]})
    with pytest.raises(ValueError, match="start has an axis 'pseudo_reward', which this sweep has not"):
        start(start=first, axes={})
    with pytest.raises(ValueError, match="runs that are not finished"):
        start(start=first.assign(steps=first["steps"].where(first["seed"] > 0)))
    with pytest.raises(ValueError, match="learner is 'HORDQ' there and 'Q-learning' here"):
        hrl.sweep(SMALL, flat, seeds=1, num_episodes=5, start=first, progress=False)
    one = hrl.Learned.of(first, SMALL, learner, seed=1, at={"pseudo_reward": 5.0})
    with pytest.raises(ValueError, match="start must hold the tables of one run of Q-learning on Bus"):
        hrl.train(SMALL, flat, KEY, 5, start=one)
    one.episodes = 2**31 - 10
    with pytest.raises(ValueError, match=r"2147483638 episodes before and 10 more must be below 2\*\*31"):
        hrl.train(SMALL, learner, KEY, 10, start=one)
    with pytest.raises(ValueError, match="episodes must be an integer from 0 to 2147483647, got -1"):
        hrl.Learned(SMALL, learner, one.tables, episodes=-1)


def test_episodes_that_are_traced_do_for_all_but_schedules():
    run = hrl.train(MAZE, hrl.QLearning(), KEY, 3)
    traced = jax.jit(lambda run: hrl.train(MAZE, hrl.QLearning(), KEY, 3, start=run))(run)
    assert int(traced.episodes) == 6
    scheduled = hrl.QLearning(epsilon=optax.linear_schedule(0.5, 0.1, 10))
    with pytest.raises(TypeError, match="epsilon is a schedule, so the episodes of what training starts from"):
        jax.jit(lambda run: hrl.train(MAZE, scheduled, KEY, 3, start=run))(run)


def test_steps_are_not_to_be_had_in_compiled_code():
    with pytest.raises(TypeError, match=r"use Run\.step_words there"):
        jax.jit(lambda: jnp.float32(hrl.train(MAZE, hrl.QLearning(), KEY, 3).steps))()
