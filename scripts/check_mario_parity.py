"""Compares the Mario engine with recordings of the original program, bit by bit."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401

from hrljax.envs.mario import recordings
from hrljax.envs.mario.engine.quantum import check_quantum
from hrljax.experiments import program
from hrljax.experiments.mario_fidelity import drift, parity


@dataclass(frozen=True)
class Options:
    """Compares the Mario engine with recordings of the original program, bit by bit.

    Prints for every file how many levels, ticks or steps are identical, and the first difference in
    words. Exit status 0: everything is identical.
    """

    levels: tuple[Path, ...] = ()
    """Files of recorded levels."""
    trajectories: tuple[Path, ...] = ()
    """Files of games recorded tick by tick."""
    rl_steps: tuple[Path, ...] = ()
    """Files of games recorded step by step of the competition."""
    quantum: tuple[int, ...] = ()
    """Also prints how far games on lattices of 1 / quantum pixels stray from those of --trajectories."""


def report(unit: str, check: Callable[[Path], Iterator[parity.Verdict]], path: Path) -> bool:
    """Checks one file; True if all of it is identical."""
    identical = total = 0
    first = ""
    for number, verdict in enumerate(check(path), 1):
        identical, total = identical + verdict.identical, total + verdict.total
        first = first or verdict.first_difference
        if sys.stderr.isatty():
            print(f"\r{path.name}: {number} cases", end="", file=sys.stderr, flush=True)
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    print(f"{path}: {unit} {identical}/{total}", flush=True)
    if first:
        print(f"    first difference: {first}", flush=True)
    return identical == total and not first


def main(options: Options) -> int:
    if not (options.levels or options.trajectories or options.rl_steps):
        raise ValueError("nothing to compare: give files with --levels, --trajectories or --rl-steps")
    if options.quantum and not options.trajectories:
        raise ValueError("--quantum plays recorded games: give files with --trajectories")
    for quantum in options.quantum:
        check_quantum(quantum)
    checks = [("levels", parity.check_levels, options.levels)]
    checks += [("ticks", parity.check_trajectories, options.trajectories)]
    checks += [("steps", parity.check_episodes, options.rl_steps)]
    reports = (report(unit, check, path) for unit, check, paths in checks for path in paths)
    same = list(program.until_interrupted(reports))
    for path in options.trajectories if options.quantum else ():
        games = recordings.read_trajectories(path)
        rows = program.until_interrupted(drift.drift(games, quantum) for quantum in options.quantum)
        print(f"{path}: games on a lattice of 1 / quantum pixels against the recordings")
        print(drift.table(rows))
    return program.ended(status=0 if all(same) else 1)


if __name__ == "__main__":
    program.run(main, Options)
