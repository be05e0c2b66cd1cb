"""The learning curves of the Bus domain (thesis Figure 4.2)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import optax
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from hrljax import plots, stats
from hrljax.engine import batch
from hrljax.envs.bus.env import Bus, BusParams
from hrljax.envs.bus.map import KAO_V1
from hrljax.experiments.backup import PseudoRewardInBackup
from hrljax.experiments.rows import Row, interval_row
from hrljax.learners.base import AnyLearner
from hrljax.learners.flat import SARSA, QLearning
from hrljax.learners.hordq import HORDQ, MAXQ
from hrljax.learners.roots.model import ModelRoot
from hrljax.learners.roots.random import RandomRoot
from hrljax.learners.shared import SharedHORDQ
from hrljax.solvers.dynamic_programming import policy_evaluation, value_iteration
from hrljax.sweeps.sweep import sweep

PANELS = {"model": "(a) model-based root", "random": "(b) random root", "fails": "what fails"}
WINDOW = 400
"""Episodes of the moving average in the picture."""

_BINS = (0, 500, 1000, 2000, 4000, 7000, 10_000, 15_000, 20_000)
_FAILING_EPISODES = 2000


@dataclass(frozen=True)
class Curve:
    """One learner of the figure; `panel` is "both" for learners without a root."""

    name: str
    panel: str
    learner: AnyLearner

    @property
    def panels(self) -> tuple[str, ...]:
        return ("model", "random") if self.panel == "both" else (self.panel,)


def curves(num_episodes: int) -> list[Curve]:
    """The thesis's learners, and HORDQ with shared values and a pseudo-reward that fades.

    Every value starts at -25, near those of the optimal policy; MAXQ's at 0.
    """
    hierarchy = Bus().hierarchy()
    annealed = optax.linear_schedule(5.0, 0.0, max(1, num_episodes // 2))
    learners = [
        Curve("SARSA(0)", "both", SARSA(initial_value=-25.0)),
        Curve("Q-learning", "both", QLearning(initial_value=-25.0)),
    ]
    for panel, root in (("model", ModelRoot()), ("random", RandomRoot())):
        for name, pseudo_reward in (("0", 0.0), ("5", 5.0), ("60", 60.0), ("5 to 0", annealed)):
            learner = HORDQ(hierarchy, root, pseudo_reward=pseudo_reward, initial_value=-25.0)
            learners.append(Curve(f"HORDQ({name})", panel, learner))
        learners.append(Curve("MAXQ(60)", panel, MAXQ(hierarchy, root, pseudo_reward=60.0)))
        learners.append(Curve("shared, fading", panel, SharedHORDQ(hierarchy, root, initial_value=-25.0)))
    in_backup = PseudoRewardInBackup(hierarchy, RandomRoot(), pseudo_reward=5.0, initial_value=-25.0)
    learners.append(Curve("MAXQ(0), random root", "fails", MAXQ(hierarchy, RandomRoot(), pseudo_reward=0.0)))
    learners.append(Curve("HORDQ(5 in the backup), random root", "fails", in_backup))
    return learners


def exact() -> Row:
    """Figures of the Bus domain by dynamic programming, expected returns of an episode."""
    env = Bus()
    model, initial = env.model(), env.initial_distribution()
    starts = np.flatnonzero(initial)
    optimal = np.asarray(value_iteration(model).value)
    blind = value_iteration(env.model(BusParams(damage_probability=0.0)))
    walled = Bus(map="\n".join(_wall_up(line, i) for i, line in enumerate(KAO_V1.splitlines())))
    by_status = dict(zip(("none", *env.layout.site_names), optimal[starts].tolist(), strict=True))
    return {
        "optimal": {**by_status, "mean": float(initial @ optimal)},
        "blind": float(initial @ np.asarray(policy_evaluation(model, blind.policy))),
        "avoid": float(walled.initial_distribution() @ np.asarray(value_iteration(walled.model()).value)),
        "no_sites": float(initial @ np.asarray(blind.value)),
        "epsilon_soft": float(initial @ np.asarray(value_iteration(model, epsilon=0.1).value)),
    }


def _wall_up(line: str, number: int) -> str:
    """A line of the map with walls in the place of construction sites."""
    return line.replace(" A ", " | ").replace(" B ", "---") if number in (5, 8) else line


def bin_size(num_episodes: int) -> int:
    """A bin size that every limit of the table, the window and the run is a multiple of."""
    limits = [limit for limit in (*_BINS, WINDOW) if 0 < limit <= num_episodes]
    return int(np.gcd.reduce([*limits, num_episodes]))


def run(
    seeds: int, num_episodes: int, cores: int | None, mapping: batch.Mapping, key: int
) -> Iterator[tuple[Curve, xr.Dataset]]:
    """Runs one curve after the other. Those that fail are shown by fewer episodes and seeds."""
    for curve in curves(num_episodes):
        fails = curve.panel == "fails"
        episodes = min(num_episodes, _FAILING_EPISODES) if fails else num_episodes
        dataset = sweep(
            Bus(),
            curve.learner,
            seeds=min(seeds, 20) if fails else seeds,
            num_episodes=episodes,
            bin_size=bin_size(episodes),
            cores=cores,
            mapping=mapping,
            key=key,
        )
        dataset.attrs["curve"] = curve.name
        yield curve, dataset
        if not dataset.attrs["complete"]:
            return


def summary_row(curve: Curve, dataset: xr.Dataset) -> Row:
    """The entry of a curve in ``summary.json``."""
    episodes = int(dataset["episode"].values[-1])
    limits = [limit for limit in _BINS if limit < episodes] + [episodes]
    whole = stats.mean_interval(stats.episode_range(dataset["return"], 0, episodes))
    bins = []
    for first, last in zip(limits, limits[1:], strict=False):
        interval = stats.mean_interval(stats.episode_range(dataset["return"], first, last))
        bins.append({"from": first, "to": last, **interval_row(interval)})
    damage = stats.episode_range(dataset["damage"], limits[-2], episodes).mean()
    seconds = float(dataset.attrs["seconds"])
    return {
        "name": curve.name,
        "panel": curve.panel,
        "mean_return": float(whole["mean"]),
        "ci95": [interval_row(whole)[end] for end in ("lo", "hi")],
        "bins": bins,
        "damage_per_episode": float(damage),
        "truncated_per_episode": float(stats.episode_range(dataset["truncated"], 0, episodes).mean()),
        "steps_per_second": float(dataset["steps"].sum()) / seconds,
        "seconds": seconds,
        "compile_seconds": float(dataset.attrs["compile_seconds"]),
        "seeds": int(dataset["return"].notnull().all("episode").sum()),
        "episodes": episodes,
    }


def table(rows: list[Row]) -> str:
    """The rows as text: mean return in each bin of episodes."""
    lines = []
    for panel, title in PANELS.items():
        chosen = [row for row in rows if row["panel"] in (panel, "both" if panel != "fails" else panel)]
        if not chosen:
            continue
        width = max(len(row["name"]) for row in chosen)
        heads = [f"-{b['to'] / 1000:g}k" for b in chosen[0]["bins"]]
        lines += ["", title]
        lines.append(
            f"{'episodes':{width}} {''.join(f'{h:>8}' for h in heads)}    all   ±95%  damage  cut off  Msteps/s"
        )
        for row in chosen:
            means = "".join(f"{b['mean']:8.1f}" for b in row["bins"])
            low, high = (np.nan if end is None else end for end in row["ci95"])
            half = (high - low) / 2
            lines.append(
                f"{row['name']:{width}} {means} {row['mean_return']:6.1f} {half:6.2f}  {row['damage_per_episode']:6.3f}"
                f"  {row['truncated_per_episode']:7.3f}  {row['steps_per_second'] / 1e6:8.1f}"
            )
    return "\n".join(lines).lstrip("\n")


def picture(results: list[tuple[Curve, xr.Dataset]], values: Row) -> Figure:
    """The two panels of Figure 4.2."""
    figure = Figure(figsize=(13, 5.8), layout="constrained")
    legend: dict[str, Artist] = {}
    references = {"optimum": values["optimal"]["mean"], "best epsilon-soft": values["epsilon_soft"]}
    for panel, ax in zip(("model", "random"), figure.subplots(1, 2, sharey=True), strict=True):
        shown = {curve.name: dataset for curve, dataset in results if panel in curve.panels}
        if shown:
            size = int(next(iter(shown.values()))["episode"].values[0])
            plots.learning_curves(shown, window=max(WINDOW, size), references=references, ax=ax)
        ax.set_title(f"{PANELS[panel]}, moving average over {WINDOW} episodes")
        ax.set_ylim(-130, -15)
        handles, labels = ax.get_legend_handles_labels()
        legend |= dict(zip(labels, handles, strict=True))
        if ax.get_legend():
            ax.get_legend().remove()
    figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=5, frameon=False)
    return figure
