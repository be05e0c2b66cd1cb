"""What all runs of a sweep have in common, and how it travels to other processes."""

import dataclasses
import pickle
import threading
from collections.abc import Callable
from concurrent.futures import Future
from functools import lru_cache
from typing import Any

import cloudpickle
import jax
import numpy as np

from hrljax.core import forks, interrupts
from hrljax.engine import batch
from hrljax.engine.start import Start, named_leaves, steps_of
from hrljax.engine.train import run as run_once
from hrljax.learners.base import Learner

ENV_PREFIX = "env."


@dataclasses.dataclass(frozen=True)
class Job:
    """Runs that differ in their keys and in the values along the axes; see `hrljax.train`."""

    env: Any
    learner: Learner
    params: Any
    num_episodes: int
    bin_size: int
    evaluate_every: int | None
    keep_learned: bool
    mapping: batch.Mapping
    first_episode: int = 0
    """Episodes that runs have learned from before they start."""

    def compiled(self, rows: Any, length: int) -> Callable[[Any], Any]:
        """The compiled function of a chunk of `length` rows like `rows`; compiled once per process.

        A keyboard interrupt in the meantime ends the call, and the compilation goes on: the next call waits for it.
        """
        forks.check_not_forked()
        shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct((length, *a.shape[1:]), a.dtype), rows)
        mapping = batch.resolve_mapping(self.mapping)
        job = dataclasses.replace(self, mapping=mapping)
        return _compiler(_Frozen(job))(shapes)

    def __call__(self, rows: Any, length: int) -> dict[str, np.ndarray]:
        """Runs a chunk of rows, computed in one of `length`.

        Args:
            rows: ``key`` ``[rows, 2]`` uint32, the words of each run's key; ``axes``, for each
                swept hyper-parameter its values ``[rows]`` float32; ``start``, where runs go on, the
                fields of `hrljax.engine.start.Start` but the episodes, ``[rows, ...]``.
            length: rows that the compiled function takes.

        Returns:
            By name, ``[rows, ...]``: the metrics, ``steps``, ``greedy_return`` where asked for, and
            the leaves of what was learned where asked for.
        """
        return batch.run_chunk(self.compiled(rows, length), rows, length)

    def sent(self) -> "SentJob":
        """The same as bytes, for other processes."""
        return SentJob(cloudpickle.dumps(self))


@dataclasses.dataclass(frozen=True)
class SentJob:
    """A `Job` as bytes: hierarchies and schedules hold closures, which cloudpickle sends by value.

    A process makes an object of the same bytes once, and so compiles it once.
    """

    pickled: bytes

    def __call__(self, rows: Any, length: int) -> dict[str, np.ndarray]:
        return _received(self.pickled)(rows, length)


@lru_cache(maxsize=16)
def _received(pickled: bytes) -> Job:
    return pickle.loads(pickled)


class _Frozen:
    """A job as the key of a cache: equal when the static parts and the plain numbers are."""

    def __init__(self, job: Job):
        self.job = job
        settings = tuple((k, _hashable(v)) for k, v in job.learner.settings().items())
        others = (getattr(job, f.name) for f in dataclasses.fields(job) if f.name != "learner")
        self._key = (type(job.learner), settings, *others)

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Frozen) and self._key == other._key


def _hashable(value: Any) -> Any:
    return float(value) if isinstance(value, np.generic | jax.Array) else value


@lru_cache(maxsize=128)
def _compiler(frozen: _Frozen) -> Callable[[Any], Callable[[Any], Any]]:
    """For shapes of rows: the compiled function of a chunk. Each is compiled once per process."""
    job = frozen.job

    def run(row: dict[str, Any]) -> dict[str, Any]:
        own = {name: value for name, value in row["axes"].items() if not name.startswith(ENV_PREFIX)}
        of_env = {n.removeprefix(ENV_PREFIX): v for n, v in row["axes"].items() if n.startswith(ENV_PREFIX)}
        result = run_once(
            job.env,
            job.learner.replaced(own),
            jax.random.wrap_key_data(row["key"], impl="threefry2x32"),
            job.num_episodes,
            params=job.params._replace(**of_env),
            bin_size=job.bin_size,
            evaluate_every=job.evaluate_every,
            start=Start(episodes=job.first_episode, **row["start"]) if "start" in row else None,
            vmapped=job.mapping == "vmap",
        )
        values = {**result.metrics, "steps": result.step_words}
        if job.evaluate_every is not None:
            values["greedy_return"] = result.greedy_return
        return values | (dict(named_leaves(result.learned)) if job.keep_learned else {})

    jitted: Any = batch.compile_mapped(run, job.mapping, job.env.has_loops)  # type: ignore[arg-type]
    by_shape: dict[str, Future[Any]] = {}
    lock = threading.Lock()

    def for_shapes(shapes: Any) -> Any:
        signature = str(jax.tree.map(lambda s: (s.shape, s.dtype), shapes))
        with lock:
            future = by_shape.get(signature)
            if future is None or (future.done() and future.exception()):
                with interrupts.postponed():
                    lowered = jitted.lower(shapes)  # in this thread: some of JAX's settings belong to one
                future = by_shape[signature] = interrupts.start(lowered.compile)
        compiled = future.result()
        return lambda rows: _on_host(compiled(rows))

    return for_shapes


def _on_host(values: dict[str, Any]) -> dict[str, np.ndarray]:
    """The values of a chunk as NumPy arrays, ``steps`` as numbers."""
    arrays = {name: np.asarray(value) for name, value in values.items()}
    return arrays | {"steps": steps_of(arrays["steps"])}
