"""Trains Mario on some levels and plays others, of every type and many difficulties: a table and a picture."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import interruptible  # noqa: F401

from hrljax.core import checks
from hrljax.experiments import mario_generalisation, program


@dataclass(frozen=True)
class Options:
    """A hybrid, trained on sets of levels, plays levels that it has not seen (types 0-2, difficulties 0-5).

    Writes generalisation.png and summary.json: a list of "trained_on", "level_type", "difficulty",
    "finished" (a fraction) with "mean", "lo", "hi", "distance" (tiles), "return", "length" (steps),
    "levels", "seeds".
    """

    learns: Literal["values", "encounters"] = "encounters"
    """What is learned: values of things, as in the thesis, or what it is to meet them."""
    trained_on: tuple[str, ...] = tuple(mario_generalisation.TRAINED_ON)
    """Names of the sets of levels."""
    seeds: int = 4
    """Runs of training for each set."""
    episodes: int = 1000
    """Episodes of each run."""
    levels: int = 10
    """Levels that are played, of each type and difficulty."""
    out: Path = Path("runs/mario_generalisation")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    program.check_counts(options, "seeds", "episodes", "levels")
    for name in options.trained_on:
        checks.choice("--trained-on", name, tuple(mario_generalisation.TRAINED_ON))
    options.out.mkdir(parents=True, exist_ok=True)
    played = mario_generalisation.LevelSet(
        mario_generalisation.LEVEL_TYPES,
        mario_generalisation.DIFFICULTIES,
        options.levels,
        mario_generalisation.PLAYED_FROM,
    )
    rows: list[dict[str, Any]] = []
    sets = mario_generalisation.rows(
        options.trained_on,
        played,
        mario_generalisation.LEARNERS[options.learns],
        options.seeds,
        options.episodes,
        options.cores,
        options.key,
        report=lambda name: print(f"trained on {name} ...", flush=True),
    )
    for of_set in program.until_interrupted(sets):
        rows += of_set
        program.write_summary(options.out, rows)
    if rows:
        print(mario_generalisation.table(rows))
        print("\n" + mario_generalisation.table(rows, "distance"))
        mario_generalisation.picture(rows).savefig(options.out / "generalisation.png", dpi=110)
    return program.ended(options.out)


if __name__ == "__main__":
    program.run(main, Options)
