"""Optimal, hierarchically optimal and recursively optimal: what exists on Maze, Taxi and Bus, and what is learned."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from hrljax import plots, stats
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.envs.bus.env import Bus
from hrljax.envs.grid import cell_render
from hrljax.envs.grid.maze import Maze
from hrljax.envs.taxi.env import Taxi
from hrljax.experiments.domains import Domain as AnyDomain
from hrljax.experiments.rows import Row, interval_row
from hrljax.hierarchy import drawing
from hrljax.hierarchy.leaf_cover import inaccessible, total_leaf_cover
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.base import AnyLearner
from hrljax.learners.dyna import DynaQ
from hrljax.learners.flat import SARSA, QLearning
from hrljax.learners.hamq import HAMQ
from hrljax.learners.hordq import HORDQ, MAXQ, MAXQ0
from hrljax.learners.options.definition import options_from
from hrljax.learners.options.learner import OptionQ
from hrljax.learners.rmax import RMax
from hrljax.learners.roots.model import ModelRoot
from hrljax.learners.shared import SharedHORDQ
from hrljax.learners.traces import SARSALambda
from hrljax.solvers.hierarchical import Optima, solve_hierarchy
from hrljax.sweeps.sweep import sweep

PEERS = {"MAXQ-Q": (2.06, 1.11), "MAXQ-0": (2.54, 0.52), "HAMQ": (3.15, 0.40)}
"""Mean return of one test episode after 65,536 on Taxi, 200 runs, and its standard error, as published
(aijunbai/taxi, a C++ program: same rewards, step size, exploration and pseudo-reward; HAMQ is its HAMQ-INT)."""

_BINS = 128


@dataclass(frozen=True)
class Domain(AnyDomain):
    """A domain with its learners; `pseudo_reward` is that of the exact recursively optimal policy."""

    pseudo_reward: float
    learners: dict[str, AnyLearner]


def _neighbours(env: AnyTabularEnvironment, maxq: float, hordq: float, **numbers: Any) -> dict[str, AnyLearner]:
    """HORDQ and the methods around it, with the same numbers and a root that learns."""
    hierarchy = env.hierarchy()
    complete = total_leaf_cover(hierarchy, active=tabulate(hierarchy, env).active).hierarchy
    options = options_from(hierarchy, env)
    return {
        "Q-learning": QLearning(**numbers),
        "SARSA(0)": SARSA(**numbers),
        "SARSA(0.7)": SARSALambda(trace_decay=0.7, **numbers),
        "Dyna-Q": DynaQ(outcomes_kept=8, **numbers),
        "options, SMDP Q": OptionQ(options, update="smdp", **numbers),
        "options, intra-option Q": OptionQ(options, update="intra_option", **numbers),
        "HAMQ": HAMQ(hierarchy, **numbers),
        "MAXQ-0": MAXQ0(hierarchy, **numbers),
        "MAXQ-Q": MAXQ(hierarchy, pseudo_reward=maxq, **numbers),
        "HORDQ": HORDQ(hierarchy, pseudo_reward=hordq, **numbers),
        "HORDQ, total leaf cover": HORDQ(complete, pseudo_reward=hordq, **numbers),
        "shared HORDQ, total leaf cover": SharedHORDQ(complete, **numbers),
    }


def domains() -> list[Domain]:
    """Maze, stochastic Taxi with Gymnasium's rewards, and Bus."""
    maze, taxi, bus = Maze(), Taxi(stochastic=True, rules="gymnasium"), Bus()
    in_maze = _neighbours(maze, 0.0, 0.0, step_size=0.5, epsilon=0.1, initial_value=0.0)
    in_maze["R-MAX"] = RMax(known_after=1)
    in_taxi = _neighbours(taxi, 1.0, 0.0, step_size=0.125, epsilon=0.01, initial_value=0.0)
    on_bus = _neighbours(bus, 60.0, 5.0, step_size=0.1, epsilon=0.1, initial_value=-25.0)
    on_bus["MAXQ-Q"] = MAXQ(bus.hierarchy(), pseudo_reward=60.0)
    on_bus["MAXQ-0"] = MAXQ0(bus.hierarchy())
    on_bus["HORDQ, model-based root"] = HORDQ(bus.hierarchy(), ModelRoot(), pseudo_reward=5.0, initial_value=-25.0)
    on_bus["shared HORDQ, model-based root"] = SharedHORDQ(bus.hierarchy(), ModelRoot(), initial_value=-25.0)
    return [
        Domain("Maze", maze, 200, 2_000, 0.0, in_maze),
        Domain("Taxi", taxi, 1024, 65_536, 1.0, in_taxi),
        Domain("Bus", bus, 1000, 20_000, 60.0, on_bus),
    ]


def exact(domain: Domain) -> Optima:
    """The three criteria by dynamic programming; ties go to the first child."""
    return solve_hierarchy(
        domain.hierarchy,
        tabulate(domain.hierarchy, domain.env),
        domain.model,
        domain.env.initial_distribution(domain.params),
        pseudo_reward=domain.pseudo_reward,
    )


def run(domain: Domain, seeds: int, scale: float, cores: int | None, key: int) -> Iterator[tuple[str, xr.Dataset]]:
    """Runs a domain's learners one after the other; `scale` shortens or lengthens the runs."""
    bin_size = max(1, round(domain.episodes * scale) // _BINS)
    for name, learner in domain.learners.items():
        dataset = sweep(
            domain.env,
            learner,
            seeds=seeds,
            num_episodes=bin_size * _BINS,
            bin_size=bin_size,
            evaluate_every=_BINS,
            params=domain.params,
            cores=cores,
            key=key,
        )
        yield name, dataset
        if not dataset.attrs["complete"]:
            return


def summary_row(domain: Domain, name: str, dataset: xr.Dataset) -> Row:
    """What one learner reached: online in the last eighth of the run, greedily (exact) at its end."""
    episodes = int(dataset["episode"].values[-1])
    online = stats.mean_interval(stats.episode_range(dataset["return"], episodes - episodes // 8, episodes))
    greedy = dataset["greedy_return"].isel(checkpoint=-1)
    interval = stats.mean_interval(greedy)
    return {
        "domain": domain.name,
        "learner": name,
        "online": interval_row(online),
        "greedy": {**interval_row(interval), "median": float(greedy.median()), "best": float(greedy.max())},
        "steps_per_second": float(dataset["steps"].sum()) / float(dataset.attrs["seconds"]),
        "seconds": float(dataset.attrs["seconds"]),
        "seeds": int(dataset.sizes["seed"]),
        "episodes": episodes,
    }


def exact_row(domain: Domain, optima: Optima) -> Row:
    """The exact values of a domain, and where its hierarchy misses the condition of Theorem 2."""
    hierarchy = domain.env.hierarchy()
    tables = tabulate(hierarchy, domain.env)
    total = total_leaf_cover(hierarchy, active=tables.active)
    return {
        "domain": domain.name,
        "optimal": optima.optimal.mean,
        "hierarchically_optimal": optima.hierarchical.mean,
        "recursively_optimal": optima.recursive.mean,
        "pseudo_reward": domain.pseudo_reward,
        "inaccessible": sorted({f"{gap.subtask}: {gap.action}" for gap in inaccessible(hierarchy, tables.active)}),
        "added": {name: list(children) for name, children in total.added.items()},
    }


def table(exact_rows: list[Row], rows: list[Row]) -> str:
    """Exact values and what was reached, as text."""
    lines = ["expected return   optimal  hierarchically  recursively optimal"]
    for row in exact_rows:
        values = row["optimal"], row["hierarchically_optimal"], row["recursively_optimal"]
        lines.append(f"{row['domain']:15}{values[0]:10.4f}{values[1]:16.4f}{values[2]:21.4f}")
    lines.append("")
    lines.append(
        f"{'reached by':38}{'online':>9} {'±95%':>6}{'greedy':>10}{'median':>9}{'best':>9}  Msteps/s  a C++ peer"
    )
    for row in rows:
        low, high = row["online"]["lo"], row["online"]["hi"]
        half = (high - low) / 2 if low is not None else float("nan")
        peer = PEERS.get(row["learner"]) if row["domain"] == "Taxi" else None
        lines.append(
            f"{row['domain'] + ': ' + row['learner']:38}{row['online']['mean']:9.3f} {half:6.3f}"
            f"{row['greedy']['mean']:10.3f}{row['greedy']['median']:9.3f}{row['greedy']['best']:9.3f}"
            f"{row['steps_per_second'] / 1e6:10.1f}  " + (f"{peer[0]:.2f} ± {1.96 * peer[1]:.2f}" if peer else "")
        )
    return "\n".join(line.rstrip() for line in lines)


def maze_picture(optima: Optima) -> Figure:
    """The recursively and the hierarchically optimal policy of the maze (thesis Figure 2.1)."""
    figure = Figure(figsize=(8.4, 5.4), layout="constrained")
    env = Maze()
    shown = (("recursively optimal", optima.recursive), ("hierarchically optimal", optima.hierarchical))
    for (title, criterion), ax in zip(shown, figure.subplots(1, 2), strict=True):
        cell_render.draw_policy(env, np.maximum(criterion.action, 0), ax)
        ax.set_title(f"{title}: {criterion.mean:.4f}")
    return figure


def taxi_picture(results: dict[str, xr.Dataset], optimum: float) -> Figure:
    """Learning curves of flat Q-learning, MAXQ-Q, HORDQ and options on Taxi."""
    figure = Figure(figsize=(9, 5.4), layout="constrained")
    names = ("Q-learning", "options, SMDP Q", "HAMQ", "MAXQ-Q", "HORDQ", "shared HORDQ, total leaf cover")
    shown = {name: results[name] for name in names if name in results}
    ax = plots.learning_curves(shown, references={"optimum": optimum}, ax=figure.subplots())
    last = max((int(dataset["episode"].values[-1]) for dataset in shown.values()), default=1)
    for place, ((name, (value, error)), style) in enumerate(zip(PEERS.items(), "os^", strict=True)):
        x = last * (1 + 0.02 * place)  # side by side
        ax.errorbar(x, value, yerr=1.96 * error, fmt=style, color="#444444", ms=5, capsize=3, label=f"C++ peer, {name}")
    ax.set_ylim(-30, 6)
    ax.set_title("Stochastic Taxi, Gymnasium's rewards")
    ax.legend(fontsize="small", frameon=False, loc="lower right")
    return figure


def graph_picture() -> Figure:
    """Taxi's task graph before and after its leaf cover is made total (thesis Figure 3.2)."""
    hierarchy = Taxi().hierarchy()
    return drawing.draw_completion(hierarchy, total_leaf_cover(hierarchy))
