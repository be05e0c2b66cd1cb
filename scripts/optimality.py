"""Optimal, hierarchically and recursively optimal policies, and what learners reach: tables and pictures."""

import sys
from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401

from hrljax.core import checks
from hrljax.experiments import optimality, program
from hrljax.experiments.rows import curves_csv


@dataclass(frozen=True)
class Options:
    """Maze, stochastic Taxi and Bus: three kinds of optimality (exact), and what each learner reached.

    Writes maze.png (the thesis's Figure 2.1), taxi.png (learning curves), task_graph.png (Taxi before and
    after its leaf cover is made total), optimality.csv and summary.json with "exact" (for each domain:
    "optimal", "hierarchically_optimal", "recursively_optimal", "pseudo_reward", "inaccessible", "added")
    and "reached" (for each domain and learner: "online" and "greedy" with "mean", "lo", "hi";
    "steps_per_second", "seconds", "seeds", "episodes").
    """

    seeds: int = 200
    """Runs of each learner."""
    scale: float = 1.0
    """Factor of the number of episodes: 2,000 on Maze, 65,536 on Taxi, 20,000 on Bus."""
    domains: tuple[str, ...] = ("Maze", "Taxi", "Bus")
    """Which domains."""
    out: Path = Path("runs/optimality")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    program.check_counts(options, "seeds")
    checks.number("--scale", options.scale, checks.Interval(0, 1000, low_open=True, high_open=True))
    known = {domain.name: domain for domain in optimality.domains()}
    for name in options.domains:
        if name not in known:
            raise ValueError(f"--domains must be among {', '.join(known)}, got {name!r}")
    options.out.mkdir(parents=True, exist_ok=True)
    exact_rows, rows, curves = [], [], []
    exact = ((known[name], optimality.exact(known[name])) for name in options.domains)
    for domain, optima in program.until_interrupted(exact):
        exact_rows.append(optimality.exact_row(domain, optima))
        if domain.name == "Maze":
            optimality.maze_picture(optima).savefig(options.out / "maze.png", dpi=110)
        finished = {}
        runs = optimality.run(domain, options.seeds, options.scale, options.cores, options.key)
        for name, dataset in program.until_interrupted(runs):
            finished[name] = dataset
            curves.append((domain.name, name, dataset))
            rows.append(optimality.summary_row(domain, name, dataset))
            print(f"{domain.name}: {name:26} {rows[-1]['seconds']:6.1f} s", file=sys.stderr, flush=True)
        if domain.name == "Taxi" and finished:
            optimality.taxi_picture(finished, optima.optimal.mean).savefig(options.out / "taxi.png", dpi=110)
    optimality.graph_picture().savefig(options.out / "task_graph.png", dpi=110)
    program.write_summary(options.out, {"exact": exact_rows, "reached": rows})
    (options.out / "optimality.csv").write_text(curves_csv(curves))
    print(optimality.table(exact_rows, rows))
    return program.ended(options.out)


if __name__ == "__main__":
    program.run(main, Options)
