"""Million environment-and-learning steps a second on the Bus domain, side by side with peers.

Cases: Q-learning; HORDQ(5), and HORDQ with shared values and a pseudo-reward that fades, each under a
random root and under the model-based root. Contestants:
hrljax's native loop; its runs in lockstep; the same algorithm as a hand-written numba loop; the plain
vmap way with jax.random in the step (Q-learning); a learner that takes one step a Python call, simple_rl
(Q-learning). All run in turns, round after round, so that a change of the machine's speed meets
all of them; the median is reported, by the clock and by processor time ("a CPU s"), to which ratios go: it is
the same on a busy machine. Compile time is apart.

    pip install -e '.[bench]' && python benchmarks/bus.py --json bus.json
"""

import platform
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

import hrljax as hrl
from hrljax.engine import batch
from hrljax.envs.base import concrete_params
from hrljax.envs.outcomes import outcome_table
from hrljax.experiments import program
from hrljax.hierarchy.layout import stack_layout
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.roots.decision_points import planning_points

program.require("bench", "numba", "simple_rl")

try:
    from benchmarks import numba_bus
    from benchmarks.rounds import Contestant, measure, save
except ModuleNotFoundError:
    import numba_bus
    from rounds import Contestant, measure, save

_SEEDS = 8
"""Runs a core of a contestant in a round."""
_TOGETHER = (64, 256)
"""Runs that take their steps together, of those that `vmap` maps."""
_IN_LOCKSTEP = ("Q-learning", "HORDQ(5)+random", "HORDQ(5)+model")

_PLAIN = "plain vmap of {}, jax.random in the step"

ENV = hrl.make("Bus")
HIERARCHY = ENV.hierarchy()
ROOT = hrl.ModelRoot()
LEARNERS = {
    "Q-learning": hrl.QLearning(initial_value=-25.0),
    "HORDQ(5)+random": hrl.HORDQ(HIERARCHY, hrl.RandomRoot(), pseudo_reward=5.0, initial_value=-25.0),
    "HORDQ(5)+model": hrl.HORDQ(HIERARCHY, ROOT, pseudo_reward=5.0, initial_value=-25.0),
    "shared HORDQ(fading)+random": hrl.SharedHORDQ(HIERARCHY, hrl.RandomRoot(), initial_value=-25.0),
    "shared HORDQ(fading)+model": hrl.SharedHORDQ(HIERARCHY, ROOT, initial_value=-25.0),
    "HORDQ(5)+model, decisions only": hrl.HORDQ(
        HIERARCHY, hrl.ModelRoot(sweeps=0), pseudo_reward=5.0, initial_value=-25.0
    ),
}


@dataclass(frozen=True)
class Options:
    """Million steps a second on the Bus domain, hrljax side by side with peers."""

    episodes: int = 20_000
    """Episodes of a run."""
    rounds: int = 7
    """Rounds; every contestant runs once in each."""
    cores: int = batch.usable_cores()
    """Greatest number of cores; one core is measured in any case."""
    json: Path | None = None
    """Where to write the rows."""
    peers: bool = True
    """Whether to run the slow peers too."""


def native(case: str, cores: int, episodes: int, mapping: Any = "native", seeds: int = _SEEDS) -> Contestant:
    """hrljax: `seeds` runs a core."""

    def run() -> int:
        curves = hrl.sweep(
            ENV, LEARNERS[case], seeds=seeds * cores, num_episodes=episodes, mapping=mapping,
            cores=cores, chunk_size=seeds, progress=False,
        )  # fmt: skip
        run.seconds = curves.attrs["compile_seconds"]
        return int(curves["steps"].sum())

    run()
    name = "hrljax native" if mapping == "native" else f"hrljax lockstep of {seeds}"
    return Contestant(case, name, cores, run, run.seconds)


def by_numba(case: str, cores: int, episodes: int, looked_up: bool = False) -> Contestant:
    """The hand-written loop: one thread a core (numba releases the interpreter lock).

    `looked_up` lets it find its steps in the table of outcomes that hrljax makes (Q-learning only).
    """
    tasks, points = tabulate(HIERARCHY, ENV), planning_points(HIERARCHY, ENV)
    layout = stack_layout(HIERARCHY, ENV, root_learns=False)
    moves, start = ENV._moves, ENV.layout.start
    root = LEARNERS[case].root if case != "Q-learning" else ROOT
    shape = (points.num_x, points.num_slots, points.num_outcomes)
    is_shared = "shared" in case
    fading = hrl.Fading()
    obedience = (np.float32(fading.worth), np.float32(fading.after)) if is_shared else (5.0,)
    arguments = (
        np.float32(-25), *obedience, "model" in case, root.interval if "model" in case else 1,
        root.sweeps if "model" in case else 0, np.float32(-30), moves, start,
        layout.active_bits.astype(np.int32), layout.goal, tasks.root_children, tasks.root_counts,
        points.point, points.planning, points.tasks, points.can_invoke, points.outcomes.reshape(shape),
    )  # fmt: skip
    q_learning = numba_bus.q_learning_looked_up if looked_up else numba_bus.q_learning
    loops = (q_learning, numba_bus.shared_hordq if is_shared else numba_bus.hordq)
    flat, hierarchical = (numba_bus.numba.njit(nogil=True)(loop.py_func) for loop in loops)
    table: Any = outcome_table(ENV, concrete_params(ENV.default_params))
    steps = (table.entries, table.rewards) if looked_up else moves

    def one(seed: int, count: int = episodes) -> int:
        if case == "Q-learning":
            return flat(seed, count, 200, np.float32(-25), steps, start)[1]
        return hierarchical(seed, count, 200, *arguments)[1]

    def run() -> int:
        with ThreadPoolExecutor(cores) as pool:
            return sum(pool.map(one, range(1, _SEEDS * cores + 1)))

    began = time.perf_counter()
    one(1, 200)
    name = "numba loop, outcomes looked up" if looked_up else "numba loop"
    return Contestant(case, name, cores, run, time.perf_counter() - began)


def plain_vmap(cores: int, episodes: int, seeds: int) -> Contestant:
    """Q-learning as gymnax and purejaxrl users write it: vmap of a scan, keys split in the step."""
    steps = 2000 * episodes // 20_000
    params = ENV.default_params

    def one(key: jax.Array) -> jax.Array:
        def step(carry: Any, _: None) -> Any:
            q, state, key = carry
            key, explore_key, action_key, env_key, reset_key = jax.random.split(key, 5)
            index = ENV.encode(state)
            random_action = jax.random.randint(action_key, (), 0, 4)
            action = jnp.where(jax.random.uniform(explore_key) < 0.1, random_action, jnp.argmax(q[index]))
            obs, after, reward, terminated, truncated, _ = ENV.step(env_key, state, action, params)
            bootstrap = jnp.where(terminated, 0.0, q[obs].max())
            q = q.at[index, action].add(0.1 * (reward + bootstrap - q[index, action]))
            _, first = ENV.reset(reset_key, params)
            state = jax.tree.map(lambda a, b: jnp.where(terminated | truncated, a, b), first, after)
            return (q, state, key), reward

        key, reset_key = jax.random.split(key)
        start = (jnp.full((ENV.num_states, 4), -25.0), ENV.reset(reset_key, params)[1], key)
        return jax.lax.scan(step, start, None, steps)[1].sum()

    keys = jax.random.split(jax.random.key(0), seeds)
    began = time.perf_counter()
    compiled = jax.jit(jax.vmap(one)).lower(keys).compile()
    seconds = time.perf_counter() - began

    def run() -> int:
        jax.block_until_ready(compiled(keys))
        return seeds * steps

    return Contestant("Q-learning", _PLAIN.format(seeds), cores, run, seconds)


def by_simple_rl(episodes: int) -> Contestant:
    """One Python call a step: simple_rl's QLearningAgent on transitions tabulated beforehand."""
    from simple_rl.agents import QLearningAgent
    from simple_rl.mdp import State

    agent = QLearningAgent(actions=list(range(4)), alpha=0.1, epsilon=0.1, gamma=1.0)
    model = ENV.model()
    cumulative = model.probability.cumsum(-1)
    states = [State(data=i) for i in range(ENV.num_states)]
    rng = np.random.default_rng(0)
    first = int(np.flatnonzero(ENV.initial_distribution())[0])

    def run() -> int:
        steps = 0
        for _ in range(max(1, episodes // 1000)):
            index, reward = first, 0.0
            for _ in range(1000):
                action = agent.act(states[index], reward)
                k = int(np.searchsorted(cumulative[index, action], rng.random()))
                reward, steps = float(model.reward[index, action, k]), steps + 1
                end = model.terminated[index, action, k]
                index = int(model.next_state[index, action, k])
                if end:
                    break
            agent.end_of_episode()
        return steps

    return Contestant("Q-learning", "simple_rl, one Python call a step", 1, run)


def report(rows: list[dict[str, Any]]) -> str:
    """The rows as a table, with ratios by processor time to the numba loop of the same case and cores."""
    columns = f"{'cores':>5}{'median':>9}{'best':>9}{'a CPU s':>9}{'of numba':>10}{'compile s':>11}"
    lines = [f"{'case':32}{'contestant':42}{columns}"]
    for row in rows:
        same = [r for r in rows if r["case"] == row["case"] and r["cores"] == row["cores"]]
        peer = [r["per_cpu_second"] for r in same if r["contestant"] == "numba loop"]
        ratio = f"{row['per_cpu_second'] / peer[0]:10.2f}" if peer else " " * 10
        lines.append(
            f"{row['case']:32}{row['contestant']:42}{row['cores']:5}{row['value']:9.2f}{row['best']:9.2f}"
            f"{row['per_cpu_second']:9.2f}{ratio}{row['compile_seconds']:11.2f}"
        )
    one = {r["case"]: r for r in rows if r["contestant"] == "hrljax native" and r["cores"] == 1}
    for row in rows:
        if row["contestant"] == "hrljax native" and row["cores"] > 1 and row["case"] in one:
            gain = row["value"] / one[row["case"]]["value"]
            lines.append(f"{row['case']}: {row['cores']} cores do {gain:.2f} times what one does")
    by_name = {row["contestant"]: row for row in rows if row["case"] == "Q-learning"}
    for seeds in _TOGETHER if "simple_rl, one Python call a step" in by_name else ():
        ours = by_name[f"hrljax lockstep of {seeds}"]["per_cpu_second"]
        plain = by_name[_PLAIN.format(seeds)]["per_cpu_second"]
        lines.append(
            f"Q-learning, {seeds} runs in lockstep: {ours:.1f} million steps a processor second, "
            f"{ours / plain:.1f} times what plain vmap does"
        )
    share = 1 - one["HORDQ(5)+model"]["value"] / one["HORDQ(5)+model, decisions only"]["value"]
    lines.append(f"HORDQ(5)+model: sweeps take {share:.0%} of the run")
    return "\n".join(lines)


def main(options: Options) -> None:
    contestants = []
    for cores in sorted({1, options.cores}):
        for case in LEARNERS:
            contestants += [native(case, cores, options.episodes), by_numba(case, cores, options.episodes)]
        contestants.append(by_numba("Q-learning", cores, options.episodes, looked_up=True))
    if options.peers:
        for seeds in _TOGETHER:
            contestants += [native(case, 1, options.episodes // 10, "vmap", seeds) for case in _IN_LOCKSTEP]
            contestants.append(plain_vmap(options.cores, options.episodes, seeds))
        contestants.append(by_simple_rl(options.episodes))
    rows = measure(contestants, options.rounds, "million steps/s", 1e6)
    versions = ", ".join(f"{name} {version(name)}" for name in ("jax", "jaxlib", "numba", "simple_rl"))
    print(report(rows))
    print(f"median of {options.rounds} rounds; Python {platform.python_version()}, {versions}")
    save(rows, options.json)


if __name__ == "__main__":
    main(tyro.cli(Options))
