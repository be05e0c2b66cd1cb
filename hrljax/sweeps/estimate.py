"""What a sweep will take, before it is begun."""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Mapping, Sequence

import jax
import numpy as np
from jax import Array

from hrljax.core import checks, interrupts
from hrljax.core.environment import Numbers
from hrljax.engine import batch
from hrljax.engine.start import learned_bytes
from hrljax.envs.base import AnyEnvironment
from hrljax.learners.base import AnyLearner
from hrljax.learners.measured import Measure
from hrljax.sweeps.axes import Points
from hrljax.sweeps.job import Job
from hrljax.sweeps.request import SweepRequest

_EPISODES, _BINS, _POINTS, _ROUNDS = 200, 4, 4, 3
"""Of the measured run: episodes, bins, combinations of hyper-parameters, repetitions."""


@dataclasses.dataclass(frozen=True, repr=False)
class Estimate:
    """What a sweep will take. Times are extrapolated from a few short runs."""

    runs: int
    chunks: int
    runs_per_chunk: int  # the most; the others are filled up
    at_once: int  # chunks that are computed at a time
    result_bytes: int  # of the dataset
    working_bytes: int  # of the learners' tables while `at_once` chunks run
    steps: float  # of all runs
    seconds_per_chunk: float
    compile_seconds: float  # of the short run, which takes as long to compile
    seconds: float  # all in all, in one process or in processes that compile at the same time

    def __repr__(self) -> str:
        rows = (
            ("runs", f"{self.runs:,}"),
            ("chunks", f"{self.chunks:,} of up to {self.runs_per_chunk:,} runs, {self.at_once:,} at a time"),
            ("result", _bytes(self.result_bytes)),
            ("working memory", _bytes(self.working_bytes)),
            ("steps", f"about {self.steps:.2g}"),
            ("time", f"about {_duration(self.seconds)}, {_duration(self.seconds_per_chunk)} a chunk"),
            ("compilation", f"about {_duration(self.compile_seconds)} of it"),
        )
        return "\n".join(f"{name:<15} {text}" for name, text in rows)


def estimate(
    env: AnyEnvironment,
    learner: AnyLearner,
    *,
    seeds: int,
    num_episodes: int,
    axes: Mapping[str, Sequence[float]] | Points | None = None,
    key: Array | int = 0,
    params: Numbers | None = None,
    bin_size: int | None = None,
    evaluate_every: int | None = None,
    keep_learned: bool = False,
    mapping: batch.Mapping = "auto",
    cores: int | None = None,
    chunk_size: int | None = None,
    workers: int | None = None,
    store: bool = False,
    num_steps: int | None = None,
    measures: Sequence[Measure] = (),
) -> Estimate:
    """Says what `hrljax.sweep` with the same arguments will take; takes some seconds itself.

    A few runs of at most 200 episodes are measured in this process. The rest of a run is taken to
    go on at the pace and with the length of episodes at their end, so that the estimate is high
    where episodes are still getting shorter.

    Args:
        env: as of `hrljax.sweep`, and so are `learner`, `seeds`, `num_episodes`, `axes`, `key`, `params`, `bin_size`,
            `evaluate_every`, `keep_learned`, `mapping`, `cores`, `chunk_size`, `num_steps` and `measures`.
        workers: processes of the executor that the sweep will use, each with one core; none if None.
        store: whether the sweep will have a store.

    Raises:
        TypeError, ValueError: a bad argument, as `hrljax.sweep`.
    """
    for name, value in (("cores", cores), ("chunk_size", chunk_size), ("workers", workers)):
        if value is not None:
            checks.integer(name, value, 1)
    checks.flag("store", store)
    request = SweepRequest.checked(
        env,
        learner,
        seeds=seeds,
        num_episodes=num_episodes,
        axes=axes,
        key=key,
        params=params,
        bin_size=bin_size,
        evaluate_every=evaluate_every,
        keep_learned=keep_learned,
        mapping=mapping,
        num_steps=num_steps,
        measures=measures,
    )
    length, chunks = request.chunks(cores, chunk_size, portable=store or workers is not None)
    is_vmapped, num_runs = request.mapping == "vmap", request.grid.num_runs
    at_once = min(workers, len(chunks)) if workers else batch.most_at_once(request.mapping, cores, len(chunks))
    measured = _Measured(request, length)
    seconds_per_chunk = measured.chunk_seconds(request.job, length)
    tables = learned_bytes(env, learner)
    variables = request.schema(length).variables.values()
    return Estimate(
        runs=num_runs,
        chunks=len(chunks),
        runs_per_chunk=length,
        at_once=at_once,
        result_bytes=num_runs * sum(int(np.prod(v.shape)) * v.dtype.itemsize for v in variables),
        working_bytes=at_once * tables * (length if is_vmapped else 1),
        steps=num_runs * float(measured.steps_per_run(num_episodes).mean()),
        seconds_per_chunk=seconds_per_chunk,
        compile_seconds=measured.compile_seconds,
        seconds=measured.compile_seconds + -(-len(chunks) // at_once) * seconds_per_chunk,
    )


class _Measured:
    """Short runs: of one chunk under `vmap`, else of a few combinations of hyper-parameters."""

    def __init__(self, request: SweepRequest, length: int):
        grid, job = request.grid, request.job
        self.is_vmapped = request.mapping == "vmap"
        points = grid.num_runs // grid.seeds
        few = np.unique(np.linspace(0, points - 1, min(points, _POINTS)).astype(int)) * grid.seeds
        index = np.arange(length) if self.is_vmapped else few
        self.rows = jax.tree.map(lambda a: a[index], request.rows)
        self.num_steps = job.num_steps
        self.count, self.episodes = len(index), min(job.num_episodes, _EPISODES)
        size = -(-self.episodes // _BINS)
        short = dataclasses.replace(
            job, num_episodes=self.episodes, bin_size=size, evaluate_every=None, keep_learned=False, num_steps=None
        )
        self.compile_seconds, self.seconds, values = self._timed(short)
        self.steps = values["steps"].astype(np.float64)  # [runs]
        self.last_length = values["length"][:, -1].astype(np.float64)  # [runs] steps per episode at the end
        self.evaluation_seconds = 0.0
        if job.evaluate_every is not None:
            once = dataclasses.replace(short, evaluate_every=-(-self.episodes // size))
            self.evaluation_seconds = max(0.0, self._timed(once)[1] - self.seconds)

    def _timed(self, job: Job) -> tuple[float, float, dict[str, np.ndarray]]:
        """Seconds of compilation and of the runs, and what came of them."""
        started = time.perf_counter()
        job.compiled(self.rows, self.count)
        compile_seconds = time.perf_counter() - started
        values, seconds = {}, []
        for _ in range(_ROUNDS):
            started = time.perf_counter()
            values = interrupts.start(job, self.rows, self.count).result()
            seconds.append(time.perf_counter() - started)
        return compile_seconds, statistics.median(seconds), values

    def steps_per_run(self, num_episodes: int) -> np.ndarray:
        """``[runs]``: steps of whole runs."""
        whole = self.steps + (num_episodes - self.episodes) * self.last_length
        return whole if self.num_steps is None else np.minimum(whole, np.maximum(self.num_steps, self.steps))

    def chunk_seconds(self, job: Job, length: int) -> float:
        whole = self.steps_per_run(job.num_episodes)
        evaluations = 0 if job.evaluate_every is None else -(-job.num_episodes // job.bin_size) // job.evaluate_every
        evaluating = evaluations * self.evaluation_seconds
        if self.is_vmapped:
            return self.seconds * float(whole.max() / self.steps.max()) + evaluating
        return length * (self.seconds * float(whole.sum() / self.steps.sum()) + evaluating) / self.count


def _bytes(count: int) -> str:
    units = ["B", "kB", "MB", "GB", "TB"]
    power = min(max(0, (len(str(count)) - 1) // 3), len(units) - 1)
    return f"{count / 1000**power:.3g} {units[power]}"


def _duration(seconds: float) -> str:
    for unit, size in (("days", 86400), ("hours", 3600), ("minutes", 60)):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.2g} seconds"
