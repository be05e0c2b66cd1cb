"""Exact solutions of known models, side by side with other solvers, to the same accuracy, with float64 numbers.

Cases: Taxi, Bus, and gridworlds of rooms with slips of 10^4 and 10^5 states, with a discount of 0.99 (some peers
allow none of 1). Contestants: hrljax's `value_iteration` and `policy_iteration`; mdpsolver (C++); quantecon's
DiscreteDP (numba and SciPy's sparse matrices); jaxdp (JAX, dense transition matrices: only where they fit).
A peer's policy iteration is left out of 10^5 states, where it takes minutes.

Every one is given its own kind of model, made beforehand, and starts from nothing in every round; all run on one
core. `error` is what a solution can be wrong by, from its Bellman residual: ``max |T V - V| / (1 - discount)``,
computed in NumPy. Everybody but `policy_iteration` is asked for 1e-3.

    pip install -e '.[bench]' && python benchmarks/solvers.py --json solvers.json
"""

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # before anybody starts threads
os.environ["OMP_NUM_THREADS"] = "1"

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from scipy import sparse

import hrljax as hrl
from hrljax.experiments import program
from hrljax.solvers import Model

program.require("bench", "mdpsolver", "quantecon", "jaxdp")

try:
    from benchmarks.rounds import Contestant, measure, save
except ModuleNotFoundError:
    from rounds import Contestant, measure, save

_DISCOUNT = 0.99
_ACCURACY = 1e-3
_MOST_DENSE_BYTES = 2**26
_MOST_STATES_OF_SLOW_PEERS = 20_000
_SIDES = {"gridworld 10^4": 100, "gridworld 10^5": 330}


@dataclass(frozen=True)
class Options:
    """Exact solvers side by side with peers."""

    rounds: int = 5
    """Rounds; every contestant runs once in each."""
    cases: tuple[str, ...] = ("Taxi", "Bus", *_SIDES)
    """Which models are solved."""
    json: Path | None = None
    """Where to write the rows."""


def rooms(side: int) -> str:
    """A square of rooms of 19 by 19 cells with a door in every wall, start and goal in opposite corners."""
    row, column = np.indices((side, side))
    is_wall = ((row % 20 == 19) & (column % 20 != 10)) | ((column % 20 == 19) & (row % 20 != 5))
    cells = np.where(is_wall, "#", ".")
    cells[1, 1], cells[side - 2, side - 2] = "S", "G"
    return "\n".join("".join(line) for line in cells)


def model_of(case: str) -> Model:
    if case in _SIDES:
        env = hrl.make("Gridworld", map=rooms(_SIDES[case]))
        return env.model(env.default_params._replace(slip_probability=0.2))
    return hrl.make(case).model()


def greatest_error(model: Model, value: np.ndarray) -> float:
    """What values can be wrong by, from how far a backup moves them."""
    after = np.where(model.terminated, 0, value[model.next_state])
    q = (model.probability * (model.reward + _DISCOUNT * after)).sum(-1)
    return float(np.abs(q.max(-1) - value).max() / (1 - _DISCOUNT))


def with_absorbing_state(model: Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rewards ``[S + 1, A]``, next states and probabilities ``[S + 1, A, K]`` of a process that never ends."""
    states, actions, _ = model.next_state.shape
    after = np.where(model.terminated, states, model.next_state)
    after = np.concatenate([after, np.full((1, *after.shape[1:]), states)])
    last = np.zeros((1, *after.shape[1:]))
    last[..., 0] = 1
    reward = np.concatenate([(model.probability * model.reward).sum(-1), np.zeros((1, actions))])
    return reward, after, np.concatenate([model.probability, last])


class Solver:
    """A way to solve a model; keeps the values that it found last."""

    def __init__(self, case: str, name: str, model: Model, solve: Callable[[], np.ndarray]):
        self.model, self.solve = model, solve
        began = time.perf_counter()
        self.value = solve()
        first = time.perf_counter() - began
        began = time.perf_counter()
        self.value = solve()
        again = time.perf_counter() - began
        self.contestant = Contestant(case, name, 1, self.run, max(0.0, first - again))

    def run(self) -> int:
        self.value = self.solve()
        return 1

    @property
    def error(self) -> float:
        return greatest_error(self.model, self.value[: self.model.num_states])


def ours(case: str, model: Model) -> list[Solver]:
    tolerance = _ACCURACY * (1 - _DISCOUNT) / (1 + np.abs(model.reward).max() / (1 - _DISCOUNT))
    return [
        Solver(case, f"hrljax {name}", model, lambda solve=solve: np.asarray(solve().value))
        for name, solve in {
            "value_iteration": lambda: hrl.solvers.value_iteration(model, _DISCOUNT, tolerance=tolerance),
            "policy_iteration": lambda: hrl.solvers.policy_iteration(model, _DISCOUNT),
        }.items()
    ]


def by_mdpsolver(case: str, model: Model, rounds: int) -> list[Solver]:
    """C++. A model that was solved keeps its solution, so every round has one of its own."""
    import mdpsolver

    reward, after, probability = with_absorbing_state(model)
    is_used = probability > 0
    columns, weights = (
        [[row[used].tolist() for row, used in zip(*pair, strict=True)] for pair in zip(array, is_used, strict=True)]
        for array in (after, probability)
    )
    ways = {"value iteration": ("vi", "standard"), "Gauss-Seidel value iteration": ("vi", "gs")}
    if model.num_states <= _MOST_STATES_OF_SLOW_PEERS:
        ways |= {"modified policy iteration": ("mpi", "standard"), "policy iteration": ("pi", "gs")}

    def fresh() -> Any:
        solver = mdpsolver.model()
        solver.mdp(discount=_DISCOUNT, rewards=reward.tolist(), tranMatProbs=weights, tranMatColumns=columns)
        return solver

    def solving(algorithm: str, update: str) -> Callable[[], np.ndarray]:
        waiting = [fresh() for _ in range(rounds + 2)]

        def solve() -> np.ndarray:
            solver = waiting.pop()
            solver.solve(algorithm=algorithm, update=update, tolerance=_ACCURACY, parallel=False)
            return np.array(solver.getValueVector())

        return solve

    return [Solver(case, f"mdpsolver, {name}", model, solving(*way)) for name, way in ways.items()]


def by_quantecon(case: str, model: Model) -> list[Solver]:
    from quantecon.markov import DiscreteDP

    reward, after, probability = with_absorbing_state(model)
    size = len(reward)
    rows = np.broadcast_to(np.arange(reward.size).reshape(*reward.shape, 1), after.shape)
    shape = (reward.size, size)
    matrix = sparse.csr_matrix((probability.ravel(), (rows.ravel(), after.ravel())), shape=shape)
    matrix.eliminate_zeros()
    state, action = (index.ravel() for index in np.indices(reward.shape))
    process = DiscreteDP(reward.ravel(), matrix, _DISCOUNT, state, action)
    ways = {"value iteration": "vi", "modified policy iteration": "mpi"}
    if model.num_states <= _MOST_STATES_OF_SLOW_PEERS:
        ways["policy iteration"] = "pi"
    options: dict[str, Any] = {"epsilon": _ACCURACY, "max_iter": 100_000}
    return [
        Solver(case, f"quantecon, {name}", model, lambda way=way: process.solve(method=way, **options).v)
        for name, way in ways.items()
    ]


def by_jaxdp(case: str, model: Model) -> list[Solver]:
    """Its updates of one iteration, run until a value changes by less than is allowed."""
    import chex
    import jaxdp

    chex.disable_asserts()  # it looks at numbers, which its own assertions refuse inside of a compiled loop
    reward, after, probability = with_absorbing_state(model)
    size, actions = reward.shape
    if actions * size**2 * 8 > _MOST_DENSE_BYTES:
        return []
    dense = np.zeros((actions, size, size))
    a, s = np.indices((actions, size))
    np.add.at(dense, (a[..., None], after.swapaxes(0, 1), s[..., None]), probability.swapaxes(0, 1))
    process = jaxdp.MDP(
        transition=jnp.array(dense),
        reward=jnp.broadcast_to(jnp.array(reward.T)[..., None], dense.shape),
        initial=jnp.full(size, 1 / size),
        terminal=jnp.arange(size) == size - 1,
    )
    allowed = _ACCURACY * (1 - _DISCOUNT)

    def until_settled(method: Any, process: Any, state: Any) -> Any:
        def update(carry: Any) -> Any:
            state, _ = carry
            renewed = method.update(process, state)
            return renewed, jnp.abs(renewed.v_val - state.v_val).max()

        return jax.lax.while_loop(lambda carry: carry[1] > allowed, update, (state, jnp.array(jnp.inf)))[0].v_val

    by_values, by_policies = jaxdp.ValueIteration(gamma=_DISCOUNT), jaxdp.PolicyIteration(gamma=_DISCOUNT)
    first = jnp.full((actions, size), 1 / actions)
    ways = {
        "value iteration": jax.jit(lambda process: until_settled(by_values, process, by_values.init(process))),
        "policy iteration": jax.jit(
            lambda process: until_settled(by_policies, process, by_policies.init(process, first))
        ),
    }
    return [
        Solver(case, f"jaxdp, {name}", model, lambda way=way: np.asarray(way(process))) for name, way in ways.items()
    ]


def report(rows: list[dict[str, Any]]) -> str:
    """The rows as a table, with the time as a multiple of the faster of hrljax's two."""
    lines = [f"{'case':16}{'contestant':42}{'ms':>10}{'CPU ms':>10}{'of hrljax':>10}{'error':>10}{'compile s':>11}"]
    for row in rows:
        same = [r for r in rows if r["case"] == row["case"] and "hrljax" in r["contestant"]]
        best = max(r["per_cpu_second"] for r in same)
        lines.append(
            f"{row['case']:16}{row['contestant']:42}{1000 / row['value']:10.1f}{1000 / row['per_cpu_second']:10.1f}"
            f"{best / row['per_cpu_second']:10.2f}{row['error']:10.1e}{row['compile_seconds']:11.2f}"
        )
    return "\n".join(lines)


def main(options: Options) -> None:
    rows: list[dict[str, Any]] = []
    for case in options.cases:
        model = model_of(case)
        print(f"{case}: {model.num_states} states, {model.num_actions} actions", flush=True)
        with jax.enable_x64(True):
            solvers = ours(case, model) + by_quantecon(case, model) + by_jaxdp(case, model)
            solvers += by_mdpsolver(case, model, options.rounds)
            measured = measure([solver.contestant for solver in solvers], options.rounds, "solutions/s")
        rows += [{**row, "error": solver.error} for row, solver in zip(measured, solvers, strict=True)]
    print(report(rows))
    versions = ", ".join(f"{name} {version(name)}" for name in ("jax", "jaxlib", "mdpsolver", "quantecon", "jaxdp"))
    print(f"median of {options.rounds} rounds, one core; Python {platform.python_version()}, {versions}")
    save(rows, options.json)


if __name__ == "__main__":
    main(tyro.cli(Options))
