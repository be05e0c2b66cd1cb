"""Many seeds and hyper-parameters in one call, with labelled results."""

from __future__ import annotations

import dataclasses
import itertools
import json
import time
from collections.abc import Callable, Mapping, Sequence, Set
from concurrent.futures import Executor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from hrljax.core import checks, interrupts, random
from hrljax.core.progress import ticking
from hrljax.engine import batch
from hrljax.engine.run import bin_sizes, default_bin_size, metric_names
from hrljax.engine.start import Startable, learned_shapes, named_leaves
from hrljax.engine.train import check_arguments
from hrljax.envs.base import concrete_params, numbers_of
from hrljax.envs.checks import check_before_training
from hrljax.learners.base import Learner
from hrljax.sweeps import fingerprint
from hrljax.sweeps.continuation import Continuation, continuation
from hrljax.sweeps.job import ENV_PREFIX, Job
from hrljax.sweeps.schema import Labels, Variable, dataset, describe
from hrljax.sweeps.store import Store
from hrljax.sweeps.store_attributes import chunk_size_of

if TYPE_CHECKING:
    import xarray as xr


def sweep(
    env: Any,
    learner: Learner,
    *,
    seeds: int,
    num_episodes: int,
    axes: Mapping[str, Sequence[float]] | None = None,
    key: Array | int = 0,
    params: Any = None,
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
            of its root (``"root.step_size"``) or of the environment (``"env.slip_probability"``).
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
        progress: whether to show a progress bar.

    Returns:
        A dataset with dimensions of the axes, then ``seed``, then ``episode`` (the last episode of
        each bin, counted from the very first). Variables: ``return``, ``length`` and the
        environment's events, means per episode of the bin; ``steps`` of each run, those before
        `start` included; with `evaluate_every`, ``greedy_return`` over ``checkpoint``; with
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
    checked = check(
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
    )
    job, labels, attributes, resolved = checked.job, checked.labels, checked.attributes, checked.mapping
    title = f"{type(learner).__name__} on {env.name}" if progress else None
    with ExitStack() as stack:
        disk = None
        if store is not None:
            attributes |= checked.identity()
            chunk_size = chunk_size_of(store, chunk_size)
        length, chunks = checked.chunks(cores, chunk_size, portable=store is not None or executor is not None)
        if store is not None:
            disk = stack.enter_context(Store(store, labels, attributes, length, allow_other_versions))
        collected = batch.Collected(labels.num_rows)
        if disk is not None:
            chunks = disk.restore(chunks, collected)
        rows = checked.rows()
        started = time.perf_counter()
        run: Callable[..., Any] = job.sent() if executor is not None else job
        if chunks and executor is None:
            with ticking(title and f"{title}: compiling"):
                run = job.compiled(rows, length)
        compiled_at = time.perf_counter()
        results = batch.run_many(
            run,
            rows,
            mapping=resolved,
            cores=cores,
            chunk_size=length,
            chunks=chunks,
            executor=executor,
            collected=collected,
            keep=None if disk is None else disk.write,
            progress=title,
        )
        complete = bool(results.finished.all())
        if disk is not None:
            disk.mark(complete)
    attributes |= {"mapping": resolved, "seconds": time.perf_counter() - compiled_at, "complete": int(complete)}
    if executor is None:
        attributes["compile_seconds"] = compiled_at - started
    swept = dataset(labels, results.values, results.finished, attributes)
    return swept if disk is None else disk.with_versions(swept)


@jax.jit
def _seed_words(key: Array, seeds: Array) -> Array:
    """``[seeds, 2]`` uint32: the words of the key of each seed."""
    return jax.random.key_data(jax.vmap(partial(jax.random.fold_in, key))(seeds))


class Checked(NamedTuple):
    """A sweep whose arguments are fine."""

    job: Job
    labels: Labels
    key: Array
    mapping: Any  # what the job's mapping means here
    attributes: dict[str, Any]
    start: Continuation | None

    def chunks(self, cores: int | None, chunk_size: int | None, portable: bool) -> tuple[int, list[range]]:
        """The most runs in a chunk, and the runs of each.

        Portable chunks hold one combination of hyper-parameters and are the same on every machine.
        """
        count = self.labels.num_rows
        if portable:
            length = batch.portable_chunk_length(count, self.labels.seeds, self.mapping, chunk_size)
            return length, batch.chunks_of(count, length, within=self.labels.seeds)
        length = batch.chunk_length(count, cores or batch.usable_cores(), self.mapping, chunk_size)
        return length, batch.chunks_of(count, length)

    @interrupts.postponed()
    def rows(self) -> dict[str, Any]:
        """What tells the runs apart; see `hrljax.sweeps.job.Job`."""
        labels = self.labels
        words = _seed_words(self.key, jnp.arange(labels.seeds))
        grid = np.array(list(itertools.product(*labels.columns.values())), np.float32)
        return {
            "key": np.tile(np.asarray(words), (len(grid), 1)),
            "axes": {name: np.repeat(grid[:, i], labels.seeds) for i, name in enumerate(labels.columns)},
            **({} if self.start is None else {"start": self.start.rows}),
        }

    def identity(self) -> dict[str, Any]:
        """What a store of this sweep has to agree with, beside the attributes."""
        job, labels = self.job, self.labels
        return {
            "evaluate_every": job.evaluate_every or 0,
            "keep_learned": int(job.keep_learned),
            "seeds": labels.seeds,
            "axes": json.dumps(labels.columns),
            **({} if self.start is None else {"digest.start": self.start.digest()}),
            **fingerprint.digests(job.env, job.learner, job.first_episode + job.num_episodes),
        }


@interrupts.postponed()
def check(
    env: Any,
    learner: Learner,
    *,
    seeds: int,
    num_episodes: int,
    axes: Mapping[str, Sequence[float]] | None,
    key: Array | int,
    params: Any,
    bin_size: int | None,
    evaluate_every: int | None,
    keep_learned: bool,
    mapping: batch.Mapping,
    start: xr.Dataset | Startable | None = None,
) -> Checked:
    """Checks the arguments of `sweep`.

    Raises:
        TypeError, ValueError: a bad argument.
    """
    num_episodes, bin_size, evaluate_every = check_arguments(env, learner, num_episodes, bin_size, evaluate_every)
    seeds = checks.integer("seeds", seeds, 1)
    keep_learned = checks.flag("keep_learned", keep_learned)
    is_seed = checks.is_number(key, np.integer)
    root_key: Any = jax.random.key(checks.integer("key", key, 0, 2**32 - 1)) if is_seed else key
    random.check_key(root_key)
    params = numbers_of(env, params)
    if any(isinstance(value, Tracer) for value in (root_key, *params, *learner.settings().values())):
        raise TypeError("a sweep compiles and maps its runs itself, so jax.jit and jax.vmap cannot trace it; map train")
    columns = _checked_axes(learner, params, {} if axes is None else axes)
    if evaluate_every is not None and any(name.startswith(ENV_PREFIX) for name in columns):
        raise ValueError("evaluate_every needs fixed params: it cannot be combined with an axis of the environment")
    of_env = {n.removeprefix(ENV_PREFIX): values for n, values in columns.items() if n.startswith(ENV_PREFIX)}
    check_before_training(env, params, of_env)
    bin_size = bin_size or default_bin_size(num_episodes)
    if evaluate_every is not None and evaluate_every > len(bin_sizes(num_episodes, bin_size)):
        raise ValueError(f"evaluate_every must be at most the number of bins, got {evaluate_every}")
    resolved = batch.resolve_mapping(mapping)
    job = Job(env, learner, params, num_episodes, bin_size, evaluate_every, keep_learned, mapping)
    attributes = fingerprint.attributes(env, learner, params, root_key, columns)
    attributes |= {"num_episodes": num_episodes, "bin_size": bin_size}
    labels, begin = _labels(job, columns, seeds), None
    if start is not None:
        begin = continuation(start, env, learner, labels, num_episodes)
        job = dataclasses.replace(job, first_episode=begin.episodes)
        labels = labels.after(begin.episodes)
        attributes |= begin.attributes()
    return Checked(job, labels, root_key, resolved, attributes, begin)


def _labels(job: Job, columns: dict[str, list[float]], seeds: int) -> Labels:
    ends = np.cumsum(bin_sizes(job.num_episodes, job.bin_size))
    number = np.dtype(np.float64)
    coordinates = {"episode": ends}
    variables = {
        name: Variable(("episode",), (len(ends),), number, describe(name))
        for name in metric_names(job.env, job.learner)
    }
    variables["steps"] = Variable((), (), number, {})
    if job.evaluate_every is not None:
        coordinates["checkpoint"] = ends[job.evaluate_every - 1 :: job.evaluate_every]
        variables["greedy_return"] = Variable(("checkpoint",), (len(coordinates["checkpoint"]),), number, {})
    for name, leaf in named_leaves(learned_shapes(job.env, job.learner)) if job.keep_learned else ():
        dims = tuple(f"{name}.{i}" for i in range(len(leaf.shape)))
        variables[name] = Variable(dims, leaf.shape, np.dtype(leaf.dtype), {})
    return Labels(columns, seeds, coordinates, variables)


def _checked_axes(learner: Learner, params: Any, axes: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    """The axes as lists of floats, each value checked as the hyper-parameter would be."""
    checks.instance("axes", axes, Mapping, "a mapping such as {'step_size': [0.1, 0.2]}")
    of_learner = learner.sweepable()
    of_env = [ENV_PREFIX + f for f in params._fields if f != "max_steps"]
    columns: dict[str, list[float]] = {}
    for name, values in axes.items():
        if name not in of_learner and name not in of_env:
            known = ", ".join([*of_learner, *of_env])
            is_limit = name == f"{ENV_PREFIX}max_steps"
            why = ", for it only says where episodes are cut off: sweep once for each, with params" if is_limit else ""
            raise ValueError(f"axes: {name!r} cannot be swept{why}; sweepable are {known}")
        columns[name] = _numbers_of_axis(name, values)
        if not columns[name] or len(set(columns[name])) < len(columns[name]):
            raise ValueError(f"axes: the values of {name!r} must be at least one and different, got {values!r}")
        for value in columns[name]:
            if name in of_learner:
                learner.replaced({name: value})
            else:
                concrete_params(params._replace(**{name.removeprefix(ENV_PREFIX): value}))
    return columns


def _numbers_of_axis(name: str, values: Any) -> list[float]:
    """The values of an axis, if they are numbers in an order."""
    if hasattr(values, "__array__") and not isinstance(values, Tracer):
        values = np.asarray(values)
    try:
        numbers = [None] if isinstance(values, str | bytes | Set | Mapping) else list(values)
    except TypeError:  # it has no elements
        numbers = [None]
    if not all(checks.is_number(number) and not isinstance(number, Tracer) for number in numbers):
        described = checks.described(values)
        raise TypeError(f"axes: the values of {name!r} must be a sequence of numbers, got {described}")
    return [float(checks.number(f"axes: {name}", number)) for number in numbers]
