"""Step size x pseudo-reward x learner on Maze, Taxi and Bus over many seeds: pictures, a table and the numbers."""

import sys
from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401

from hrljax.core import checks
from hrljax.experiments import learning_rates, learning_rates_pictures, program
from hrljax.sweeps import io


@dataclass(frozen=True)
class Options:
    """How fast Q-learning, SARSA, MAXQ-Q and HORDQ learn on Maze, Taxi and Bus, for every step size and pseudo-reward.

    Writes heat_maps.png, sensitivity.png, intervals.png, learning_rates.csv (every setting), a Zarr store
    of every domain and learner, and summary.json with "exact" (for each domain: "optimal", "epsilon_soft"
    and "random", expected returns), "best" (for each domain and learner: its best "step_size" and
    "pseudo_reward"; "mean_return", "interquartile_mean" and "final_return" with "mean", "lo", "hi";
    "episodes_to_reach" half of the way from random to epsilon-soft, the median, null if half of the runs
    never do; the share of runs that "reached" it; "seeds", "steps_per_second", "seconds", "compile_seconds") and
    "comparisons" (HORDQ with each other learner, both at their best: "probability_of_improvement" and
    "paired_difference" of the mean return). The defaults take about five minutes on two cores, ten times as
    many seeds about ten times as long.
    """

    seeds: int = 500
    """Runs of each setting."""
    scale: float = 1.0
    """Factor of the number of episodes: 100 on Maze, 300 on Taxi and on Bus."""
    domains: tuple[str, ...] = ("Maze", "Taxi", "Bus")
    """Which domains."""
    step_sizes: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
    """Step sizes of every learner."""
    pseudo_rewards: tuple[float, ...] = (0.0, 1.0, 5.0, 20.0, 60.0)
    """Pseudo-rewards of the hierarchical learners."""
    out: Path = Path("runs/learning_rates")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    known = {domain.name: domain for domain in learning_rates.domains()}
    check(options, tuple(known))
    options.out.mkdir(parents=True, exist_ok=True)
    exact = {name: learning_rates.exact(known[name]) for name in options.domains}
    results: learning_rates_pictures.Results = {}
    rows, best = [], []
    settings = (options.step_sizes, options.pseudo_rewards, options.seeds, options.scale, options.cores, options.key)
    runs = ((name, *of) for name in options.domains for of in learning_rates.run(known[name], exact[name], *settings))
    for name, learner, dataset in program.until_interrupted(runs):
        io.save(dataset, options.out / "stores" / f"{name}-{learner}.zarr")
        results.setdefault(name, {})[learner] = dataset
        rows += learning_rates.setting_rows(name, learner, dataset)
        best.append(learning_rates.best_row(name, learner, dataset))
        seconds = best[-1]["seconds"] + best[-1]["compile_seconds"]
        print(f"{name}: {learner:12} {seconds:6.1f} s", file=sys.stderr, flush=True)
    comparisons = [row for name, of in results.items() for row in learning_rates.comparisons(name, of)]
    summary = {"exact": exact, "best": best, "comparisons": comparisons}
    program.write_summary(options.out, summary)
    (options.out / "learning_rates.csv").write_text(learning_rates.csv(rows))
    for name, figure in learning_rates_pictures.pictures(results, exact).items():
        figure.savefig(options.out / f"{name}.png", dpi=110)
    print(learning_rates.table(best, comparisons))
    return program.ended(options.out)


def check(options: Options, known: tuple[str, ...]) -> None:
    """Raises ValueError for an option that makes no sense."""
    program.check_counts(options, "seeds")
    checks.number("--scale", options.scale, checks.Interval(0, 1000, low_open=True, high_open=True))
    for name, values in (
        ("--domains", options.domains),
        ("--step-sizes", options.step_sizes),
        ("--pseudo-rewards", options.pseudo_rewards),
    ):
        if not values or len(set(values)) < len(values):
            raise ValueError(f"{name} must be at least one and different, got {' '.join(map(str, values)) or 'none'}")
    for name in options.domains:
        if name not in known:
            raise ValueError(f"--domains must be among {', '.join(known)}, got {name!r}")
    for value in options.step_sizes:
        checks.number("--step-sizes", value, checks.Interval(0, 1, low_open=True))
    for value in options.pseudo_rewards:
        checks.number("--pseudo-rewards", value)


if __name__ == "__main__":
    program.run(main, Options)
