"""What moves Model+HORDQ with the learned model: each detail that the thesis leaves open, changed alone; a table."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import interruptible  # noqa: F401

from hrljax.experiments import mario_ablation, program


@dataclass(frozen=True)
class Options:
    """Model+HORDQ on the thesis's level, with one change at a time to its search, its trees, its values or the game.

    Writes summary.json: a list of rows as of scripts/table_4_1.py.
    """

    of: Literal["thesis", "best"] = "thesis"
    """What is changed: the thesis's design, or the best configuration that was found with a learned model."""
    seeds: int = 4
    """Runs of each row."""
    episodes: int = 500
    """Episodes of each run."""
    only: tuple[str, ...] = ()
    """Names of the rows to run; all if not given."""
    pseudo_reward: float = 10.0
    """What following the root is worth in the thesis's design."""
    out: Path = Path("runs/mario_ablation")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    program.check_counts(options, "seeds", "episodes")
    names = options.only or mario_ablation.names_of(options.of)
    mario_ablation.check_names(names, options.of)
    options.out.mkdir(parents=True, exist_ok=True)
    details = mario_ablation.rows(
        names, options.seeds, options.episodes, options.pseudo_reward, options.of, cores=options.cores, key=options.key
    )
    rows = []
    for row in program.until_interrupted(details):
        rows.append(row)
        program.write_summary(options.out, rows)
        print(f"{row['name']:30}{row['finished']['mean']:8.1f}{row['distance']['mean']:8.1f}", flush=True)
    if rows:
        print("\n" + mario_ablation.table(rows))
    return program.ended(options.out)


if __name__ == "__main__":
    program.run(main, Options)
