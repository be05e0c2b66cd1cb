"""What the programs in scripts/ and benchmarks/ share: checks of their options, what they write, how they end."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn, TypeVar

import tyro

from hrljax.core import checks
from hrljax.experiments.interruption import Interruption, Result, leave

Options = TypeVar("Options")

NO_RESULT = "interrupted: no result was finished"

_interruption = Interruption()


def run(main: Callable[[Options], int], options: type[Options]) -> NoReturn:
    """Ends the process with the status of `main`, called with options from the command line.

    An error of the user's ends it with a message instead of a traceback, and so does an interrupt before
    `until_interrupted`, with status 130, or 143 after SIGTERM. A second interrupt ends it at once.
    """
    global _interruption
    interruption = _interruption = Interruption()
    with interruption.handled():
        try:
            status: int | str = main(tyro.cli(options))
        except BaseException as error:
            cut_short = interruption.signal and interruption.raises
            interruption.raises = False
            if isinstance(error, KeyboardInterrupt) or cut_short:
                print(NO_RESULT, file=sys.stderr)
                status = interruption.status or 130
            elif isinstance(error, ValueError | OSError):
                status = f"error: {error}"
            else:
                raise
        if interruption.came_from_outside:
            leave(status) if isinstance(status, int) else leave(1, status)
        sys.exit(status)


def until_interrupted(results: Iterable[Result]) -> Iterator[Result]:
    """Results of a program, one by one, up to an interrupt.

    An interrupt cuts short how a result comes about, and a sweep then gives the runs that are finished;
    what the caller does with a result, and afterwards with all of them, is done to its end. `ended` then
    says what there is.
    """
    return _interruption.until(results)


def require(extra: str, *packages: str) -> None:
    """Ends the process with a sentence and status 2 unless some packages of an extra are installed."""
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        command = f"pip install -e '.[{extra}]'"
        print(f"error: this program needs {' and '.join(missing)}: {command} installs what is missing", file=sys.stderr)
        sys.exit(2)


def check_counts(options: object, *names: str) -> None:
    """Checks options that are counts, and ``key`` and ``cores`` where there are such.

    Raises:
        TypeError, ValueError: one is no integer from 1 (from 0 for ``key``; ``cores`` may be None) to 2**31 - 1.
    """
    least = dict.fromkeys(names, 1)
    if hasattr(options, "key"):
        least["key"] = 0
    if getattr(options, "cores", None) is not None:
        least["cores"] = 1
    for name, smallest in least.items():
        checks.integer(f"--{name.replace('_', '-')}", getattr(options, name), smallest)


def write_summary(out: Path, summary: object) -> None:
    """Writes ``summary.json``."""
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")


def ended(out: Path | None = None, status: int = 0) -> int:
    """Says where results are, and after an interrupt how many; the status to end with, which is `status` without."""
    count = _interruption.results
    if not _interruption.signal:
        if out is not None:
            print(f"\nwritten to {out}")
        return status
    if not count:
        print(NO_RESULT, file=sys.stderr)
    else:
        results = f"{count} results are" if count > 1 else "1 result is"
        place = "told above" if out is None else f"kept in {out}, the last one as far as it came"
        print(f"interrupted: {results} {place}", file=sys.stderr)
    return _interruption.status
