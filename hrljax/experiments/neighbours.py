"""All learners of the library side by side: how many steps they need, what they lose on the way, and what they cost."""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hrljax import stats
from hrljax.engine.start import learned_bytes
from hrljax.experiments.neighbour_learners import LEARNERS, Domain
from hrljax.experiments.rows import Row, interval_row
from hrljax.solvers.dynamic_programming import value_iteration
from hrljax.sweeps.sweep import sweep

SHARE = 0.95
"""Of the way from random actions to the optimum, for the steps to reach it."""
_BINS = 200
_WINDOW = 10
"""Bins of the moving average that has to reach it."""


class Exact:
    """Expected returns of an episode by dynamic programming, and the return that counts as reached."""

    def __init__(self, domain: Domain):
        self.optimal = domain.expected_return(value_iteration(domain.model).value)
        self.random = domain.random_return()
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
        chunk = max(1, seeds // 8)
        options: dict[str, Any] = {
            "num_episodes": episodes,
            "bin_size": max(1, episodes // _BINS),
            "params": domain.params,
            "cores": cores,
            "key": key,
            "chunk_size": chunk,
            "progress": False,
        }
        dataset, begin = None, 0.0
        for runs in (chunk, seeds):  # the first time all is compiled
            begin = time.process_time()
            dataset = sweep(domain.env, learner, seeds=runs, **options)
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
    """Regret against the processor's seconds of a run, a panel for each domain; both axes logarithmic.

    A line joins the learners beside which no other loses less in fewer seconds.
    """
    names = list(dict.fromkeys(of["domain"] for of in rows))
    learners = list(dict.fromkeys(of["learner"] for of in rows))
    columns = min(3, len(names) + 1)
    height = -(-(len(names) + 1) // columns)
    figure = Figure(figsize=(4.3 * columns, 4.2 * height), layout="constrained")
    *panels, last = figure.subplots(height, columns, squeeze=False).ravel()[: len(names) + 1]
    for unused in figure.axes[len(names) :]:
        unused.axis("off")
    for name, ax in zip(names, panels, strict=True):
        _panel(ax, [of for of in rows if of["domain"] == name], learners)
        ax.set(title=name, xlabel="processor seconds of a run")
    for ax in panels[::columns]:
        ax.set_ylabel("regret of a run")
    handles = [Line2D([], [], linestyle="none", label=learner, **_mark(learners, learner)) for learner in learners]
    last.legend(handles=handles, loc="center", ncols=2, fontsize=9, frameon=False)
    return figure


def _mark(learners: Sequence[str], learner: str) -> dict[str, Any]:
    number, markers = learners.index(learner), "osD^v<>pPX*h"
    return {"marker": markers[number % len(markers)], "color": f"C{number % 10}"}


def _panel(ax: Axes, rows: Sequence[Row], learners: Sequence[str]) -> None:
    best: list[tuple[float, float]] = []
    for of in sorted(rows, key=lambda of: (of["seconds"], of["regret"]["mean"])):
        regret, mark = of["regret"], _mark(learners, of["learner"])
        low, high = ((regret[end] if regret[end] is not None else regret["mean"]) for end in ("lo", "hi"))
        reach = [[max(regret["mean"] - low, 0)], [max(high - regret["mean"], 0)]]
        inside = mark["color"] if of["steps_to_reach"]["median"] is not None else "none"
        ax.errorbar(of["seconds"], regret["mean"], reach, linestyle="none", markerfacecolor=inside, **mark)
        if not best or regret["mean"] < best[-1][1]:
            best.append((of["seconds"], regret["mean"]))
    ax.step(*zip(*best, strict=True), where="post", color="0.8", zorder=0)
    ax.set(xscale="log", yscale="log")
