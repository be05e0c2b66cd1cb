"""Which pseudo-reward? All fixed ones, annealed, and fading, on nine domains under good and bad roots."""

import sys
from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401
import xarray as xr

from hrljax.core import checks
from hrljax.experiments import program, pseudo_reward
from hrljax.experiments.rows import Row


@dataclass(frozen=True)
class Options:
    """What a pseudo-reward costs or earns: fixed at 0 to 60, annealed, or fading by itself.

    Three Bus domains, Maze, stochastic Taxi and four random processes with random hierarchies, under roots that
    plan, learn, guess and mislead; beside Q-learning, SARSA and MAXQ-Q. Writes pseudo_reward.png (how far each
    rule is from the best in hindsight) and summary.json: for every domain, root and rule "whole" and
    "last_tenth", the mean return with its 95 % interval ("mean", "lo", "hi"); "best_whole" and
    "best_last_tenth", the best of Q-learning and all fixed pseudo-rewards in hindsight; "regret_whole" and
    "regret_last_tenth", how much less was earned than by that, paired by seed, and the same as
    "percent_whole" and "percent_last_tenth" of the best's size. The defaults take about half an hour on two cores.
    """

    seeds: int = 20
    """Runs of each rule."""
    scale: float = 1.0
    """Factor of the number of episodes."""
    domains: tuple[str, ...] = ()
    """Which domains, such as Bus Taxi 'Random 0'; all if none is given."""
    out: Path = Path("runs/pseudo_reward")
    """Folder for what is written."""
    cores: int | None = None
    """Cores to use; all if not given."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    cases = chosen(options)
    options.out.mkdir(parents=True, exist_ok=True)
    returns: dict[str, dict[str, xr.DataArray]] = {}
    settings = (options.seeds, options.scale, options.cores, options.key)
    runs = ((case, *of) for case in cases for of in pseudo_reward.run(case, *settings))
    for case, learner, dataset in program.until_interrupted(runs):
        returns.setdefault(case.name, {}).update(pseudo_reward.by_rule(learner, dataset))
        seconds = dataset.attrs["seconds"] + dataset.attrs["compile_seconds"]
        print(f"{case.name}: {learner:28} {seconds:6.1f} s", file=sys.stderr, flush=True)
    rows: list[Row] = []
    for case in cases:
        if case.name in returns:
            rows += pseudo_reward.rows(case, returns[case.name])
    program.write_summary(options.out, rows)
    if rows:
        pseudo_reward.picture(rows).savefig(options.out / "pseudo_reward.png", dpi=110)
        print(pseudo_reward.table(rows))
    return program.ended(options.out)


def chosen(options: Options) -> list[pseudo_reward.Case]:
    """The cases of the domains that are asked for; raises ValueError for an option that makes no sense."""
    program.check_counts(options, "seeds")
    checks.number("--scale", options.scale, checks.Interval(0, 1000, low_open=True, high_open=True))
    cases = pseudo_reward.cases()
    known = list(dict.fromkeys(case.domain for case in cases))
    for name in options.domains:
        if name not in known:
            raise ValueError(f"--domains must be among {', '.join(map(repr, known))}, got {name!r}")
    return [case for case in cases if not options.domains or case.domain in options.domains]


if __name__ == "__main__":
    program.run(main, Options)
