"""Infinite Mario by agents that others have described, and by A* on the game itself."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401

from hrljax.core import checks
from hrljax.experiments import mario_agents, mario_hybrid, program
from hrljax.experiments.mario_generalisation import LEVEL_TYPES
from hrljax.experiments.rows import Row


@dataclass(frozen=True)
class Options:
    """The rows that the thesis's Table 4.1 lacks, and A* on levels of types 0 to 2, each played once.

    Writes summary.json: "described", a list as of table_4_1.py, and "planned", a list of "level_type",
    "difficulty", "finished" (a fraction, with "mean", "lo", "hi"), "lost" (type, difficulty and seed), "length"
    (steps), "distance" (tiles), "milliseconds_a_step" (of a processor), "levels".
    """

    seeds: int = 10
    """Runs of each agent on the thesis's level."""
    episodes: int = 1000
    """Episodes of each run."""
    agents: tuple[str, ...] = tuple(mario_agents.AGENTS)
    """Which of the agents."""
    planned: bool = True
    """Whether A* plays levels."""
    levels: int = 17
    """Levels of each type and difficulty that A* plays."""
    difficulties: tuple[int, ...] = (0, 1, 2, 3)
    """Of these levels."""
    out: Path = Path("runs/mario_agents")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    program.check_counts(options, "seeds", "episodes", "levels")
    for name in options.agents:
        checks.choice("--agents", name, tuple(mario_agents.AGENTS))
    options.out.mkdir(parents=True, exist_ok=True)
    described, planned = [], []
    for kind, row in program.until_interrupted(_rows(options)):
        (described if kind == "described" else planned).append(row)
        program.write_summary(options.out, {"described": described, "planned": planned})
    if described:
        print(mario_hybrid.table(described))
    if planned:
        print("\n" + mario_agents.planned_table(planned))
    return program.ended(options.out)


def _rows(options: Options) -> Iterator[tuple[str, Row]]:
    described = mario_agents.described_rows(options.agents, options.seeds, options.episodes, options.cores, options.key)
    for row, _ in described:
        yield "described", row
    if not options.planned:
        return
    planner, cores = mario_agents.PLANNER, options.cores
    for row in mario_agents.planned_rows(planner, LEVEL_TYPES, options.difficulties, options.levels, cores):
        yield "planned", row


if __name__ == "__main__":
    program.run(main, Options)
