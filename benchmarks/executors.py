"""Throughput of sweeps in threads and in processes, with one core and with more.

Every contestant has compiled before it is measured; all run in turns, round after round, and the
median is reported. Beside the steps a second stand the steps a second of processor time, which say
on a busy machine what a free one would give: twice the cores are worth the ratio of both times two.

    python benchmarks/executors.py --json executors.json
"""

import platform
import statistics
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

import hrljax as hrl
from hrljax.engine import batch
from hrljax.sweeps import processes

try:
    from benchmarks.rounds import save
except ModuleNotFoundError:
    from rounds import save

ENV = hrl.make("Bus")
LEARNER = hrl.QLearning(initial_value=-25.0)


@dataclass(frozen=True)
class Options:
    """Throughput of sweeps in threads and in processes."""

    episodes: int = 20_000
    """Episodes of a run."""
    seeds: int = 32
    """Runs of a round."""
    rounds: int = 5
    """Rounds; every contestant runs once in each."""
    cores: int = batch.usable_cores()
    """Greatest number of cores; one core is measured in any case."""
    json: Path | None = None
    """Where to write the rows."""


class Timed(Executor):
    """Adds up the processor time of what another executor runs."""

    def __init__(self, executor: Executor):
        self.executor, self.cpu_seconds = executor, 0.0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        outer: Future[Any] = Future()

        def done(inner: Future[Any]) -> None:
            if inner.exception() is not None:
                outer.set_exception(inner.exception())
                return
            result, seconds = inner.result()
            self.cpu_seconds += seconds
            outer.set_result(result)

        self.executor.submit(timed, fn, *args, **kwargs).add_done_callback(done)
        return outer


def timed(fn: Callable[..., Any], *args: Any, **kwargs: Any) -> tuple[Any, float]:
    """A result and the processor time of the process meanwhile."""
    started = time.process_time()
    return fn(*args, **kwargs), time.process_time() - started


def main(options: Options) -> None:
    rows: list[dict[str, Any]] = []
    counts = sorted({1, options.cores})
    measured: dict[tuple[str, int], list[tuple[float, float]]] = {}
    with ExitStack() as stack:
        executors = {
            **{("threads", n): Timed(stack.enter_context(ThreadPoolExecutor(n))) for n in counts},
            **{("processes", n): Timed(stack.enter_context(processes.processes(n))) for n in counts},
        }

        def sweep(name: str, cores: int, key: int) -> tuple[float, float]:
            """Steps a second and steps a second of processor time."""
            executor = executors[name, cores]
            executor.cpu_seconds = 0.0
            started, cpu_before = time.perf_counter(), time.process_time()
            actual = hrl.sweep(
                ENV,
                LEARNER,
                seeds=options.seeds,
                num_episodes=options.episodes,
                bin_size=options.episodes,
                chunk_size=max(1, options.seeds // (4 * options.cores)),
                executor=executor,
                cores=2 * cores,
                key=key,
                mapping="native",
                progress=False,
            )
            steps = float(actual["steps"].sum())
            # Threads share one process, whose time counts all of them.
            cpu_seconds = executor.cpu_seconds if name == "processes" else time.process_time() - cpu_before
            return steps / (time.perf_counter() - started), steps / cpu_seconds

        for contestant in executors:
            sweep(*contestant, key=0)  # compiles in every worker
        for key in range(options.rounds):
            for contestant in executors:
                measured.setdefault(contestant, []).append(sweep(*contestant, key))
    for (name, cores), values in measured.items():
        for unit, numbers in zip(("steps/s", "steps/s of CPU"), zip(*values, strict=True), strict=True):
            value = statistics.median(numbers)
            rows.append(
                {"case": "Q-learning", "contestant": f"hrljax {name}", "cores": cores, "value": value, "unit": unit}
            )
            print(f"{name:10} {cores:3} cores {value / 1e6:8.2f} million {unit}")
    machine = {"machine": platform.processor() or platform.machine(), "python": platform.python_version()}
    save([{**row, "compile_seconds": None, **machine} for row in rows], options.json)


if __name__ == "__main__":
    main(tyro.cli(Options))
