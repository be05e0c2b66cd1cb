"""Infinite Mario by agents that others have described, and by A* on the game itself."""

from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401

from hrljax.experiments import mario_agents, program
from hrljax.experiments.mario_generalisation import LEVEL_TYPES


@dataclass(frozen=True)
class Options:
    """A* on levels of types 0 to 2, each of its own seed, played once.

    Writes summary.json: "planned", a list of "level_type", "difficulty", "finished" (a fraction, with "mean", "lo",
    "hi"), "lost" (type, difficulty and seed), "length" (steps), "distance" (tiles), "milliseconds_a_step" (of a
    processor), "levels".
    """

    levels: int = 17
    """Levels of each type and difficulty that A* plays."""
    difficulties: tuple[int, ...] = (0, 1, 2, 3)
    """Of these levels."""
    out: Path = Path("runs/mario_agents")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""


def main(options: Options) -> int:
    program.check_counts(options, "levels")
    options.out.mkdir(parents=True, exist_ok=True)
    planned = mario_agents.planned_rows(
        mario_agents.PLANNER, LEVEL_TYPES, options.difficulties, options.levels, options.cores
    )
    rows = []
    for row in program.until_interrupted(planned):
        rows.append(row)
        program.write_summary(options.out, {"planned": rows})
    if rows:
        print(mario_agents.planned_table(rows))
    return program.ended(options.out)


if __name__ == "__main__":
    program.run(main, Options)
