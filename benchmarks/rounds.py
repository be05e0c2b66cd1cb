"""Contestants that run in turns, round after round, so that a change of the machine's speed meets all of them."""

import json
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass
class Contestant:
    """`run` does one round and returns how much was done, in steps, ticks and so on."""

    case: str
    name: str
    cores: int
    run: Callable[[], int]
    compile_seconds: float = 0.0


def save(rows: list[dict[str, Any]], path: Path | None) -> None:
    """Writes the rows as JSON, if there is a path."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(rows, indent=1, default=float) + "\n")


def measure(contestants: list[Contestant], rounds: int, unit: str, unit_size: float = 1.0) -> list[dict[str, Any]]:
    """Runs everybody in turns.

    Returns:
        a row for each: the median of the rounds ("value"), the best of them, and the median for a
        second of processor time instead of one of the clock, all in `unit`, which is `unit_size` of
        what `run` counts.
    """
    by_clock: list[list[float]] = [[] for _ in contestants]
    by_processor: list[list[float]] = [[] for _ in contestants]
    for number in range(rounds):
        for i, contestant in enumerate(contestants):
            began, began_cpu = time.perf_counter(), time.process_time()
            done = contestant.run() / unit_size
            by_clock[i].append(done / (time.perf_counter() - began))
            by_processor[i].append(done / (time.process_time() - began_cpu))
        print(f"round {number + 1} of {rounds}", flush=True)
    return [
        {
            "case": contestant.case,
            "contestant": contestant.name,
            "cores": contestant.cores,
            "value": statistics.median(clock),
            "best": max(clock),
            "per_cpu_second": statistics.median(processor),
            "unit": unit,
            "compile_seconds": contestant.compile_seconds,
        }
        for contestant, clock, processor in zip(contestants, by_clock, by_processor, strict=True)
    ]
