"""Which reading of the thesis's search brings Mario to the exit when the model is exact: a table."""

from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401

from hrljax.core import checks
from hrljax.experiments import mario_search, program


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
    program.check_counts(options)
    for nodes in options.more_nodes:
        checks.integer("--more-nodes", nodes, 1)
    options.out.mkdir(parents=True, exist_ok=True)
    done = []
    print(mario_search.table_head(), flush=True)
    rows = mario_search.rows(mario_search.settings(options.more_nodes), cores=options.cores)
    for of_sweep in program.until_interrupted(rows):
        done += of_sweep
        print(*map(mario_search.table_line, of_sweep), sep="\n", flush=True)
        program.write_summary(options.out, done)
    return program.ended(options.out)


if __name__ == "__main__":
    program.run(main, Options)
