"""What the programs in scripts/ and benchmarks/ share: checks of their options, what they write, how they end."""

import json
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import tyro

from hrljax import checks

Options = TypeVar("Options")


def run(main: Callable[[Options], int], options: type[Options]) -> NoReturn:
    """Ends the process with the status of `main`, called with options from the command line.

    An error of the user's ends it with a message instead of a traceback.
    """
    try:
        sys.exit(main(tyro.cli(options)))
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")


def require(extra: str, *packages: str) -> None:
    """Ends the process with a sentence and status 2 unless some packages of an extra are installed."""
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        command = f"pip install -e '.[{extra}]'"
        print(f"error: this program needs {' and '.join(missing)}: {command} installs what is missing", file=sys.stderr)
        sys.exit(2)


def check_counts(options: Any, *names: str) -> None:
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


def write_summary(out: Path, summary: Any) -> None:
    """Writes ``summary.json``."""
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")


def ended(out: Path, complete: bool = True) -> int:
    """Says where results are, and whether some are missing; the status to end with."""
    print(f"\nwritten to {out}")
    if not complete:
        print("interrupted: only what was finished is there", file=sys.stderr)
    return 0 if complete else 130
