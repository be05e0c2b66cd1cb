"""Infinite Mario by agents that others have described: what they finish, beside this library's."""

import time
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import xarray as xr
from scipy import stats as distributions

from hrljax.experiments import mario_hybrid
from hrljax.experiments.mario_generalisation import PLAYED_FROM, LevelPlayer, LevelSet
from hrljax.experiments.rows import Row
from hrljax.learners.base import AnyLearner
from hrljax.learners.mario.a_star import MarioAStar
from hrljax.learners.mario.nearest_things import NearestThingsSARSA
from hrljax.learners.mario.sample import SampleAgent
from hrljax.learners.mario.three_options import ThreeOptions
from hrljax.sweeps.sweep import sweep

PLANNER = MarioAStar()
AGENTS: dict[str, AnyLearner] = {
    "sample agent, no memory": SampleAgent(has_memory=False),
    "sample agent": SampleAgent(),
    "nearest things": NearestThingsSARSA(),
    "three options": ThreeOptions(),
}
"""The competition's own agent, with and without its memory, and others as they have been described."""


def described_rows(
    names: Iterable[str], seeds: int, num_episodes: int, cores: int | None, key: int
) -> Iterator[tuple[Row, xr.Dataset]]:
    """The rows that Table 4.1 lacks: agents on the thesis's level, by its rewards and its clock, with their curves."""
    env = mario_hybrid.environment()
    for name in names:
        curves = sweep(
            env, AGENTS[name], seeds=seeds, num_episodes=num_episodes, bin_size=1, chunk_size=1, cores=cores, key=key
        )
        yield mario_hybrid.summary_row(name, curves), curves


def share_row(count: int, of: int) -> Row:
    """A share and Wilson's 95 % interval of it."""
    interval = distributions.binomtest(count, of).proportion_ci(method="wilson")
    return {"mean": count / of, "lo": float(interval.low), "hi": float(interval.high)}


def planned_rows(
    planner: MarioAStar, level_types: tuple[int, ...], difficulties: tuple[int, ...], each: int, cores: int | None
) -> Iterator[Row]:
    """A* on levels of every type and difficulty: a row for each, and the processor time of a step."""
    played = LevelSet(level_types, difficulties, each, PLAYED_FROM, actions="all")
    player = LevelPlayer(played.environment, planner, cores)
    untrained = player.untrained()
    player.play(untrained, [0])  # compiles
    for level_type in level_types:
        for difficulty in difficulties:
            numbers = [i for i, kind in enumerate(played.table) if kind[:2] == (level_type, difficulty)]
            begun = time.process_time()
            games = player.play(untrained, numbers)
            seconds = time.process_time() - begun
            lost = [played.table[number] for number, win in zip(numbers, games["win"], strict=True) if not win]
            yield {
                "level_type": level_type,
                "difficulty": difficulty,
                "finished": share_row(len(numbers) - len(lost), len(numbers)),
                "lost": lost,
                "length": float(games["length"].mean()),
                "distance": float(games["distance"].mean()),
                "milliseconds_a_step": 1e3 * seconds / float(games["length"].sum()),
                "levels": len(numbers),
            }


def planned_table(rows: Sequence[Row]) -> str:
    """Levels finished by A*, type by type and difficulty by difficulty, and all together."""
    lines = [f"{'type':>4}{'d':>4}{'levels':>9}{'finished':>10}{'steps':>8}{'ms a step':>11}"]
    for row in rows:
        count = round(row["finished"]["mean"] * row["levels"])
        lines.append(
            f"{row['level_type']:4}{row['difficulty']:4}{row['levels']:9}{count:10}{row['length']:8.0f}"
            f"{row['milliseconds_a_step']:11.2f}"
        )
    levels = sum(row["levels"] for row in rows)
    lost = [level for row in rows for level in row["lost"]]
    share = share_row(levels - len(lost), levels)
    steps = [row["length"] * row["levels"] for row in rows]
    mean_time = np.average([row["milliseconds_a_step"] for row in rows], weights=steps)
    lines.append(
        f"{levels - len(lost)} of {levels} finished, {100 * share['mean']:.1f} % "
        f"[{100 * share['lo']:.1f}, {100 * share['hi']:.1f}]; {mean_time:.2f} ms of a processor a step, of 208 ms"
    )
    if lost:
        lines.append("not finished (type, difficulty, seed): " + ", ".join(map(str, lost)))
    return "\n".join(lines)
