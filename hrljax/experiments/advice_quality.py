"""How good a root has to be for its advice to speed learning up (thesis 5.3): Bus under roots of graded quality."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import SymmetricalLogLocator

from hrljax import stats
from hrljax.envs.bus.env import Bus
from hrljax.experiments import graded_root
from hrljax.experiments.graded_root import GradedRoot
from hrljax.experiments.rows import Row, interval_row
from hrljax.learners.base import AnyLearner
from hrljax.learners.fading import Fading
from hrljax.learners.hordq import HORDQ
from hrljax.learners.shared import SharedHORDQ
from hrljax.plots import style
from hrljax.sweeps.sweep import sweep

QUALITIES = (1.0, 0.75, 0.5, 0.25, 0.0, -0.25, -0.5, -0.75)
"""Of the roots, from a planner to what is nearly an adversary."""
EPISODES = 20_000

_FADING = "fading"
_INITIAL_VALUE = -25.0


@dataclass(frozen=True)
class Group:
    """Learners that one sweep trains: they differ in the pseudo-reward only, or it fades and is one learner.

    Attributes:
        values: what learners are named by, and what a gain is counted from: those with the same `values`.
        learner: with the root that is swept.
        pseudo_rewards: of the sweep; none if the learner's fades.
    """

    values: str
    learner: AnyLearner
    pseudo_rewards: tuple[float, ...] = ()


def groups() -> list[Group]:
    """Values of every subtask for itself, and shared ones. Without a pseudo-reward the latter are flat Q-learning."""
    hierarchy, root = Bus().hierarchy(), GradedRoot()
    return [
        Group("HORDQ", HORDQ(hierarchy, root, initial_value=_INITIAL_VALUE), (0.0, 5.0)),
        Group(
            "shared HORDQ",
            SharedHORDQ(hierarchy, root, pseudo_reward=0.0, initial_value=_INITIAL_VALUE),
            (0.0, 2.0, 5.0),
        ),
        Group("shared HORDQ", SharedHORDQ(hierarchy, root, pseudo_reward=Fading(), initial_value=_INITIAL_VALUE)),
    ]


def worths(qualities: Sequence[float] = QUALITIES) -> dict[float, float]:
    """Expected return of an episode whose subtasks obey strictly, by the quality of the root; exact."""
    env = Bus()
    return {quality: graded_root.worth(env.hierarchy(), env, quality) for quality in qualities}


def run(
    qualities: Sequence[float], seeds: int, scale: float, cores: int | None, key: int
) -> Iterator[tuple[Group, xr.Dataset]]:
    """Runs one group of learners after the other.

    Args:
        qualities: of the roots, different numbers in [-1, 1].
        seeds: runs of every learner under every root.
        scale: factor of the number of episodes.
        cores: cores to use, all if None.
        key: seed of all random numbers.

    Returns:
        Groups with the dataset of their sweep. After a keyboard interrupt ``complete`` is 0 among its
        attributes, and nothing follows.
    """
    for group in groups():
        further = {"pseudo_reward": group.pseudo_rewards} if group.pseudo_rewards else {}
        dataset = sweep(
            Bus(),
            group.learner,
            seeds=seeds,
            num_episodes=max(1, round(EPISODES * scale)),
            axes={"root.quality": qualities, **further},
            cores=cores,
            key=key,
        )
        yield group, dataset
        if not dataset.attrs["complete"]:
            return


@dataclass(frozen=True)
class Runs:
    """Mean returns of the whole runs of one learner, ``[root.quality, seed]``."""

    values: str
    pseudo_reward: float | str
    mean_return: xr.DataArray

    @property
    def name(self) -> str:
        told = self.pseudo_reward if isinstance(self.pseudo_reward, str) else f"{self.pseudo_reward:g}"
        return f"{self.values}({told})"


def by_learner(group: Group, dataset: xr.Dataset) -> list[Runs]:
    """The mean returns of a group's learners, one after the other."""
    means = stats.episode_range(dataset["return"], 0, int(dataset["episode"].values[-1]))
    means.attrs = {"long_name": "return per episode", "units": "reward"}
    if not group.pseudo_rewards:
        return [Runs(group.values, _FADING, means)]
    return [Runs(group.values, kappa, means.sel(pseudo_reward=kappa, drop=True)) for kappa in group.pseudo_rewards]


def gains(runs: Sequence[Runs]) -> dict[str, xr.DataArray]:
    """What advice has brought, by learner: mean returns less those of the same learner without a pseudo-reward.

    Pairs have the same root and the same seed.
    """
    unadvised = {of.values: of.mean_return for of in runs if of.pseudo_reward == 0}
    return {of.name: stats.paired_differences(of.mean_return, unadvised[of.values]) for of in runs}


def rows(runs: Sequence[Runs], worth: Mapping[float, float]) -> list[Row]:
    """For ``summary.json`` and the table: an entry for every learner and quality of the root."""
    gained = gains(runs)
    return [
        {
            "learner": of.name,
            "values": of.values,
            "pseudo_reward": of.pseudo_reward,
            "quality": quality,
            "worth": worth[quality],
            "mean_return": interval_row(stats.mean_interval(of.mean_return.sel({"root.quality": quality}))),
            "gain": interval_row(stats.mean_interval(gained[of.name].sel({"root.quality": quality}))),
            "seeds": int(of.mean_return.sel({"root.quality": quality}).notnull().sum()),
        }
        for of in runs
        for quality in map(float, of.mean_return["root.quality"].values)
    ]


def break_even(entries: Sequence[Row]) -> dict[str, float | None]:
    """The worth of a root below which advice costs more than it brings, by learner with a pseudo-reward.

    Where the line through the measured gains first falls to 0 on the way from the best root down; None
    where it does not.
    """
    names = dict.fromkeys(row["learner"] for row in entries if row["pseudo_reward"] != 0)
    return {name: _first_fall([row for row in entries if row["learner"] == name]) for name in names}


def _first_fall(entries: Sequence[Row]) -> float | None:
    finished = [row for row in entries if row["gain"]["mean"] is not None]
    points = sorted(((row["worth"], row["gain"]["mean"]) for row in finished), reverse=True)
    for (better, gain), (worse, next_gain) in zip(points, points[1:], strict=False):
        if gain > 0 >= next_gain:
            return better + (worse - better) * gain / (gain - next_gain)
    return None


def table(entries: Sequence[Row], worth: Mapping[float, float]) -> str:
    """Mean returns and gains as text, a column for every quality."""
    names = list(dict.fromkeys(row["learner"] for row in entries))
    width = max([len("worth of the root"), *map(len, names)])
    by_place = {(row["learner"], row["quality"]): row for row in entries}

    def line(head: str, cells: Iterator[str]) -> str:
        return f"{head:{width}}" + "".join(f"{cell:>14}" for cell in cells)

    def number(value: float | None, form: str = ".2f") -> str:
        return "" if value is None else format(value, form)

    def gain(row: Row) -> str:
        low, middle, high = (row["gain"][end] for end in ("lo", "mean", "hi"))
        half = "" if low is None else f" ±{(high - low) / 2:.2f}"
        return number(middle, "+.2f") + half

    lines = [
        line("quality", (f"{quality:g}" for quality in worth)),
        line("worth of the root", map(number, worth.values())),
    ]
    lines += ["", "mean return of the whole run"]
    lines += [line(name, (number(by_place[name, q]["mean_return"]["mean"]) for q in worth)) for name in names]
    lines += ["", "gain over no pseudo-reward, 95 %"]
    advised = break_even(entries)
    lines += [line(name, (gain(by_place[name, q]) for q in worth)) for name in advised]
    lines += ["", "advice pays from a root on that is worth"]
    for name, at in advised.items():
        means = [row["gain"]["mean"] for row in entries if row["learner"] == name and row["gain"]["mean"] is not None]
        throughout = "pays everywhere" if means and max(means) > 0 else "pays nowhere"
        lines.append(f"{name:{width}}{throughout if at is None else format(at, '.1f'):>16}")
    return "\n".join(text.rstrip() for text in lines)


def picture(entries: Sequence[Row], worth: Mapping[float, float]) -> Figure:
    """Gain against the worth of the root; the root's quality is above. Axes are logarithmic, but for gains up to 10."""
    figure = Figure(figsize=(9.5, 5.8), layout="constrained")
    ax: Axes = figure.subplots()
    markers, lines = style.markers(), style.lines()
    for name in break_even(entries):
        points = [row for row in entries if row["learner"] == name and row["gain"]["mean"] is not None]
        places, gained = [row["worth"] for row in points], np.array([row["gain"]["mean"] for row in points])
        ends = np.array(
            [[np.nan if row["gain"][end] is None else row["gain"][end] for row in points] for end in ("lo", "hi")]
        )
        reach = [[-1], [1]] * (ends - gained) if points else None
        count = max((row["seeds"] for row in points), default=0)
        ax.errorbar(
            places, gained, reach, **next(lines), marker=next(markers), ms=5, capsize=3, label=f"{name} (n={count})"
        )
    ax.axhline(0, color="#444444", ls="--", lw=1)
    ax.set_xscale("symlog", linthresh=10)
    ax.set_yscale("symlog", linthresh=10)
    ax.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=10, subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter("{x:g}")
    _mark_worths(ax, worth)
    ax.set_xlabel("worth of the root: exact return of an episode if its advice is obeyed strictly (reward)")
    ax.set_ylabel("gain over no pseudo-reward,\nmean return of the whole run (reward)")
    style.tidy(ax)
    return figure


def _mark_worths(ax: Axes, worth: Mapping[float, float]) -> None:
    """Ticks at the roots, with their worth below and their quality above."""
    places = list(worth.values())
    ax.set_xlim(min(places) * 1.1, max(places) * 0.95)
    ax.minorticks_off()
    ax.set_xticks(places, [f"{place:.1f}" for place in places], rotation=60)
    for quality, place in worth.items():
        ax.text(place, 1.01, f"{quality:g}", rotation=60, ha="center", va="bottom", transform=ax.get_xaxis_transform())
    ax.set_title("quality of the root: 1 a planner, 0 random, below 0 misleading", fontsize="medium", pad=34)
