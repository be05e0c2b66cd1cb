"""Interrupts scripts at random moments, and checks how they end and what they leave; run by hand, takes 10 minutes.

    python tests/interrupt_scripts.py

Exit status 0: each ended with status 130 (143 after SIGTERM), without a traceback, and all that it left is whole.
"""

import csv
import json
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import tyro
from PIL import Image

import hrljax

SCRIPTS = {
    "advice_quality.py": [],
    "figure_4_2.py": ["--seeds", "50", "--episodes", "4000"],
    "learning_rates.py": ["--seeds", "100"],
    "neighbours.py": [],
    "optimality.py": ["--seeds", "50"],
    "table_4_1.py": ["--seeds", "4", "--episodes", "50"],
    "mario_search.py": [],
}
"""Scripts with options by which they take longer than half a minute."""


@dataclass(frozen=True)
class Options:
    """Interrupts scripts at random moments, and checks how they end and what they leave."""

    interrupts: int = 20
    """Scripts that get SIGINT, as by Ctrl-C."""
    terminations: int = 5
    """Scripts that get SIGTERM afterwards."""
    seconds: float = 30.0
    """Moments lie within so many seconds of the start."""
    seed: int = 0
    """Seed of the moments."""


def left_whole(out: Path) -> str:
    """Reads every file that a script has left; says how many of what kind.

    Raises:
        Exception: of whoever cannot read a file.
    """
    counts: dict[str, int] = {}
    for path in sorted(out.rglob("*")):
        if path.suffix == ".json" and path.parent == out:
            json.loads(path.read_text())
        elif path.suffix == ".csv":
            assert len({len(row) for row in csv.reader(path.open())}) == 1, f"{path} has lines of several lengths"
        elif path.suffix in (".png", ".gif"):
            with Image.open(path) as image:
                image.load()
        elif path.suffix == ".zarr":
            assert hrljax.load(path)["steps"].notnull().any(), f"{path} has no finished run"
        elif path.is_dir() or any(parent.suffix == ".zarr" for parent in path.parents):
            continue
        else:
            raise AssertionError(f"{path} should not be there")
        counts[path.suffix] = counts.get(path.suffix, 0) + 1
    return ", ".join(f"{count} {suffix[1:]}" for suffix, count in counts.items()) or "no files"


def complaint(status: int, number: signal.Signals, output: str, last_words: str) -> str:
    """What is wrong with how a script has ended, nothing if it is as it should be."""
    if status != 128 + number:
        return f"status {status}"
    for word in ("Traceback", "Fatal", "Error", "Exception"):
        if word in output:
            return f"it says {word}:\n{output}"
    return "" if re.match("interrupted: ", last_words) else f"its last words are {last_words!r}"


def interrupted(script: str, moment: float, number: signal.Signals) -> bool:
    """Interrupts a script, and prints what came of it; whether all was well."""
    path = Path(__file__).parents[1] / "scripts" / script
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        command = [sys.executable, path, *SCRIPTS[script], "--out", out]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        time.sleep(moment)
        process.send_signal(number)
        sent = time.perf_counter()
        output, _ = process.communicate(timeout=900)
        waited = time.perf_counter() - sent
        last_words = next((line for line in reversed(output.splitlines()) if line.strip()), "").replace(folder, "")
        wrong = complaint(process.returncode, number, output, last_words)
        try:
            files = left_whole(out)
        except Exception as error:
            files = wrong = f"not readable: {error!r}"
    verdict = f"WRONG: {wrong}" if wrong else "ok"
    print(
        f"{script:18} {number.name:7} after {moment:4.1f} s: status {process.returncode} {waited:5.1f} s later; "
        f"{last_words}; {files}; {verdict}",
        flush=True,
    )
    return not wrong


def main(options: Options) -> int:
    # A process started in the background ignores interrupts, and so would the scripts that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    moments = random.Random(options.seed)
    numbers = [signal.SIGINT] * options.interrupts + [signal.SIGTERM] * options.terminations
    names = [*SCRIPTS]
    well = [
        interrupted(names[i % len(names)], moments.uniform(0, options.seconds), number)
        for i, number in enumerate(numbers)
    ]
    print(f"{sum(well)} of {len(well)} ended as they should")
    return 0 if all(well) else 1


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
