"""Many seeds and hyper-parameters in one call, with labelled results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jax import Array

from hrljax.core import checks
from hrljax.core.environment import Numbers
from hrljax.core.progress import ticking
from hrljax.engine import batch
from hrljax.engine.start import Startable
from hrljax.envs.base import AnyEnvironment
from hrljax.learners.base import AnyLearner
from hrljax.learners.measured import Measure
from hrljax.sweeps.axes import Points
from hrljax.sweeps.job import Chunk
from hrljax.sweeps.logs import Callback, finished_runs
from hrljax.sweeps.request import SweepRequest
from hrljax.sweeps.schema import dataset
from hrljax.sweeps.store import Store
from hrljax.sweeps.store_attributes import chunk_size_of

if TYPE_CHECKING:
    import xarray as xr


def sweep(
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
    executor: Executor | None = None,
    store: str | Path | None = None,
    allow_other_versions: bool = False,
    start: xr.Dataset | Startable | None = None,
    num_steps: int | None = None,
    measures: Sequence[Measure] = (),
    callback: Callback | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Trains a learner for every combination of hyper-parameters and seed.

    Seed i uses ``jax.random.fold_in(key, i)``, the same in every combination; its result depends on
    nothing else, whatever the batch, the chunks, the cores and the mapping.

    Args:
        env: a tabular environment.
        learner: what learns.
        seeds: number of seeds, at least 1.
        num_episodes: episodes of each run, at least 1.
        axes: values by the name of a hyper-parameter: a field of the learner (``"pseudo_reward"``),
            of its root (``"root.step_size"``) or of the environment (``"env.slip_probability"``). All combinations are
            swept; or, of `hrljax.points`, those that it lists.
        key: a new-style key, or an integer for ``jax.random.key``.
        params: numbers of the environment, `env.default_params` if None.
        bin_size: episodes in a bin; about a 200th of the run if None.
        evaluate_every: evaluates the greedy policy exactly after every so many bins; never if None.
        keep_learned: whether to keep the tables that every run ends with, for `hrljax.Learned`.
        mapping: ``"native"``, ``"vmap"``, or ``"auto"``: the former on CPUs, the latter elsewhere.
        cores: cores to use, all if None; with an executor, the chunks that it is given at a time.
        chunk_size: runs in a chunk; chosen if None.
        executor: where chunks of runs are computed: any `concurrent.futures.Executor`, such as
            `hrljax.sweeps.processes.processes` and Dask's ``client.get_executor()``; threads of this process
            if None. Its workers only need to import hrljax.
        store: the folder of a Zarr store that keeps every chunk as soon as it is finished; a chunk
            is a group of seeds of one combination. If the store is there, the sweep continues it:
            it computes what is missing or corrupt, and the end is the same as without the break,
            byte for byte. With more `seeds` than it has, it computes the others. `hrljax.load` and
            `xarray.open_zarr` open it at any time.
        allow_other_versions: whether to continue a store that other versions of hrljax or JAX have
            begun, whose numbers may differ in a last bit from what these would give. The dataset
            and the store say which versions there were, and ``version_set`` which computed each run.
        start: what training goes on from; from scratch if None. A dataset of a sweep with `keep_learned`:
            every run goes on from the one with its seed and its values along the axes that the dataset
            has, and with the same `key` two sweeps of 500 episodes give the bits of one of 1000. Or a
            `hrljax.Learned`, from which every run goes on.
        num_steps: every run ends early, after the bin in which it has taken so many primitive steps, those before
            `start` included; its later bins are NaN. Never early if None.
        measures: further variables, means of each bin as ``return`` is: ``"discounted_return"`` (per episode, with the
            learner's discount) and ``"average_reward"`` (per step). They change nothing else.
        callback: called in this thread with finished runs as soon as there are some: a dataset with a dimension ``run``
            in place of those of the axes and seeds, which are coordinates along it. Runs that `store` has already
            come first. `hrljax.CSVLog` and `hrljax.TensorBoardLog` are such functions. What it raises ends the sweep;
            a keyboard interrupt that falls into it has it called again with the same runs.
        progress: whether to show a progress bar.

    Returns:
        A dataset with dimensions of the axes (of `hrljax.points`, one dimension ``point``), then ``seed``,
        then ``episode`` (the last episode of each bin, counted from the very first). Variables: ``return``,
        ``length`` and the environment's events, means per episode of the bin; ``steps`` of each run, those
        before `start` included; with `evaluate_every`, ``greedy_return`` over ``checkpoint``; with
        `keep_learned`, ``learned`` or its parts. Attributes: every setting (``"swept"`` where there
        is an axis), the versions, the key, ``seconds`` (``compile_seconds`` apart, if this process
        compiles) and ``complete``; after a keyboard interrupt the unfinished runs are NaN and
        ``complete`` is 0.

    Raises:
        KeyboardInterrupt: before the first runs, or for the second time.
        RuntimeError: this process was forked after JAX had started.
        TypeError, ValueError: a bad argument, an environment that is not as `hrljax.check` wants it, or a
            store of another sweep, of other versions or of more seeds; before anything is compiled.
        FileExistsError: there is something else at `store`.
        OSError: the store cannot be made, which is told before anything is compiled, or written; its
            finished chunks are intact.
    """
    cores = None if cores is None else checks.integer("cores", cores, 1)
    chunk_size = None if chunk_size is None else checks.integer("chunk_size", chunk_size, 1)
    if executor is not None:
        checks.instance("executor", executor, Executor, "a concurrent.futures.Executor")
    store = None if store is None else checks.path("store", store)
    checks.flag("allow_other_versions", allow_other_versions)
    checks.flag("progress", progress)
    if callback is not None:
        checks.function("callback", callback, "of a dataset of finished runs")
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
        start=start,
        num_steps=num_steps,
        measures=measures,
    )
    attributes = dict(request.attributes if store is None else request.identity)
    title = f"{type(learner).__name__} on {env.name}" if progress else None
    with ExitStack() as stack:
        disk = None
        if store is not None:
            chunk_size = chunk_size_of(store, chunk_size)
        length, chunks = request.chunks(cores, chunk_size, portable=store is not None or executor is not None)
        if store is not None:
            disk = stack.enter_context(Store(store, request, length, allow_other_versions))
        collected = batch.Collected(request.grid.num_runs)
        if disk is not None:
            chunks = disk.restore(chunks, collected)
            if callback is not None and collected.finished.any():
                before = np.flatnonzero(collected.finished)
                values = {name: values[before] for name, values in collected.values.items()}
                callback(finished_runs(request.schema(length), before, values))

        def keep(chunk: range, values: Chunk) -> None:
            if disk is not None:
                disk.write(chunk, values)
            if callback is not None:
                callback(finished_runs(request.schema(length), np.array(chunk), values))

        started = time.perf_counter()
        run: Callable[..., Chunk] = request.job.sent() if executor is not None else request.job
        if chunks and executor is None:
            with ticking(title and f"{title}: compiling"):
                run = request.job.compiled(request.rows, length)
        compiled_at = time.perf_counter()
        results = batch.run_many(
            run,
            request.rows,
            mapping=request.mapping,
            cores=cores,
            chunk_size=length,
            chunks=chunks,
            executor=executor,
            collected=collected,
            keep=keep,
            progress=title,
        )
        complete = bool(results.finished.all())
        if disk is not None:
            disk.mark(complete)
    attributes |= {
        "mapping": request.mapping,
        "seconds": time.perf_counter() - compiled_at,
        "complete": int(complete),
    }
    if executor is None:
        attributes["compile_seconds"] = compiled_at - started
    swept = dataset(request.schema(length), results.values, results.finished, attributes)
    return swept if disk is None else disk.with_versions(swept)
