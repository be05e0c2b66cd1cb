"""Which pseudo-reward? Fixed ones, an annealed one and one that fades, on many domains, under good and bad roots."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import optax
import xarray as xr
from matplotlib.figure import Figure

from hrljax import stats
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.envs.bus.env import Bus
from hrljax.envs.grid.maze import Maze
from hrljax.envs.taxi.env import Taxi
from hrljax.experiments import bus_maps
from hrljax.experiments.graded_root import GradedRoot
from hrljax.experiments.random_tasks import random_task
from hrljax.experiments.rows import Row, interval_row
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.leaf_cover import total_leaf_cover
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.base import AnyLearner
from hrljax.learners.fading import Fading
from hrljax.learners.flat import SARSA, QLearning
from hrljax.learners.hordq import HORDQ, MAXQ
from hrljax.learners.roots.base import AnySubtaskRoot
from hrljax.learners.roots.model import ModelRoot
from hrljax.learners.roots.random import RandomRoot
from hrljax.learners.shared import SharedHORDQ
from hrljax.plots import style
from hrljax.sweeps.sweep import sweep

FIXED = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0)
DEFAULT = "shared, fading"
"""The rule that a newcomer should use."""
_BINS = 100


@dataclass(frozen=True)
class Case:
    """A domain under a root."""

    domain: str
    root_name: str
    env: AnyTabularEnvironment
    hierarchy: Hierarchy
    root: AnySubtaskRoot | None
    episodes: int
    max_steps: int
    numbers: dict[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return f"{self.domain}, {self.root_name}"

    def learners(self, episodes: int) -> dict[str, tuple[AnyLearner, dict[str, tuple[float, ...]]]]:
        """Learners with axes, by name; those with the axis of pseudo-rewards stand for one rule each."""
        common: dict[str, Any] = dict(self.numbers)
        of_maxq: dict[str, Any] = common | {"pseudo_reward": 60.0, "initial_value": 0.0}
        axis = {"pseudo_reward": FIXED}
        annealed = optax.linear_schedule(5.0, 0.0, max(1, episodes // 2))
        fading, where = Fading(), (self.hierarchy, self.root)
        return {
            "Q-learning": (QLearning(**common), {}),
            "SARSA(0)": (SARSA(**common), {}),
            "MAXQ-Q(60)": (MAXQ(*where, **of_maxq), {}),
            "shared": (SharedHORDQ(*where, pseudo_reward=0.0, **common), axis),
            "apart": (HORDQ(*where, pseudo_reward=0.0, **common), axis),
            "shared, 5 to 0": (SharedHORDQ(*where, pseudo_reward=annealed, **common), {}),
            "apart, 5 to 0": (HORDQ(*where, pseudo_reward=annealed, **common), {}),
            "shared, fading": (SharedHORDQ(*where, pseudo_reward=fading, **common), {}),
            "apart, fading": (HORDQ(*where, pseudo_reward=fading, **common), {}),
            "shared, fading, all active": (SharedHORDQ(*where, pseudo_reward=fading, taught="active", **common), {}),
        }


def cases() -> list[Case]:
    """Three Bus domains, Maze, stochastic Taxi and four random processes; roots that plan, learn, guess and mislead."""
    roots: dict[str, AnySubtaskRoot] = {"model": ModelRoot(), "random": RandomRoot(), "adversary": GradedRoot(-1.0)}
    buses = {"Bus": Bus(), "Bus, loop": Bus(map=bus_maps.LOOP), "Bus, corridor": Bus(map=bus_maps.CORRIDOR)}
    bus_numbers = {"step_size": 0.1, "epsilon": 0.1, "initial_value": -25.0}
    chosen = [
        Case(domain, name, env, env.hierarchy(), root, 20_000, 1000, bus_numbers)
        for domain, env in buses.items()
        for name, root in roots.items()
    ]
    for domain, env, episodes, max_steps, numbers in (
        ("Maze", Maze(), 2000, 200, {"step_size": 0.5, "epsilon": 0.1, "initial_value": 0.0}),
        (
            "Taxi",
            Taxi(stochastic=True, rules="gymnasium"),
            20_000,
            200,
            {"step_size": 0.125, "epsilon": 0.01, "initial_value": 0.0},
        ),
    ):
        hierarchy = total_leaf_cover(env.hierarchy(), active=tabulate(env.hierarchy(), env).active).hierarchy
        chosen.append(Case(domain, "learning", env, hierarchy, None, episodes, max_steps, numbers))
    numbers = {"step_size": 0.1, "epsilon": 0.1, "initial_value": 0.0}
    planner: dict[str, AnySubtaskRoot] = {"planner": GradedRoot(1.0)}
    for number in range(4):
        env, hierarchy = random_task(number)
        for name, root in (planner | roots).items():
            if name != "model":
                chosen.append(Case(env.name, name, env, hierarchy, root, 5000, env.max_steps, numbers))
    return chosen


def run(case: Case, seeds: int, scale: float, cores: int | None, key: int) -> Iterator[tuple[str, xr.Dataset]]:
    """Runs a case's learners one after the other; a dataset holds the runs of one learner."""
    bin_size = max(1, round(case.episodes * scale) // _BINS)
    for name, (learner, axes) in case.learners(bin_size * _BINS).items():
        dataset = sweep(
            case.env,
            learner,
            seeds=seeds,
            num_episodes=bin_size * _BINS,
            axes={axis: list(values) for axis, values in axes.items()},
            bin_size=bin_size,
            params=case.env.default_params._replace(max_steps=case.max_steps),
            cores=cores,
            key=key,
        )
        yield name, dataset
        if not dataset.attrs["complete"]:
            return


def by_rule(name: str, dataset: xr.Dataset) -> dict[str, xr.DataArray]:
    """Returns of a learner's runs by rule: one for each pseudo-reward of its axis."""
    returns = dataset["return"]
    if "pseudo_reward" not in returns.dims:
        return {name: returns}
    return {f"{name}, {number:g}": returns.sel(pseudo_reward=number, drop=True) for number in FIXED}


def rows(case: Case, returns: dict[str, xr.DataArray]) -> list[Row]:
    """What each rule earned, and how far that is from the best, in hindsight, of Q-learning and all fixed ones."""
    whole = {rule: values.mean("episode") for rule, values in returns.items()}
    last = {rule: values.isel(episode=slice(-_BINS // 10, None)).mean("episode") for rule, values in returns.items()}
    fixed = ["Q-learning", *(f"{values}, {number:g}" for values in ("shared", "apart") for number in FIXED)]
    known = [rule for rule in fixed if rule in whole]
    table: list[Row] = []
    for rule in returns:
        row: Row = {"domain": case.domain, "root": case.root_name, "rule": rule}
        for what, values in (("whole", whole), ("last_tenth", last)):
            row[what] = interval_row(stats.mean_interval(values[rule]))
            if known:
                best = max(known, key=lambda name: float(values[name].mean()))
                regret = stats.mean_interval(stats.paired_differences(values[best], values[rule]))
                row |= {f"best_{what}": best, f"regret_{what}": interval_row(regret)}
                row[f"percent_{what}"] = 100 * float(regret["mean"]) / abs(float(values[best].mean()))
        row["seeds"] = int(whole[rule].notnull().sum())
        table.append(row)
    return table


_SHOWN = ("Q-learning", "SARSA(0)", "MAXQ-Q(60)", "apart, fading", "shared, 1", DEFAULT)


def table(rows: list[Row]) -> str:
    """The rows as text: how many percent rules are behind the best in hindsight, by domain and root and in all."""
    known = [row for row in rows if "percent_whole" in row]
    names = [rule for rule in _SHOWN if any(row["rule"] == rule for row in known)]
    lines = [f"{'% behind, whole / last tenth':29}{'best in hindsight':>18}" + "".join(f"{name:>19}" for name in names)]
    for domain, root in dict.fromkeys((row["domain"], row["root"]) for row in known):
        by_name = {row["rule"]: row for row in known if (row["domain"], row["root"]) == (domain, root)}
        best = by_name[next(iter(by_name.values()))["best_whole"]]
        cells = ["" if row is None else _percents(row) for row in map(by_name.get, names)]
        head = f"{domain + ', ' + root:29}{best['rule'] + format(best['whole']['mean'], '7.1f'):>18}"
        lines.append(head + "".join(f"{cell:>19}" for cell in cells))
    lines += ["", f"{'% behind, whole run':29}{'mean':>9}{'most':>9}"]
    for rule in dict.fromkeys(row["rule"] for row in known):
        behind = [row["percent_whole"] for row in known if row["rule"] == rule]
        lines.append(f"{rule:29}{np.mean(behind):9.1f}{max(behind):9.1f}")
    return "\n".join(line.rstrip() for line in lines)


def _percents(row: Row) -> str:
    return f"{row['percent_whole']:+8.1f} /{row['percent_last_tenth']:+7.1f}"


def picture(rows: list[Row]) -> Figure:
    """How far each rule is from the best in hindsight over the whole run, domain by domain."""
    groups = list(dict.fromkeys((row["domain"], row["root"]) for row in rows))
    figure = Figure(figsize=(11, 1.6 + 0.38 * len(groups)), layout="constrained")
    ax = figure.subplots()
    known = [row for row in rows if "percent_whole" in row]
    fixed = [row for row in known if row["rule"].split(", ")[-1] in {f"{number:g}" for number in FIXED}]
    for values, marker in (("shared", "|"), ("apart", "x")):
        points = [row for row in fixed if row["rule"].startswith(values)]
        _scatter(ax, points, groups, label=f"fixed pseudo-rewards, {values}", marker=marker, color="0.65", zorder=1)
    for number, rule in enumerate(_SHOWN):
        points = [row for row in known if row["rule"] == rule]
        marker = "D" if rule == DEFAULT else "o"
        _scatter(
            ax, points, groups, label=rule, marker=marker, color=style.COLOURS[number], zorder=3 + (rule == DEFAULT)
        )
    ax.axvline(0, color="0.3", linewidth=0.8)
    ax.axvspan(-100, 3, color="0.93", zorder=0)
    ax.set_xscale("symlog", linthresh=10, linscale=1.5)
    ax.set_xlim(-20, 2000)
    ax.set_yticks(range(len(groups)), [", ".join(group) for group in groups])
    ax.invert_yaxis()
    ax.set_xlabel("percent behind the best of Q-learning and all fixed pseudo-rewards in hindsight, whole run")
    ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
    return figure


def _scatter(ax: Any, points: list[Row], groups: list[tuple[str, str]], **how: Any) -> None:
    percent = np.array([row["percent_whole"] for row in points])
    ax.scatter(percent, [groups.index((row["domain"], row["root"])) for row in points], **how)
