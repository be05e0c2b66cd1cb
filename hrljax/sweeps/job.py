"""What all runs of a sweep have in common, what each of them gives, and how both travel to other processes."""

import dataclasses
import pickle
import threading
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from functools import lru_cache, partial
from typing import Any, Generic, NamedTuple, NotRequired, TypeAlias, TypedDict, TypeVar, cast

import cloudpickle
import jax
import numpy as np
from jax import Array

from hrljax.core import forks, interrupts
from hrljax.core.environment import Numbers
from hrljax.engine import batch
from hrljax.engine.start import Start, learned_bytes, named_leaves, steps_of
from hrljax.engine.train import run_once
from hrljax.envs.base import AnyEnvironment
from hrljax.learners.base import AnyLearner
from hrljax.learners.measured import Measure
from hrljax.sweeps.axes import of_env, of_learner

STEPS = "steps"
"""A variable of every sweep, finite where a run is finished. Runs give two words: compiled code has no 64 bits."""
EPISODE, CHECKPOINT = "episode", "checkpoint"
"""Dimensions: bins of episodes, and exact evaluations."""
Leaf = TypeVar("Leaf")
Column: TypeAlias = Any
"""A tree of NumPy arrays, of traced ones, or of their shapes."""


class Rows(TypedDict):
    """What tells runs apart, as arrays; one of the rows is a run."""

    key: Column  # [rows, 2] uint32: the words of each run's key
    axes: dict[str, Column]  # for each swept hyper-parameter its values, [rows] float32
    start: NotRequired[dict[str, Column]]  # where runs go on: `hrljax.engine.start.Start` but the episodes, [rows, ...]


class Place(NamedTuple):
    """Where one of the values of a run lies in a dataset."""

    name: str
    dims: tuple[str, ...]  # of one run
    is_table: bool = False  # it is learned, not measured


@partial(jax.tree_util.register_dataclass, data_fields=["by_name"], meta_fields=["places"])
@dataclasses.dataclass(frozen=True)
class RunValues(Generic[Leaf]):
    """What a run gives to its sweep: all of it, and nothing else, is in the sweep's dataset and store."""

    by_name: dict[str, Leaf]
    places: tuple[Place, ...]  # of each, in the order of the dataset; JAX sorts the names in dictionaries


Chunk: TypeAlias = dict[str, np.ndarray]
"""By name, what the runs of a chunk gave, ``[rows, ...]``."""


@dataclasses.dataclass(frozen=True)
class Job:
    """Runs that differ in their keys and in the values along the axes; see `hrljax.train`."""

    env: AnyEnvironment
    learner: AnyLearner
    params: Numbers
    num_episodes: int
    bin_size: int
    evaluate_every: int | None
    keep_learned: bool
    mapping: batch.Mapping
    first_episode: int = 0
    """Episodes that runs have learned from before they start."""
    num_steps: int | None = None
    measures: tuple[Measure, ...] = ()

    def run(self, row: Rows) -> RunValues[Array]:
        """Trains one run."""
        result = run_once(
            self.env,
            self.learner.replaced(of_learner(row["axes"])),
            jax.random.wrap_key_data(row["key"], impl="threefry2x32"),
            self.num_episodes,
            params=self.params._replace(**of_env(row["axes"])),
            bin_size=self.bin_size,
            evaluate_every=self.evaluate_every,
            start=Start(episodes=self.first_episode, **row["start"]) if "start" in row else None,
            num_steps=self.num_steps,
            measures=self.measures,
            vmapped=self.mapping == "vmap",
        )
        values = {**result.metrics, STEPS: result.step_words}
        places = [*(Place(name, (EPISODE,)) for name in result.metrics), Place(STEPS, ())]
        if self.evaluate_every is not None:
            values["greedy_return"] = result.greedy_return
            places.append(Place("greedy_return", (CHECKPOINT,)))
        for name, leaf in named_leaves(result.learned) if self.keep_learned else ():
            values[name] = leaf
            places.append(Place(name, tuple(f"{name}.{i}" for i in range(leaf.ndim)), is_table=True))
        return RunValues(values, tuple(places))

    def shapes(self, rows: Rows, length: int) -> RunValues[jax.ShapeDtypeStruct]:
        """Shapes and dtypes of what one of the runs gives; `compiled` does not trace it again."""
        chunk = self._mapped().shapes(_shapes_of_chunk(rows, length))
        return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), chunk)

    def compiled(self, rows: Rows, length: int) -> Callable[[Rows], Chunk]:
        """The compiled function of a chunk of `length` rows like `rows`; compiled once per process.

        A keyboard interrupt in the meantime ends the call, and the compilation goes on: the next call waits for it.
        """
        forks.check_not_forked()
        return self._mapped().compiled(_shapes_of_chunk(rows, length))

    def _mapped(self) -> "_Mapped":
        return _mapped(_Frozen(dataclasses.replace(self, mapping=batch.resolve_mapping(self.mapping))))

    def __call__(self, rows: Rows, length: int) -> Chunk:
        """Runs a chunk of rows, computed in one of `length`.

        Args:
            rows: what tells the runs apart.
            length: rows that the compiled function takes.
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

    def __call__(self, rows: Rows, length: int) -> Chunk:
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


def _hashable(value: Any) -> Hashable:
    return float(value) if isinstance(value, np.generic | jax.Array) else value


@lru_cache(maxsize=128)
def _mapped(frozen: _Frozen) -> "_Mapped":
    return _Mapped(frozen.job)


class _Mapped:
    """The runs of a job mapped over rows: for the shapes of a chunk, traced once and compiled once per process."""

    @interrupts.postponed()
    def __init__(self, job: Job):
        assert job.mapping != "auto"
        # Native loops take one run after the other.
        together = learned_bytes(job.env, job.learner) if job.mapping == "vmap" else 0
        group = batch.group_length(together)
        has_loops = job.env.has_loops or job.learner.has_loops
        mapped = batch.compile_mapped(lambda row: job.run(row), job.mapping, has_loops, group)
        self._jitted = cast(jax.stages.Wrapped, mapped)
        self._compilations: dict[str, Future[jax.stages.Compiled]] = {}  # by the shapes
        self._lock = threading.Lock()

    @interrupts.postponed()
    def shapes(self, rows: Rows) -> RunValues[jax.ShapeDtypeStruct]:
        """Of what the runs of a chunk give, for the shapes of its rows."""
        return jax.eval_shape(self._jitted, rows)

    def compiled(self, rows: Rows) -> Callable[[Rows], Chunk]:
        """The function of a chunk, for the shapes of its rows."""
        signature = str(jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), rows))
        with self._lock:
            future = self._compilations.get(signature)
            if future is None or (future.done() and future.exception()):
                with interrupts.postponed():
                    lowered = self._jitted.lower(rows)  # in this thread: some of JAX's settings belong to one
                future = self._compilations[signature] = interrupts.start(lowered.compile)
        compiled = future.result()
        return lambda rows: _on_host(compiled(rows))


def _shapes_of_chunk(rows: Rows, length: int) -> Rows:
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((length, *leaf.shape[1:]), leaf.dtype), rows)


def _on_host(values: RunValues[Array]) -> Chunk:
    """The values of a chunk as NumPy arrays, the steps as numbers."""
    arrays = {name: np.asarray(value) for name, value in values.by_name.items()}
    return arrays | {STEPS: steps_of(arrays[STEPS])}
