"""How fast learners learn, and how much that depends on step size and pseudo-reward: Maze, Taxi and Bus."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from hrljax import stats
from hrljax.envs.bus.env import Bus
from hrljax.envs.grid.maze import Maze
from hrljax.envs.taxi.env import Taxi
from hrljax.experiments.domains import Domain as AnyDomain
from hrljax.experiments.rows import Row, interval_row
from hrljax.learners.base import AnyLearner
from hrljax.learners.flat import SARSA, QLearning
from hrljax.learners.hordq import HORDQ, MAXQ
from hrljax.learners.shared import SharedHORDQ
from hrljax.solvers.dynamic_programming import value_iteration
from hrljax.sweeps.sweep import sweep

SHARE = 0.5
"""Of the way from random actions to the best epsilon-soft policy, for the episodes to reach it."""

_BINS = 48
_EPSILON = 0.1
_RETURN = {"units": "reward"}


@dataclass(frozen=True)
class Domain(AnyDomain):
    """A domain with its learners, which differ in how they learn only."""

    initial_value: float

    def learners(self) -> dict[str, AnyLearner]:
        """Flat and hierarchical learners; roots learn as any subtask. MAXQ's values of a subtask start at 0.

        The pseudo-reward of the shared values fades by itself.
        """
        hierarchy, complete, initial = self.hierarchy, self.complete, self.initial_value
        return {
            "Q-learning": QLearning(epsilon=_EPSILON, initial_value=initial),
            "SARSA(0)": SARSA(epsilon=_EPSILON, initial_value=initial),
            "MAXQ-Q": MAXQ(hierarchy, epsilon=_EPSILON),
            "HORDQ": HORDQ(hierarchy, epsilon=_EPSILON, initial_value=initial),
            "shared HORDQ": SharedHORDQ(complete, epsilon=_EPSILON, initial_value=initial),
        }


def domains() -> list[Domain]:
    """Maze, stochastic Taxi with Gymnasium's rewards, and Bus; an episode is cut off after 200 steps."""
    return [
        Domain("Maze", Maze(), 200, 100, 0.0),
        Domain("Taxi", Taxi(stochastic=True, rules="gymnasium"), 200, 300, 0.0),
        Domain("Bus", Bus(), 200, 300, -25.0),
    ]


def exact(domain: Domain) -> dict[str, float]:
    """Expected returns of an episode by dynamic programming: where learning starts, and what it can reach."""
    return {
        "optimal": domain.expected_return(value_iteration(domain.model).value),
        "epsilon_soft": domain.expected_return(value_iteration(domain.model, epsilon=_EPSILON).value),
        "random": domain.random_return(),
    }


def run(
    domain: Domain,
    values: dict[str, float],
    step_sizes: Sequence[float],
    pseudo_rewards: Sequence[float],
    seeds: int,
    scale: float,
    cores: int | None,
    key: int,
) -> Iterator[tuple[str, xr.Dataset]]:
    """Runs a domain's learners one after the other, and keeps a few numbers of each run.

    Whole curves are held for one step size at a time: seeds x pseudo-rewards x 48 bins, about 60 kB a
    seed. Results are those of one sweep over both axes.

    Args:
        domain: what to run.
        values: those of `exact`.
        step_sizes: of every learner, different numbers in (0, 1].
        pseudo_rewards: of the hierarchical learners, different numbers.
        seeds: runs of every setting.
        scale: factor of the number of episodes.
        cores: cores to use, all if None.
        key: seed of all random numbers.

    Returns:
        Learners' names with what `measured` returns, ``step_size`` first. After a keyboard interrupt
        ``complete`` is 0 among its attributes, and nothing follows.
    """
    episodes = max(2, int(domain.episodes * scale))
    for name, learner in domain.learners().items():
        further = {"pseudo_reward": pseudo_rewards} if "pseudo_reward" in learner.sweepable() else {}
        parts: list[xr.Dataset] = []
        for step_size in step_sizes:
            dataset = sweep(
                domain.env,
                learner,
                seeds=seeds,
                num_episodes=episodes,
                axes={"step_size": [step_size], **further},
                bin_size=max(1, episodes // _BINS),
                params=domain.params,
                cores=cores,
                key=key,
            )
            parts.append(measured(dataset, values))
            if not dataset.attrs["complete"]:
                break
        joined = xr.concat(parts, "step_size", combine_attrs="drop_conflicts")
        for total in ("seconds", "compile_seconds"):
            joined.attrs[total] = sum(part.attrs[total] for part in parts)
        joined.attrs["complete"] = parts[-1].attrs["complete"]
        yield name, joined
        if not joined.attrs["complete"]:
            return


def measured(dataset: xr.Dataset, values: dict[str, float]) -> xr.Dataset:
    """A few numbers of every run, and the mean curve with its interval.

    Returns:
        ``mean_return`` per episode of the whole run, ``final_return`` of its last eighth,
        ``episodes_to_reach`` the threshold (`SHARE`), and ``steps``, all without ``episode``;
        ``curve``, ``curve_low`` and ``curve_high`` without ``seed``.
    """
    returns = dataset["return"].assign_attrs(_RETURN)
    ends = returns["episode"].values
    last, late = int(ends[-1]), int(ends[max(0, len(ends) * 7 // 8 - 1)])
    reached = stats.episodes_to_reach(
        returns,
        values["epsilon_soft"],
        share=SHARE,
        baseline=values["random"],
        window=min(3 * int(ends[0]), last),
    )
    curve = stats.mean_interval(returns)
    summary = xr.Dataset(
        {
            "mean_return": stats.episode_range(returns, 0, last),
            "final_return": stats.episode_range(returns, late if late < last else 0, last),
            "episodes_to_reach": reached,
            "steps": dataset["steps"],
            "curve": curve["mean"],
            "curve_low": curve["low"],
            "curve_high": curve["high"],
        },
        attrs=dataset.attrs,
    )
    summary["mean_return"].attrs = {"long_name": "return per episode", **_RETURN}
    summary["final_return"].attrs = {"long_name": "return per episode at the end", **_RETURN}
    return summary


def best(dataset: xr.Dataset) -> dict[str, float]:
    """The setting with the greatest mean return over seeds, by name of the hyper-parameter."""
    means = dataset["mean_return"].mean("seed").fillna(-np.inf)
    place = means.argmax(...)
    return {str(name): float(means[name][index]) for name, index in place.items()}


def setting_rows(domain: str, learner: str, dataset: xr.Dataset) -> list[Row]:
    """The numbers of every setting."""
    axes = {str(dim): dataset[dim].values for dim in dataset["mean_return"].dims if dim != "seed"}
    return [
        setting_row(domain, learner, dataset, dict(zip(axes, map(float, values), strict=True)))
        for values in itertools.product(*axes.values())
    ]


def setting_row(domain: str, learner: str, dataset: xr.Dataset, setting: dict[str, float]) -> Row:
    """The numbers of one setting for ``summary.json``, the table and the CSV."""
    runs = dataset.sel(setting)
    middle = stats.bootstrap_interval(runs["mean_return"], "interquartile_mean")
    reached = runs["episodes_to_reach"]
    median = float(stats.estimate(reached, "median"))
    return {
        "domain": domain,
        "learner": learner,
        "step_size": setting["step_size"],
        "pseudo_reward": setting.get("pseudo_reward"),
        "mean_return": interval_row(stats.mean_interval(runs["mean_return"])),
        "interquartile_mean": interval_row(middle.rename(interquartile_mean="mean")),
        "final_return": interval_row(stats.mean_interval(runs["final_return"])),
        "episodes_to_reach": median if np.isfinite(median) else None,
        "reached": float(np.isfinite(reached).sum() / max(1, int(reached.notnull().sum()))),
        "seeds": int(runs["mean_return"].notnull().sum()),
    }


def best_row(domain: str, learner: str, dataset: xr.Dataset) -> Row:
    """The numbers of a learner's best setting, and how fast all its settings ran."""
    seconds = float(dataset.attrs["seconds"])
    return {
        **setting_row(domain, learner, dataset, best(dataset)),
        "steps_per_second": float(dataset["steps"].sum()) / seconds,
        "seconds": seconds,
        "compile_seconds": float(dataset.attrs["compile_seconds"]),
    }


def comparisons(domain: str, datasets: dict[str, xr.Dataset]) -> list[Row]:
    """How HORDQ compares with each other learner, both at their best, run by run."""
    chosen = {name: dataset["mean_return"].sel(best(dataset), drop=True) for name, dataset in datasets.items()}
    rows = []
    for name, runs in chosen.items():
        if "HORDQ" not in chosen or name == "HORDQ":
            continue
        improvement = stats.probability_of_improvement(chosen["HORDQ"], runs)
        paired = stats.mean_interval(stats.paired_differences(chosen["HORDQ"], runs))
        rows.append(
            {
                "domain": domain,
                "first": "HORDQ",
                "second": name,
                "probability_of_improvement": interval_row(improvement.rename(probability="mean")),
                "paired_difference": interval_row(paired),
            }
        )
    return rows


def csv(rows: list[Row]) -> str:
    """Every setting as comma-separated values; empty where there is no number."""
    intervals = ("mean_return", "interquartile_mean", "final_return")
    plain = ("domain", "learner", "step_size", "pseudo_reward")
    last = ("episodes_to_reach", "reached", "seeds")
    ends = (("mean", ""), ("lo", "_low"), ("hi", "_high"))
    lines = [",".join([*plain, *(name + end for name in intervals for _, end in ends), *last])]
    for row in rows:
        numbers = [row[name][end] for name in intervals for end, _ in ends]
        cells = [*(row[name] for name in plain), *numbers, *(row[name] for name in last)]
        lines.append(",".join("" if c is None else f"{c:.6g}" if isinstance(c, float) else str(c) for c in cells))
    return "\n".join(lines) + "\n"


def table(rows: list[Row], comparisons: list[Row]) -> str:
    """The best settings and their comparisons as text."""

    def number(value: float | None, form: str) -> str:
        return format(float("nan") if value is None else value, form)

    def interval(row: Row, form: str) -> str:
        return f"{number(row['mean'], form)} [{number(row['lo'], form)},{number(row['hi'], form)}]"

    lines = [
        f"{'best setting of':20}{'step size':>10}{'pseudo-r.':>10}"
        f"{'return, mean':>27}{'interquartile mean':>27}{'at end':>9}{'reached':>9}{'after':>7}"
    ]
    for row in rows:
        pseudo = "" if row["pseudo_reward"] is None else f"{row['pseudo_reward']:g}"
        lines.append(
            f"{row['domain'] + ': ' + row['learner']:20}{row['step_size']:10g}{pseudo:>10}"
            f"  {interval(row['mean_return'], '7.2f')}  {interval(row['interquartile_mean'], '7.2f')}"
            f"{number(row['final_return']['mean'], '9.2f')}{row['reached']:9.1%}"
            f"{'never' if row['episodes_to_reach'] is None else format(row['episodes_to_reach'], '.0f'):>7}"
        )
    lines += ["", f"{'run by run':36}{'probability of improvement':>28}{'paired difference':>28}"]
    for row in comparisons:
        lines.append(
            f"{row['domain']}: {row['first'] + ' over ' + row['second']:30}"
            f"{interval(row['probability_of_improvement'], '.3f'):>28}{interval(row['paired_difference'], '.2f'):>28}"
        )
    return "\n".join(line.rstrip() for line in lines)
