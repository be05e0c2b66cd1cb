"""Sweeps: labels, attributes, values, and arguments that are refused before anything is compiled."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import xarray as xr

import hrljax
from hrljax.engine import batch
from hrljax.engine.train import run_once
from hrljax.envs.bus.env import Bus, BusParams
from hrljax.envs.grid.maze import Maze
from tests.maps import SMALL

HIERARCHY = Bus().hierarchy()
EPISODES, BIN_SIZE, SEEDS = 10, 4, 3
PLANNED = hrljax.HORDQ(SMALL.hierarchy(), hrljax.ModelRoot(unknown_value=-28.0, interval=2), pseudo_reward=5.0)
AXES = {"root.step_size": [0.5, 0.125], "env.slip_probability": [0.0, 0.25]}


@pytest.fixture(scope="module")
def grid() -> xr.Dataset:
    """Two axes, one of the root and one of the environment."""
    options = {"seeds": SEEDS, "num_episodes": EPISODES, "bin_size": BIN_SIZE, "chunk_size": 3, "progress": False}
    return hrljax.sweep(SMALL, PLANNED, **options, axes=AXES, key=7, params=BusParams(max_steps=200))


def test_dimensions_are_the_axes_then_seeds_then_bins(grid: xr.Dataset):
    assert list(grid["return"].dims) == ["root.step_size", "env.slip_probability", "seed", "episode"]
    assert list(grid) == ["return", "length", "damage", "breakdown", "truncated", "steps"]
    assert {name: grid[name].values.tolist() for name in grid.coords} == {
        **AXES,
        "seed": [0, 1, 2],
        "episode": [4, 8, 10],
    }
    assert grid["steps"].dims == grid["return"].dims[:-1]
    assert {variable.dtype for variable in grid.values()} == {np.dtype(np.float64)}
    assert not grid.isnull().any().to_array().any()


def test_attributes_name_every_setting(grid: xr.Dataset):
    attributes = dict(grid.attrs)
    assert attributes.pop("seconds") > 0
    assert attributes.pop("compile_seconds") > 0
    for package in ("hrljax", "jax", "jaxlib", "numpy", "xarray"):
        assert attributes.pop(f"version.{package}")[0].isdigit()
    assert attributes.pop("env.map") == SMALL.map
    assert attributes.pop("learner.hierarchy").startswith("Hierarchy(Root -> Move(1)")
    assert json.loads(attributes.pop("key")) == [0, 7]
    assert attributes == {
        "environment": "Bus",
        "learner": "HORDQ",
        "learner.root": "ModelRoot",
        "learner.root.step_size": "swept",
        "learner.root.unknown_value": -28.0,
        "learner.root.interval": 2,
        "learner.root.sweeps": 5,
        "learner.pseudo_reward": 5.0,
        "learner.step_size": 0.1,
        "learner.epsilon": 0.1,
        "learner.discount": 1.0,
        "learner.initial_value": 0.0,
        "learner.bootstrap": "greedy",
        "env.slip_probability": "swept",
        "env.damage_probability": 1.0,
        "env.breakdown_probability": 0.25,
        "env.road_change_probability": 0.05,
        "env.step_reward": -1.0,
        "env.breakdown_reward": -51.0,
        "env.max_steps": 200,
        "env.site": "edge",
        "env.slip": "any",
        "env.road_change": "other",
        "env.breakdown": "before",
        "num_episodes": EPISODES,
        "bin_size": BIN_SIZE,
        "mapping": "native",
        "complete": 1,
    }


def test_values_are_those_of_train_with_the_folded_key(grid: xr.Dataset):
    @jax.jit
    def run(key: jax.Array, step_size: jax.Array, slip: jax.Array) -> hrljax.Run:
        params = BusParams(max_steps=200)._replace(slip_probability=slip)
        learner = PLANNED.replaced({"root.step_size": step_size})
        return hrljax.train(SMALL, learner, key, EPISODES, params=params, bin_size=BIN_SIZE)

    for (i, j, seed), steps in np.ndenumerate(grid["steps"].values):
        numbers = [jnp.float32(values[k]) for values, k in zip(AXES.values(), (i, j), strict=True)]
        found = run(jax.random.fold_in(jax.random.key(7), seed), *numbers)
        assert int(found.steps) == steps
        for name, values in found.metrics.items():
            np.testing.assert_array_equal(grid[name][i, j, seed], values, err_msg=name)


def test_a_column_that_a_run_returns_is_in_the_dataset_and_in_the_store(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    def run_with_a_column(*arguments: Any, **options: Any) -> hrljax.Run:
        run = run_once(*arguments, **options)
        return run._replace(metrics={**run.metrics, "a column": 2 * run.metrics["length"]})

    monkeypatch.setattr("hrljax.sweeps.job.run_once", run_with_a_column)
    swept = hrljax.sweep(Maze(), hrljax.SARSA(), seeds=2, num_episodes=7, store=tmp_path / "store", progress=False)
    assert list(swept) == ["return", "length", "truncated", "a column", "steps"]
    for dataset in (swept, hrljax.load(tmp_path / "store")):
        assert (dataset["a column"].dims, dataset["a column"].dtype) == (("seed", "episode"), np.float64)
        np.testing.assert_array_equal(dataset["a column"], 2 * dataset["length"])


def test_a_schedule_and_a_key_are_told_in_the_attributes():
    learner = hrljax.QLearning(epsilon=optax.constant_schedule(0.2))
    key = jax.random.fold_in(jax.random.key(3), 5)
    found = hrljax.sweep(Bus(), learner, seeds=2, num_episodes=2, key=key, progress=False)
    assert "schedule" in found.attrs["learner.epsilon"]
    assert json.loads(found.attrs["key"]) == jax.random.key_data(key).tolist()
    assert found.attrs["bin_size"] == 1


@pytest.fixture
def nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise AssertionError("the sweep went on to compile")

    monkeypatch.setattr(batch, "compile_mapped", refuse)


REFUSED: list[tuple[dict[str, Any], str]] = [
    *(({"seeds": value}, f"seeds must be an integer from 1 to 2147483647, got {value}") for value in (-1, 0, 2**31)),
    ({"num_episodes": 0}, "num_episodes must be an integer from 1 to 2147483647, got 0"),
    ({"num_episodes": 2**31}, "num_episodes must be an integer from 1 to 2147483647, got 2147483648"),
    ({"bin_size": 0}, "bin_size must be an integer from 1 to 2147483647, got 0"),
    ({"cores": 0}, "cores must be an integer from 1 to 2147483647, got 0"),
    ({"chunk_size": -1}, "chunk_size must be an integer from 1 to 2147483647, got -1"),
    ({"evaluate_every": 0}, "evaluate_every must be an integer from 1 to 2147483647, got 0"),
    ({"evaluate_every": 6}, "evaluate_every must be at most the number of bins, got 6"),
    ({"evaluate_every": 1, "axes": {"env.slip_probability": [0.1]}}, "evaluate_every needs fixed params"),
    ({"mapping": "pmap"}, "mapping must be one of 'auto', 'native', 'vmap', got 'pmap'"),
    ({"axes": {"kappa": [1.0]}}, "'kappa' cannot be swept; sweepable are .*root.step_size, .*env.step_reward"),
    ({"axes": {"bootstrap": [1.0]}}, "'bootstrap' cannot be swept; sweepable are "),
    ({"axes": {"root.interval": [1.0]}}, "'root.interval' cannot be swept; sweepable are .*root.step_size"),
    ({"axes": {"env.max_steps": [10.0]}}, "'env.max_steps' cannot be swept, for it only says where episodes are cut"),
    ({"axes": {"step_size": []}}, r"'step_size' must be at least one and different, got \[\]"),
    ({"axes": {"step_size": [0.1, 0.2, 0.1]}}, "'step_size' must be at least one and different"),
    ({"axes": {"initial_value": [1e60]}}, r"initial_value must be a finite number .*3\.4e\+38\], got 1e\+60"),
    ({"axes": {"step_size": [0.1, 1.5]}}, r"step_size must be a finite number in \(0, 1\], got 1\.5"),
    ({"axes": {"root.step_size": [0.0]}}, r"step_size must be a finite number in \(0, 1\], got 0\.0"),
    ({"axes": {"env.slip_probability": [1.5]}}, r"env\.slip_probability.* must be .* in \[0, 1\], got 1\.5"),
    ({"axes": {"env.step_reward": [np.nan]}}, r"env\.step_reward.* must be a finite number .*got nan"),
    ({"key": -1}, "key must be an integer from 0 to 4294967295, got -1"),
    ({"key": 2**32}, "key must be an integer from 0 to 4294967295, got 4294967296"),
    ({"keep_learned": "no"}, "keep_learned must be one of False, True, got 'no'"),
    ({"progress": "no"}, "progress must be one of False, True, got 'no'"),
    ({"params": BusParams(slip_probability=-0.5)}, r"env.slip_probability must be .* in \[0, 1\], got -0.5"),
    ({"params": BusParams(max_steps=2**31)}, "env.max_steps must be an integer from 1 to 2147483647, got 2147483648"),
]


@pytest.mark.usefixtures("nothing_is_compiled")
@pytest.mark.parametrize(("wrong", "message"), REFUSED, ids=[str(options) for options, _ in REFUSED])
def test_a_wrong_value_is_refused_before_compilation(wrong: dict[str, Any], message: str):
    options = {"seeds": 2, "num_episodes": 5, "progress": False}
    with pytest.raises(ValueError, match=message):
        hrljax.sweep(SMALL, PLANNED, **{**options, **wrong})


OF_THE_WRONG_TYPE: list[tuple[dict[str, Any], str]] = [
    ({"env": "Bus"}, "env must be an environment .*got 'Bus'"),
    ({"learner": hrljax.QLearning}, "learner must be a learner .*got <class"),
    ({"key": "0"}, "key must be a new-style key such as .*got '0'"),
    ({"key": True}, "key must be a new-style key such as .*got True"),
    *(({"seeds": value}, f"seeds must be an integer from 1 to 2147483647, got {value}") for value in (1.5, True, None)),
    ({"chunk_size": 2.0}, r"chunk_size must be an integer from 1 to 2147483647, got 2\.0"),
    ({"axes": [("step_size", [0.1])]}, r"axes must be a mapping such as .*got \[\('step_size', \[0.1\]\)\]"),
    ({"axes": {"step_size": 0.1}}, "'step_size' must be a sequence of numbers, got 0.1"),
    ({"axes": {"step_size": ["0.1"]}}, r"'step_size' must be a sequence of numbers, got \['0.1'\]"),
    ({"axes": {"step_size": {0.1}}}, r"'step_size' must be a sequence of numbers, got \{0.1\}"),
    ({"params": {"max_steps": 5}}, r"params must be a BusParams.*_replace\(max_steps=5\), got \{'max_steps': 5\}"),
    ({"params": Maze().default_params}, "params must be a BusParams.*got MazeParams"),
    ({"params": BusParams}, "params must be a BusParams.*got <class"),
    ({"params": BusParams(max_steps="x")}, "env.max_steps must be an integer from 1 to 2147483647, got 'x'"),  # type: ignore[arg-type]
    ({"params": BusParams(step_reward="1")}, "env.step_reward must be a number, got '1'"),  # type: ignore[arg-type]
    ({"store": 5}, "store must be a path: a string or a pathlib.Path, got 5"),
]


@pytest.mark.usefixtures("nothing_is_compiled")
@pytest.mark.parametrize(
    ("wrong", "message"), OF_THE_WRONG_TYPE, ids=[str(options) for options, _ in OF_THE_WRONG_TYPE]
)
def test_a_wrong_type_is_refused_before_compilation(wrong: dict[str, Any], message: str):
    options = {"env": SMALL, "learner": PLANNED, "seeds": 2, "num_episodes": 5, "progress": False}
    with pytest.raises(TypeError, match=message):
        hrljax.sweep(**{**options, **wrong})


@pytest.mark.usefixtures("nothing_is_compiled")
def test_a_wrong_kind_of_key_is_refused():
    for key, message in (
        (jax.random.PRNGKey(0), "key must be a new-style key such as"),
        (jax.random.key(0, impl="rbg"), "key must be a threefry2x32 key .*rbg"),
    ):
        with pytest.raises(TypeError, match=message):
            hrljax.sweep(SMALL, PLANNED, seeds=2, num_episodes=5, key=key)


@pytest.mark.usefixtures("nothing_is_compiled")
def test_several_keys_are_refused():
    with pytest.raises(ValueError, match=r"single key, got an array of keys of shape \(2,\)"):
        hrljax.sweep(SMALL, PLANNED, seeds=2, num_episodes=5, key=jax.random.split(jax.random.key(0)))


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: hrljax.QLearning(step_size=0), ValueError, r"QLearning: step_size must be .* in \(0, 1\], got 0"),
        (lambda: hrljax.SARSA(step_size=1.5), ValueError, r"SARSA: step_size must be .* in \(0, 1\], got 1\.5"),
        (lambda: hrljax.QLearning(step_size=float("nan")), ValueError, r"step_size must be a finite number .*got nan"),
        (lambda: hrljax.HORDQ(HIERARCHY, epsilon=-0.1), ValueError, r"HORDQ: epsilon must .* in \[0, 1\], got -0\.1"),
        (lambda: hrljax.MAXQ(HIERARCHY, discount=2), ValueError, r"MAXQ: discount must be .* in \[0, 1\], got 2"),
        (lambda: hrljax.QLearning(initial_value=np.inf), ValueError, "initial_value must be a finite number"),
        (lambda: hrljax.QLearning(initial_value=1e60), ValueError, r"initial_value must be .*3.4e\+38\], got 1e\+60"),
        (lambda: hrljax.QLearning(initial_value=10**400), ValueError, r"initial_value must be .*got 1000000.*\.\.\.$"),
        (lambda: hrljax.QLearning(step_size=1e-60), ValueError, r"step_size must be .* in \(0, 1\], got 1e-60"),
        (lambda: hrljax.QLearning(step_size="0.1"), TypeError, "step_size must be a number or a schedule, got '0.1'"),
        (lambda: hrljax.QLearning(step_size=True), TypeError, "step_size must be a number or a schedule, got True"),
        (lambda: hrljax.QLearning(step_size=np.array([0.1])), TypeError, r"step_size must be .*got array\(\[0.1\]\)"),
        (lambda: hrljax.QLearning(step_size=lambda: 0.1), TypeError, r"step_size must be a function .*arguments \(\)"),
        (lambda: hrljax.DynaQ(planning_steps=2.0), TypeError, "planning_steps must be an integer from 0 .*got 2.0"),
        (lambda: hrljax.SARSALambda(trace_length=2**31 - 1), ValueError, "trace_length must be an integer from 1 to "),
        (
            lambda: hrljax.SARSALambda(trace=["replacing"]),
            ValueError,
            "trace must be one of 'accumulating', 'replacing'",
        ),
        (
            lambda: hrljax.SearchRoot(priority="x"),
            ValueError,
            "priority must be one of 'cumulative', 'last_reward', got",
        ),
        (lambda: hrljax.SearchRoot(count=None), ValueError, "SearchRoot: count must be one of 'generated', .*got None"),
        (lambda: hrljax.SearchRoot(answer="all"), ValueError, "SearchRoot: answer must be one of 'any', .* got"),
        (lambda: hrljax.QLearning(step_size="big"), TypeError, "step_size must be a number or a schedule, got 'big'"),
        (lambda: hrljax.QLearning(discount=abs), TypeError, "discount must be a number, not a schedule"),
        (lambda: hrljax.ModelRoot(interval=0), ValueError, "interval must be an integer from 1 to 2147483647, got 0"),
        (lambda: hrljax.ModelRoot(sweeps=-1), ValueError, "sweeps must be an integer from 0 to 2147483647, got -1"),
        (lambda: hrljax.HORDQ(HIERARCHY, bootstrap="none"), ValueError, "bootstrap must be one of .*got 'none'"),
        (lambda: hrljax.HORDQ("Bus"), TypeError, "hierarchy must be a Hierarchy .*got 'Bus'"),
        (lambda: hrljax.HORDQ(HIERARCHY, root="random"), TypeError, "root must be None or a root .*got 'random'"),
    ],
)
def test_learners_refuse_wrong_settings(make: Callable[[], Any], error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        make()


def test_a_schedule_that_leaves_its_interval_names_the_episode():
    learner = hrljax.QLearning(step_size=optax.linear_schedule(0.5, 1.4, 9))
    with pytest.raises(ValueError, match=r"step_size must be .*in \(0, 1\], got .*1\.4.* by its schedule at episode 9"):
        hrljax.sweep(Bus(), learner, seeds=2, num_episodes=20, progress=False)
    jax.eval_shape(lambda: hrljax.train(Bus(), learner, jax.random.key(0), 5))  # shorter runs stay inside
    with pytest.raises(ValueError, match="'step_size' cannot be swept; sweepable are epsilon, discount"):
        hrljax.sweep(Bus(), learner, seeds=2, num_episodes=5, axes={"step_size": [0.1]}, progress=False)
