"""The only module that knows of many runs, of cores and of hardware.

A run is a pure function of one set of scalars. `run_many` maps it over rows of such sets: with a
native loop on every core of a CPU, or with `vmap`, where runs take their steps together. What a row
gives does not depend on the mapping, the chunks, the executor or the number of cores, bit for bit.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from itertools import islice
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from tqdm import tqdm

from hrljax.core import checks, interrupts
from hrljax.engine import compiler

Mapping = Literal["auto", "native", "vmap"]
_MAX_CHUNK = {"native": 16, "vmap": 256}
_GROUP, _SMALLEST_GROUP = 64, 8
"""Runs that go together under `vmap` on a CPU at the most; and that fill a register, however large their tables are."""
_GROUP_BYTES = 1 << 23
"""What the tables of such a group may take. Larger ones leave the cache; and XLA counts a table anew for every read of
it, and makes no native function of a loop that touches too much."""
_CHUNKS_OF_A_STORE = 64
_CHUNKS_WITH_AN_EXECUTOR = 256
"""Chunks that an executor of unknown size is given at a time."""


class Results(NamedTuple):
    """Results of many runs."""

    values: Any  # a pytree of NumPy arrays with a leading axis [rows]
    finished: np.ndarray  # [rows] bool: False where a keyboard interrupt came first (values are 0 there)


def resolve_mapping(mapping: Mapping) -> Literal["native", "vmap"]:
    """What a mapping means on this machine.

    Raises:
        ValueError: an unknown mapping.
    """
    checks.choice("mapping", mapping, Mapping)
    if mapping == "vmap" or (mapping == "auto" and jax.default_backend() != "cpu"):
        return "vmap"
    return "native" if compiler.native_loops_available() else "vmap"


def cost_of_loops() -> str:
    """In words, what a turn of a native loop was measured to take."""
    return str(compiler.write_cost()) if compiler.native_loops_available() else "not native"


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compile_mapped(
    function: Callable[[Any], Any], mapping: Literal["native", "vmap"], nested: bool = False, group: int = _GROUP
) -> Callable[[Any], Any]:
    """A jitted function of a chunk of rows. Build it once for a function and keep it.

    `nested` says that its steps hold loops of their own, see `hrljax.engine.compiler.NESTED_OPTIONS`; `group`, how many
    rows go together under `vmap` on a CPU, see `group_length`.
    """
    if mapping == "vmap":
        if jax.default_backend() != "cpu":
            return jax.jit(jax.vmap(function))
        return jax.jit(_in_groups(function, group), compiler_options=dict(compiler.lockstep_options()))
    options = compiler.NESTED_OPTIONS if nested else compiler.OPTIONS
    return jax.jit(lambda rows: lax.map(function, rows), compiler_options=dict(options))


def group_length(table_bytes: int) -> int:
    """How many runs go together under `vmap` on a CPU, whose tables take so many bytes each."""
    return max(_SMALLEST_GROUP, min(_GROUP, _GROUP_BYTES // max(table_bytes, 1)))


def _in_groups(function: Callable[[Any], Any], most: int) -> Callable[[Any], Any]:
    """A function of a row, mapped over the rows of a chunk by `vmap`, at most so many at a time."""

    def mapped(rows: Any) -> Any:
        num_rows = len(jax.tree.leaves(rows)[0])
        groups = -(-num_rows // most)
        if groups == 1:
            return jax.vmap(function)(rows)
        # The last group is filled up with copies of the last row.
        index = np.minimum(np.arange(groups * -(-num_rows // groups)), num_rows - 1).reshape(groups, -1)
        values = lax.map(jax.vmap(function), jax.tree.map(lambda a: a[index], rows))
        return jax.tree.map(lambda a: lax.collapse(a, 0, 2)[:num_rows], values)

    return mapped


def most_at_once(mapping: Literal["native", "vmap"], cores: int | None, num_chunks: int) -> int:
    """Chunks that threads of this process run at a time: one where a chunk fills the device by itself."""
    if mapping == "vmap" and jax.default_backend() != "cpu":
        return 1
    return min(cores or usable_cores(), num_chunks)


def chunk_length(num_rows: int, cores: int, mapping: Literal["native", "vmap"], chunk_size: int | None) -> int:
    """Rows in a chunk: small enough that every core gets several, for progress and Ctrl-C."""
    if chunk_size is not None:
        return min(chunk_size, num_rows)
    if mapping == "native":
        return max(1, min(_MAX_CHUNK[mapping], -(-num_rows // (4 * cores))))
    return max(1, min(_MAX_CHUNK[mapping], num_rows, max(_GROUP, -(-num_rows // cores))))


def portable_chunk_length(num_rows: int, seeds: int, mapping: Literal["native", "vmap"], chunk_size: int | None) -> int:
    """Seeds in a chunk where chunks hold one combination of hyper-parameters, whatever the machine."""
    if chunk_size is not None:
        return min(chunk_size, seeds)
    shares = _CHUNKS_OF_A_STORE if mapping == "native" else 1
    return max(1, min(_MAX_CHUNK[mapping], seeds, -(-num_rows // shares)))


def run_chunk(compiled: Callable[[Any], Any], rows: Any, length: int) -> Any:
    """Runs a chunk of at most `length` rows, filled up with copies of its last row."""
    num_rows = len(jax.tree.leaves(rows)[0])
    index = np.minimum(np.arange(length), num_rows - 1)
    values = compiled(jax.tree.map(lambda a: jnp.asarray(a[index]), rows))
    return jax.tree.map(lambda a: np.asarray(a)[:num_rows], jax.block_until_ready(values))


def chunks_of(num_rows: int, length: int, within: int | None = None) -> list[range]:
    """Consecutive rows in chunks of at most `length`, none of which reaches over a multiple of `within`."""
    within = within or num_rows
    firsts = range(0, num_rows, within)
    return [range(i, min(i + length, first + within)) for first in firsts for i in range(first, first + within, length)]


def run_many(
    run: Callable[..., Any],
    rows: Any,
    *,
    mapping: Literal["native", "vmap"],
    cores: int | None = None,
    chunk_size: int | None = None,
    chunks: Sequence[range] | None = None,
    executor: Executor | None = None,
    collected: "Collected | None" = None,
    keep: Callable[[range, Any], None] | None = None,
    progress: str | None = None,
) -> Results:
    """Runs every row.

    All chunks are computed in one length, so that one compilation serves all. A keyboard interrupt
    ends the work after the chunks that are running and returns what is finished; a second one raises
    at once, and what is running goes on to its end unseen.

    Args:
        run: what `compile_mapped` returned; with an executor, a picklable function of the rows of a
            chunk and of the length to compute it in.
        rows: a pytree of NumPy arrays with a leading axis [rows].
        mapping: the mapping that `run` was made for.
        cores: chunks that run at a time; all usable cores if None. With an executor, the chunks that it is given
            at a time. Elsewhere than on a CPU chunks run one after the other.
        chunk_size: rows in a chunk; chosen if None.
        chunks: the rows of each chunk that is to be computed; all rows in chunks of `chunk_size` if None.
        executor: where chunks are computed; threads of this process if None.
        collected: where values are put; it may hold some already, which `chunks` then leaves out.
        keep: called in this thread with every chunk that is computed, and its values.
        progress: title of the progress bar; none if None.
    """
    rows = jax.tree.map(np.asarray, rows)
    num_rows = len(jax.tree.leaves(rows)[0])
    at_once = most_at_once(mapping, cores, num_rows) if executor is None else cores or _CHUNKS_WITH_AN_EXECUTOR
    length = chunk_length(num_rows, at_once, mapping, chunk_size)
    collected = collected or Collected(num_rows)

    def submit(chunk: range) -> Future[Any]:
        of_chunk = jax.tree.map(lambda a: a[chunk.start : chunk.stop], rows)
        if executor is None:
            return interrupts.start(run_chunk, run, of_chunk, length)
        return executor.submit(run, of_chunk, length)

    with tqdm(
        total=num_rows,
        initial=int(collected.finished.sum()),
        desc=progress,
        unit="run",
        disable=progress is None,
        leave=False,
    ) as bar:

        def consume(chunk: range, values: Any) -> None:
            if keep is not None:
                keep(chunk, values)
            collected.put(chunk, values)
            bar.update(len(chunk))

        todo = chunks_of(num_rows, length) if chunks is None else chunks
        _in_parallel(submit, todo, at_once, consume, queued=executor is not None)
    if collected.values is None:
        raise KeyboardInterrupt
    return Results(collected.values, collected.finished)


class Collected:
    """Values of chunks, put together."""

    def __init__(self, num_rows: int):
        self.values: Any = None
        self.finished = np.zeros(num_rows, np.bool_)

    def put(self, chunk: range, part: Any) -> None:
        if self.values is None:
            self.values = jax.tree.map(lambda a: np.zeros((len(self.finished), *a.shape[1:]), a.dtype), part)
        for whole, leaf in zip(jax.tree.leaves(self.values), jax.tree.leaves(part), strict=True):
            whole[chunk.start : chunk.stop] = leaf
        self.finished[chunk.start : chunk.stop] = True


def _in_parallel(
    submit: Callable[[range], Future[Any]],
    chunks: Iterable[range],
    at_once: int,
    consume: Callable[[range, Any], None],
    queued: bool,
) -> None:
    """Consumes results as they come, with at most `at_once` submitted; stops early on a keyboard interrupt.

    An interrupt within `consume` makes it start again. `queued` says that what is submitted may not
    have begun; then it is cancelled by an interrupt. After an error what has begun is waited for.
    """
    waiting = iter(chunks)
    running = {submit(chunk): chunk for chunk in islice(waiting, at_once)}
    done: set[Future[Any]] = set()
    interrupted = False
    try:
        while running:
            try:
                if not done:
                    done = set(wait(running, return_when=FIRST_COMPLETED).done)
                    if not interrupted:
                        running |= {submit(chunk): chunk for chunk in islice(waiting, len(done))}
                for future in tuple(done):
                    if not future.cancelled():
                        consume(running[future], future.result())
                    done.discard(future)
                    del running[future]
            except KeyboardInterrupt:
                if interrupted:
                    raise
                interrupted = True
                for future in running if queued else ():
                    future.cancel()
    except Exception:
        if not queued:
            wait(running)
        raise
    finally:
        for future in running:
            future.cancel()
