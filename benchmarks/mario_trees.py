"""Fitting the regression trees of Mario's model: time and held-back accuracy beside scikit-learn and Orange.

On recorded transitions, every fifth episode held back: a tree for each of 12 actions and 4 targets,
and one for the reward with the action as an input; depth 12, at least 5 rows in a leaf. Then the
same with `--rows` rows (recorded ones drawn with replacement, with a little noise, so that trees
grow to their limits), and the time of a prediction. scikit-learn is given one-hot codes. Orange,
with a branch for every category, is run where it is installed. All run in turns; medians are reported.

    python benchmarks/mario_trees.py --recordings rl_steps.npz --json mario_trees.json
"""

import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax import lax

from hrljax.engine import compiler
from hrljax.envs.mario.env import ALL_ACTIONS
from hrljax.envs.mario.recordings import read_episodes
from hrljax.experiments import program
from hrljax.experiments.mario_fidelity.transitions import INPUT_CATEGORIES, TARGETS, Transitions, read_transitions
from hrljax.trees.regression_tree import RegressionTree, Trees, predict

program.require("bench", "sklearn")

from sklearn.tree import DecisionTreeRegressor  # noqa: E402

try:
    import Orange  # pyright: ignore[reportMissingImports]
except ImportError:
    Orange = None

try:
    from benchmarks.rounds import save
except ModuleNotFoundError:
    from rounds import save

NUM_ACTIONS = len(ALL_ACTIONS)
MOVES = RegressionTree(INPUT_CATEGORIES, max_depth=12, min_leaf=5)
REWARD = RegressionTree((*INPUT_CATEGORIES, NUM_ACTIONS), max_depth=12, min_leaf=5)
Model = tuple[Trees, Trees]


@dataclass(frozen=True)
class Options:
    """Time and accuracy of fitting Mario's regression trees, hrljax side by side with peers."""

    recordings: Path
    """Recorded steps (rl_steps.npz)."""
    rows: int = 20_000
    """Rows of the large case."""
    rounds: int = 5
    """Rounds; every contestant runs once in each."""
    json: Path | None = None
    """Where to write the rows."""


@dataclass
class Contestant:
    """`fit` learns and returns a function from transitions to predictions ``[N, 5]``."""

    name: str
    fit: Callable[[Transitions], Callable[[Transitions], np.ndarray]]


def with_action(inputs: Any, actions: Any) -> Any:
    return jnp.concatenate([inputs, actions[:, None].astype(jnp.float32)], axis=1)


def learn(inputs: jax.Array, actions: jax.Array, targets: jax.Array, rewards: jax.Array) -> Model:
    moves = MOVES.fit_groups(inputs, targets, actions, NUM_ACTIONS)
    return moves, REWARD.fit(with_action(inputs, actions), rewards)


def predict_all(model: Model, row: jax.Array) -> jax.Array:
    action = row[-1].astype(jnp.int32)
    return jnp.stack([*(predict(model[0], row, action, k) for k in range(4)), predict(model[1], row)])


def predict_rows(model: Model, rows: jax.Array) -> jax.Array:
    return lax.map(lambda row: predict_all(model, row), rows)


def hrljax(options: dict[str, Any] | None, name: str) -> Contestant:
    fitted = jax.jit(learn, compiler_options=options)
    predicted = jax.jit(predict_rows, compiler_options=options)

    def fit(data: Transitions) -> Callable[[Transitions], np.ndarray]:
        model = jax.block_until_ready(fitted(data.inputs, data.actions, data.targets, data.rewards))
        return lambda other: np.asarray(predicted(model, with_action(other.inputs, other.actions)))

    return Contestant(name, fit)


def one_hot(data: Transitions) -> tuple[np.ndarray, np.ndarray]:
    columns = [
        np.eye(size, dtype=np.float32)[data.inputs[:, i].astype(int)] if size else data.inputs[:, [i]]
        for i, size in enumerate(INPUT_CATEGORIES)
    ]
    codes = np.concatenate(columns, axis=1)
    return codes, np.concatenate([codes, np.eye(NUM_ACTIONS, dtype=np.float32)[data.actions]], axis=1)


def by_groups(data: Transitions, fit_one: Callable[[Any, np.ndarray, bool], Any], codes: Callable[..., Any]) -> Any:
    """Fits tree by tree with a library that knows one tree; returns the function that predicts."""
    moves, all_inputs = codes(data)
    rows_of_actions = [data.actions == a for a in range(NUM_ACTIONS)]
    trees = [[fit_one(moves[rows], data.targets[rows, k], False) for k in range(4)] for rows in rows_of_actions]
    reward = fit_one(all_inputs, data.rewards, True)

    def predictions(other: Transitions) -> np.ndarray:
        moves, all_inputs = codes(other)
        actual = np.zeros((len(other.actions), 5))
        for a in range(NUM_ACTIONS):
            rows = other.actions == a
            for k in range(4):
                actual[rows, k] = trees[a][k](moves[rows])
        actual[:, 4] = reward(all_inputs)
        return actual

    return predictions


def scikit_learn() -> Contestant:
    def fit_one(codes: np.ndarray, targets: np.ndarray, _: bool) -> Any:
        learner = DecisionTreeRegressor(max_depth=12, min_samples_leaf=5, random_state=0)
        return learner.fit(codes, targets.astype(float)).predict

    return Contestant("scikit-learn DecisionTreeRegressor", lambda data: by_groups(data, fit_one, one_hot))


def orange() -> Contestant:
    assert Orange is not None
    data_module = Orange.data

    def variable(i: int, size: int) -> Any:
        values = tuple(map(str, range(size)))
        return data_module.DiscreteVariable(f"x{i}", values=values) if size else data_module.ContinuousVariable(f"x{i}")

    variables = [variable(i, size) for i, size in enumerate(REWARD.categories)]
    target = data_module.ContinuousVariable("y")
    domains = [data_module.Domain(part, target) for part in (variables[:-1], variables)]

    def fit_one(inputs: np.ndarray, targets: np.ndarray, has_action: bool) -> Any:
        table = data_module.Table.from_numpy(domains[has_action], inputs, targets)
        return Orange.regression.TreeLearner(max_depth=12, min_samples_leaf=5)(table)

    def codes(data: Transitions) -> tuple[np.ndarray, np.ndarray]:
        inputs = data.inputs.astype(float)
        return inputs, np.concatenate([inputs, data.actions[:, None]], axis=1)

    return Contestant("Orange TreeLearner", lambda data: by_groups(data, fit_one, codes))


def enlarged(data: Transitions, rows: int) -> Transitions:
    """Recorded rows drawn with replacement, with a little noise on every number."""
    rng = np.random.default_rng(0)
    chosen = rng.integers(0, len(data.actions), rows)
    more = Transitions(*(values[chosen] for values in data))
    noise = rng.normal(0, 0.02, (rows, 7)).astype(np.float32)
    more.inputs[:, -2:] += noise[:, :2]
    more.targets[:] += noise[:, 2:6]
    more.rewards[:] += noise[:, 6]
    return more


def measure(contestants: list[Contestant], data: Transitions, case: str, rounds: int) -> tuple[list[Any], list[Any]]:
    """Rows with the times of fitting, and what was fitted."""
    fitted, compiling = [], []
    for contestant in contestants:
        began = time.perf_counter()
        fitted.append(contestant.fit(data))
        compiling.append(time.perf_counter() - began)
    times: list[list[float]] = [[] for _ in contestants]
    for _ in range(rounds):
        for i, contestant in enumerate(contestants):
            began = time.perf_counter()
            contestant.fit(data)
            times[i].append(time.perf_counter() - began)
    rows = []
    for contestant, seconds, first in zip(contestants, times, compiling, strict=True):
        value, compiled = 1e3 * statistics.median(seconds), contestant.name.startswith("hrljax")
        extra = {"best": 1e3 * min(seconds), "compile_seconds": first if compiled else 0.0}
        rows.append({"case": case, "contestant": contestant.name, "cores": 1, "value": value, "unit": "ms", **extra})
    return rows, fitted


def main(options: Options) -> None:
    recorded = read_transitions(read_episodes(options.recordings))
    held = recorded.episodes % 5 == 0
    train, test = (Transitions(*(values[rows] for values in recorded)) for rows in (~held, held))
    contestants = [hrljax(dict(compiler.OPTIONS), "hrljax native"), hrljax(None, "hrljax plain jit"), scikit_learn()]
    if Orange is not None:
        contestants.append(orange())
    count = 4 * NUM_ACTIONS + 1
    rows, fitted = measure(contestants, train, f"fit {count} trees to {len(train.actions)} rows", options.rounds)
    truth = np.concatenate([test.targets, test.rewards[:, None]], axis=1)
    for contestant, model in zip(contestants, fitted, strict=True):
        errors = ((model(test) - truth) ** 2).mean(0)
        for name, error in zip((*TARGETS, "reward"), errors, strict=True):
            row = {"case": f"held-back error of {name}", "contestant": contestant.name, "cores": 1, "value": error}
            rows.append({**row, "unit": "mean squared error", "compile_seconds": 0.0})
    more = enlarged(recorded, options.rows)
    fits, models = measure(contestants, more, f"fit {count} trees to {options.rows} rows", options.rounds)
    rows += fits
    for contestant, model in zip(contestants, models, strict=True):
        seconds = []
        for _ in range(options.rounds + 1):
            began = time.perf_counter()
            model(more)
            seconds.append(time.perf_counter() - began)
        value = 1e9 * statistics.median(seconds[1:]) / (5 * options.rows)
        row = {"case": "prediction of one tree, many rows", "contestant": contestant.name, "cores": 1, "value": value}
        rows.append({**row, "unit": "ns", "compile_seconds": 0.0})
    print("\n".join(f"{r['case']:36}{r['contestant']:36}{r['value']:14.4g} {r['unit']}" for r in rows))
    versions = ", ".join(f"{name} {version(name)}" for name in ("jax", "jaxlib", "scikit-learn"))
    print(f"median of {options.rounds} rounds; Python {platform.python_version()}, {versions}")
    save(rows, options.json)


if __name__ == "__main__":
    main(tyro.cli(Options))
