"""All learners side by side on Maze, four rooms, Taxi and Bus: sample efficiency against compute."""

import sys
from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401

from hrljax.core import checks
from hrljax.experiments import neighbour_learners, neighbours, program


@dataclass(frozen=True)
class Options:
    """How many steps every learner needs, what it loses on the way, and what it costs.

    Writes neighbours.png (regret against seconds; empty marks never reach 95 %), neighbours.md (the table) and
    summary.json with "exact" (for each domain: "optimal" and "random", expected returns, and the "threshold" at 95 %
    of the way between them) and "rows" (for each domain and learner: "steps_to_reach" the threshold with an average
    over 10 of 200 bins, the "median" with "lo" and "hi", null for never; the share of runs that "reached" it; "regret",
    the sum over episodes of what the optimum earns more, with "mean", "lo" and "hi"; "final_return" of the last
    eighth; "seconds" of a processor for a run, without compilation; "microseconds_per_step"; "memory" of what a run
    has learned, in bytes; "seeds" and "episodes"). Settings are usual ones, not tuned. The defaults take about 30
    minutes of a processor, of which RL-DT and SPITI on the stochastic Taxi take 9, KWIK-R-MAX on the Bus 8 and
    compilation 4.
    """

    seeds: int = 16
    """Runs of each learner."""
    scale: float = 1.0
    """Factor of the number of episodes: 200 on Maze, 300 in four rooms, 1500 and 3000 on Taxi, 6000 on Bus."""
    domains: tuple[str, ...] = tuple(neighbour_learners.domains())
    """Which domains."""
    learners: tuple[str, ...] = tuple(neighbour_learners.LEARNERS)
    """Which learners."""
    out: Path = Path("runs/neighbours")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    check(options)
    options.out.mkdir(parents=True, exist_ok=True)
    known = neighbour_learners.domains()
    exact = {name: neighbours.Exact(known[name]) for name in options.domains}
    settings = (options.learners, options.seeds, options.scale, options.cores, options.key)
    runs = (result for name in options.domains for result in neighbours.run(known[name], exact[name], *settings))
    rows: list[neighbours.Row] = []
    for row, _ in program.until_interrupted(runs):
        rows.append(row)
        spent = row["seconds"] * row["seeds"]
        print(f"{row['domain']}: {row['learner']:26} {spent:8.1f} s", file=sys.stderr, flush=True)
    program.write_summary(options.out, {"exact": {name: vars(of) for name, of in exact.items()}, "rows": rows})
    (options.out / "neighbours.md").write_text(neighbours.table(rows) + "\n")
    if rows:
        neighbours.picture(rows).savefig(options.out / "neighbours.png", dpi=110)
    print(neighbours.table(rows))
    return program.ended(options.out)


def check(options: Options) -> None:
    """Raises ValueError for an option that makes no sense."""
    program.check_counts(options, "seeds")
    checks.number("--scale", options.scale, checks.Interval(0, 1000, low_open=True, high_open=True))
    for name, values, known in (
        ("--domains", options.domains, neighbour_learners.domains()),
        ("--learners", options.learners, neighbour_learners.LEARNERS),
    ):
        if not values or len(set(values)) < len(values):
            raise ValueError(f"{name} must be at least one and different, got {' '.join(values) or 'none'}")
        for value in values:
            checks.choice(name, value, tuple(known))


if __name__ == "__main__":
    program.run(main, Options)
