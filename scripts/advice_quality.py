"""How good a root has to be for its advice to speed learning up (thesis 5.3): a picture, a table and the numbers."""

import sys
from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401

from hrljax.core import checks
from hrljax.experiments import advice_quality, program


@dataclass(frozen=True)
class Options:
    """Bus under roots from a planner over a random one to a misleading one: what obeying them brings.

    Writes advice_quality.png and summary.json with "worth" (for each root: "quality" and "worth", the exact
    expected return of an episode whose subtasks obey strictly), "runs" (for each learner and root:
    "learner", "values", "pseudo_reward", "quality", "worth", "mean_return" per episode of the whole run, and
    "gain" over the same learner without a pseudo-reward, root for root and seed for seed, both with
    "mean", "lo", "hi"; "seeds") and "break_even" (for each learner: the worth of a root below which
    the gain is none, null if it is never lost).
    """

    seeds: int = 50
    """Runs of each learner under each root."""
    scale: float = 1.0
    """Factor of the number of episodes, 20,000."""
    out: Path = Path("runs/advice_quality")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    program.check_counts(options, "seeds")
    checks.number("--scale", options.scale, checks.Interval(0, 1000, low_open=True, high_open=True))
    options.out.mkdir(parents=True, exist_ok=True)
    worth = advice_quality.worths()
    runs: list[advice_quality.Runs] = []
    sweeps = advice_quality.run(advice_quality.QUALITIES, options.seeds, options.scale, options.cores, options.key)
    for group, dataset in program.until_interrupted(sweeps):
        learners = advice_quality.by_learner(group, dataset)
        runs += learners
        seconds = float(dataset.attrs["seconds"]) + float(dataset.attrs["compile_seconds"])
        names = ", ".join(of.name for of in learners)
        print(f"{names}: {seconds:.1f} s", file=sys.stderr, flush=True)
    rows = advice_quality.rows(runs, worth)
    program.write_summary(
        options.out,
        {
            "worth": [{"quality": quality, "worth": value} for quality, value in worth.items()],
            "runs": rows,
            "break_even": advice_quality.break_even(rows),
        },
    )
    if rows:
        advice_quality.picture(rows, worth).savefig(options.out / "advice_quality.png", dpi=110)
    print(advice_quality.table(rows, worth))
    return program.ended(options.out)


if __name__ == "__main__":
    program.run(main, Options)
