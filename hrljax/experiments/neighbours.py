"""All learners of the library side by side: how many steps they need, what they lose on the way, and what they cost."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrljax import stats
from hrljax.core.environment import Numbers
from hrljax.engine.start import learned_bytes
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.envs.bus.env import Bus
from hrljax.envs.grid.gridworld import Gridworld
from hrljax.envs.grid.maze import Maze
from hrljax.envs.taxi.env import Taxi
from hrljax.experiments.rows import Row, interval_row
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.leaf_cover import total_leaf_cover
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.base import AnyLearner
from hrljax.learners.dyna import DynaQ
from hrljax.learners.features import Features, state_features, variable_features
from hrljax.learners.feudal import FeudalQ
from hrljax.learners.flat import SARSA, QLearning
from hrljax.learners.hamq import HAMQ
from hrljax.learners.hordq import HORDQ, MAXQ, MAXQ0
from hrljax.learners.linear_dyna import LinearDyna
from hrljax.learners.options.definition import Options, options_from
from hrljax.learners.options.discovery import bottleneck_options, eigen_options
from hrljax.learners.options.h_dyna import HDyna
from hrljax.learners.options.learner import OptionQ
from hrljax.learners.rmax import RMax
from hrljax.learners.roots.linear import LinearRoot
from hrljax.learners.roots.model import ModelRoot
from hrljax.learners.shared import SharedHORDQ
from hrljax.learners.traces import QLambda, SARSALambda
from hrljax.solvers.dynamic_programming import policy_evaluation, value_iteration
from hrljax.sweeps.sweep import sweep

SHARE = 0.95
"""Of the way from random actions to the optimum, for the steps to reach it."""
_BINS = 200
_WINDOW = 10
"""Bins of the moving average that has to reach it."""
_FEW_STATES = 200


@dataclass(frozen=True)
class Domain:
    """A domain, and the numbers that its learners share."""

    name: str
    env: AnyTabularEnvironment
    max_steps: int
    episodes: int
    step_size: float
    initial_value: float = 0.0
    best_reward: float = 0.0  # more than this is never earned from anywhere: optimism of R-MAX
    known_after: int = 1  # steps after which chance has shown itself, for R-MAX

    @property
    def params(self) -> Numbers:
        return self.env.default_params._replace(max_steps=self.max_steps)

    @property
    def usual(self) -> dict[str, Any]:
        return {"step_size": self.step_size, "initial_value": self.initial_value}

    @cached_property
    def hierarchy(self) -> Hierarchy:
        return self.env.hierarchy()

    @cached_property
    def complete(self) -> Hierarchy:
        """With a total leaf cover."""
        active = tabulate(self.hierarchy, self.env).active
        return total_leaf_cover(self.hierarchy, active=active).hierarchy

    @cached_property
    def ways(self) -> Options:
        return options_from(self.hierarchy, self.env)

    @cached_property
    def features(self) -> Features:
        """Tables where they are small, else one feature a value of each variable."""
        return (state_features if self.env.num_states <= _FEW_STATES else variable_features)(self.env)

    @cached_property
    def root_decides(self) -> bool:
        """Whether the root has a choice anywhere."""
        return bool((tabulate(self.hierarchy, self.env).root_counts > 1).any())

    @property
    def is_grid(self) -> bool:
        return set(self.env.factored().names) == {"row", "column"}


def domains() -> dict[str, Domain]:
    """Maze, Taxi with Gymnasium's rewards, without and with chance, Bus and four rooms, by name."""
    every = (
        Domain("Maze", Maze(), 200, 200, 0.5),
        Domain("Four rooms", Gridworld(), 1000, 300, 0.5),
        Domain("Taxi", Taxi(rules="gymnasium"), 200, 1500, 0.5, best_reward=20.0),
        Domain(
            "stochastic Taxi", Taxi(stochastic=True, rules="gymnasium"), 200, 3000, 0.2, best_reward=20.0, known_after=5
        ),
        Domain("Bus", Bus(), 200, 6000, 0.1, -25.0, known_after=5),
    )
    return {domain.name: domain for domain in every}


LEARNERS: dict[str, Callable[[Domain], AnyLearner | None]] = {
    "Q-learning": lambda d: QLearning(**d.usual),
    "SARSA(0)": lambda d: SARSA(**d.usual),
    "Q(0.9)": lambda d: QLambda(**d.usual),
    "SARSA(0.9)": lambda d: SARSALambda(**d.usual),
    "Dyna-Q": lambda d: DynaQ(**d.usual, outcomes_kept=d.known_after),
    "R-MAX": lambda d: RMax(
        optimistic_value=d.best_reward, known_after=d.known_after, planning_tolerance=0.1, planning_sweeps=50
    ),
    "linear Dyna": lambda d: LinearDyna(d.features, d.step_size, d.step_size, initial_value=d.initial_value),
    "options, SMDP": lambda d: OptionQ(d.ways, **d.usual),
    "options, intra-option": lambda d: OptionQ(d.ways, **d.usual, update="intra_option"),
    "bottleneck options": lambda d: OptionQ(bottleneck_options(d.env), **d.usual),
    "eigen-options": lambda d: OptionQ(eigen_options(d.env), **d.usual),
    "H-DYNA": lambda d: HDyna(d.ways, **d.usual),
    "feudal Q-learning": lambda d: FeudalQ(step_size=d.step_size) if d.is_grid else None,
    "HAMQ": lambda d: HAMQ(d.hierarchy, **d.usual),
    "MAXQ-0": lambda d: MAXQ0(d.hierarchy, step_size=d.step_size),
    "MAXQ-Q": lambda d: MAXQ(d.hierarchy, step_size=d.step_size, pseudo_reward=20.0),
    "HORDQ": lambda d: HORDQ(d.hierarchy, **d.usual),
    "shared HORDQ": lambda d: SharedHORDQ(d.complete, **d.usual),
    "shared HORDQ, model root": lambda d: (
        SharedHORDQ(d.complete, ModelRoot(), **d.usual) if d.hierarchy.root.abstraction else None
    ),
    "shared HORDQ, linear root": lambda d: (
        SharedHORDQ(d.complete, LinearRoot(d.features), **d.usual) if d.root_decides else None
    ),
}
"""What makes each learner for a domain, by name; None where it does not apply. Other numbers are the defaults."""


class Exact:
    """Expected returns of an episode by dynamic programming, and the return that counts as reached."""

    def __init__(self, domain: Domain):
        model, initial = domain.env.model(domain.params), domain.env.initial_distribution(domain.params)
        uniform = np.full((model.num_states, model.num_actions), 1 / model.num_actions, np.float32)
        self.optimal = float(initial @ np.asarray(value_iteration(model).value))
        self.random = float(initial @ np.asarray(policy_evaluation(model, uniform, horizon=domain.max_steps)))
        self.threshold = self.random + SHARE * (self.optimal - self.random)


def run(
    domain: Domain, exact: Exact, names: Sequence[str], seeds: int, scale: float, cores: int | None, key: int
) -> Iterator[tuple[Row, xr.DataArray]]:
    """Runs learners on a domain, one after the other.

    Args:
        domain: what to run on.
        exact: of the domain.
        names: of `LEARNERS`.
        seeds: runs of each.
        scale: factor of the number of episodes.
        cores: to use, all if None.
        key: seed of all random numbers.

    Returns:
        For each a row of the table, and the steps to reach the threshold of every run. After a keyboard interrupt
        nothing follows what was cut short.
    """
    for name in names:
        learner = LEARNERS[name](domain)
        if learner is None:
            continue
        episodes = max(_WINDOW, int(domain.episodes * scale))
        options: dict[str, Any] = {
            "num_episodes": episodes,
            "bin_size": max(1, episodes // _BINS),
            "params": domain.params,
            "cores": cores,
            "key": key,
            "chunk_size": max(1, seeds // 8),
            "progress": False,
        }
        dataset, begin = None, 0.0
        for _ in range(2):  # the first time all is compiled
            begin = time.process_time()
            dataset = sweep(domain.env, learner, seeds=seeds, **options)
            if not dataset.attrs["complete"]:
                return
        assert dataset is not None
        seconds = time.process_time() - begin
        reached = steps_to_reach(dataset, exact.threshold)
        memory = learned_bytes(domain.env, learner)
        yield row(domain.name, name, dataset, reached, exact.optimal, seconds, memory), reached


def steps_to_reach(dataset: xr.Dataset, threshold: float) -> xr.DataArray:
    """Primitive steps of every run until the average of `_WINDOW` bins reaches a return; infinity if it never does."""
    ends = dataset["episode"].values
    window = min(int(ends[0]) * _WINDOW, int(ends[-1]))
    episodes = stats.episodes_to_reach(dataset["return"], threshold, window=window)
    bins = xr.DataArray(np.diff(ends, prepend=0), coords={"episode": ends}, dims="episode")
    so_far = (dataset["length"] * bins).cumsum("episode").assign_coords(episode=ends)
    at = so_far.sel(episode=episodes.where(np.isfinite(episodes), ends[-1]).astype(int)).drop_vars("episode")
    return at.where(np.isfinite(episodes), np.inf).assign_attrs(long_name="steps to reach", units="steps")


def row(
    domain: str,
    learner: str,
    dataset: xr.Dataset,
    reached: xr.DataArray,
    optimal: float,
    seconds: float,
    memory: int,
) -> Row:
    """The numbers of a learner on a domain.

    Args:
        domain, learner: names.
        dataset: of the sweep.
        reached: those of `steps_to_reach`.
        optimal: expected return of the best policy.
        seconds: of the processor, for all runs.
        memory: bytes of what a run has learned.
    """
    bins = np.diff(dataset["episode"].values, prepend=0)
    regret = ((optimal - dataset["return"]) * xr.DataArray(bins, dims="episode")).sum("episode")
    steps = interval_row(stats.bootstrap_interval(reached, "median").rename(median="mean"))
    seeds = dataset.sizes["seed"]
    return {
        "domain": domain,
        "learner": learner,
        "steps_to_reach": {"median": steps.pop("mean"), **steps},
        "reached": float(np.isfinite(reached).mean()),
        "regret": interval_row(stats.mean_interval(regret)),
        "final_return": float(dataset["return"].isel(episode=slice(-max(1, len(bins) // 8), None)).mean()),
        "seconds": seconds / seeds,
        "microseconds_per_step": 1e6 * seconds / float(dataset["steps"].sum()),
        "memory": memory,
        "seeds": seeds,
        "episodes": int(bins.sum()),
    }


def table(rows: Sequence[Row]) -> str:
    """The rows as Markdown."""

    def number(value: float | None) -> str:
        return "never" if value is None else f"{value:,.0f}"

    lines = [
        "| domain | learner | steps to 95 % | runs that get there | regret | return at the end | seconds | kB |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for of in rows:
        steps, regret = of["steps_to_reach"], of["regret"]
        lines.append(
            f"| {of['domain']} | {of['learner']} "
            f"| {number(steps['median'])} [{number(steps['lo'])}, {number(steps['hi'])}] | {of['reached']:.0%} "
            f"| {number(regret['mean'])} [{number(regret['lo'])}, {number(regret['hi'])}] "
            f"| {of['final_return']:.1f} | {of['seconds']:.2g} | {of['memory'] / 1000:,.0f} |"
        )
    return "\n".join(lines)


def picture(rows: Sequence[Row]) -> Figure:
    """Regret against the processor's seconds of a run, a panel for each domain; both axes logarithmic."""
    names = list(dict.fromkeys(of["domain"] for of in rows))
    learners = list(dict.fromkeys(of["learner"] for of in rows))
    figure = Figure(figsize=(4.3 * len(names), 6.2), layout="constrained")
    panels = figure.subplots(1, len(names), squeeze=False)[0]
    for name, ax in zip(names, panels, strict=True):
        _panel(ax, [of for of in rows if of["domain"] == name], learners)
        ax.set_title(name)
    panels[0].set_ylabel("regret of a run")
    handles = {label: handle for ax in panels for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=min(5, len(handles)), fontsize=9
    )
    return figure


def _panel(ax: Axes, rows: Sequence[Row], learners: Sequence[str]) -> None:
    markers = "osD^v<>pPX*h"
    for of in rows:
        number, regret = learners.index(of["learner"]), of["regret"]
        low, high = ((regret[end] if regret[end] is not None else regret["mean"]) for end in ("lo", "hi"))
        reach = [[max(regret["mean"] - low, 0)], [max(high - regret["mean"], 0)]]
        marker, colour = markers[number % len(markers)], f"C{number % 10}"
        inside = colour if of["steps_to_reach"]["median"] is not None else "none"
        ax.errorbar(
            of["seconds"],
            regret["mean"],
            reach,
            label=of["learner"],
            color=colour,
            fmt=marker,
            markerfacecolor=inside,
        )
    ax.set(xscale="log", yscale="log", xlabel="processor seconds of a run")
