"""What moves Model+HORDQ with the learned model: each detail that the thesis leaves open, changed alone; a table."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from hrljax.experiments import mario_ablation
from hrljax.train import check_count


@dataclass(frozen=True)
class Options:
    """Model+HORDQ on the thesis's level, with one change at a time to its search, its trees or the game.

    Writes summary.json: a list of rows as of scripts/table_4_1.py.
    """

    seeds: int = 4
    """Runs of each row."""
    episodes: int = 500
    """Episodes of each run."""
    only: tuple[str, ...] = ()
    """Names of the rows to run; all if not given."""
    pseudo_reward: float = 10.0
    """What following the root is worth."""
    out: Path = Path("runs/mario_ablation")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    for name in ("seeds", "episodes"):
        check_count(f"--{name}", getattr(options, name))
    check_count("--key", options.key, least=0)
    names = options.only or tuple(mario_ablation.CHANGES)
    mario_ablation.check_names(names)
    options.out.mkdir(parents=True, exist_ok=True)
    rows = mario_ablation.rows(
        names, options.seeds, options.episodes, options.pseudo_reward, cores=options.cores, key=options.key
    )
    found = []
    for row in rows:
        found.append(row)
        (options.out / "summary.json").write_text(json.dumps(found, indent=1) + "\n")
        print(f"{row['name']:30}{row['finished']['mean']:8.1f}{row['distance']['mean']:8.1f}", flush=True)
    print("\n" + mario_ablation.table(found))
    print(f"\nwritten to {options.out}")
    complete = len(found) == len(names) and found[-1]["seeds"] == options.seeds
    if not complete:
        print("interrupted: only what was finished is there", file=sys.stderr)
    return 0 if complete else 130


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(Options)))
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
