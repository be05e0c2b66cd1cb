"""Which reading of the thesis's search brings Mario to the exit when the model is exact: a table."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from hrljax.experiments import mario_search
from hrljax.train import check_count


@dataclass(frozen=True)
class Options:
    """The search of thesis 4.2.3 under an exact model, on the thesis's level without monsters.

    One game for each order of the frontier, kind of answer, way to count nodes and reward at which the
    search stops. Writes summary.json: a list of "priority", "answer", "count", "max_nodes",
    "stop_reward", "win", "distance" (tiles), "length" (steps).
    """

    more_nodes: tuple[int, ...] = (1000, 3000)
    """Numbers of nodes beyond the thesis's 300, tried with the default reading."""
    out: Path = Path("runs/mario_search")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""


def main(options: Options) -> int:
    for nodes in options.more_nodes:
        check_count("--more-nodes", nodes)
    options.out.mkdir(parents=True, exist_ok=True)
    done = []
    print(mario_search.table_head(), flush=True)
    for row in mario_search.rows(mario_search.settings(options.more_nodes), cores=options.cores):
        done.append(row)
        print(mario_search.table_line(row), flush=True)
        (options.out / "summary.json").write_text(json.dumps(done, indent=1) + "\n")
    print(f"\nwritten to {options.out}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(Options)))
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
