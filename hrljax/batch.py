"""The only module that knows of many runs, of cores and of hardware.

A run is a pure function of one set of scalars. `run_many` maps it over rows of such sets: with a
native loop on every core of a CPU, or with `vmap` on an accelerator. What a row gives does not
depend on the mapping, the chunks or the number of cores, bit for bit.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import islice
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from tqdm import tqdm

from hrljax import xla

Mapping = Literal["auto", "native", "vmap"]
_MAX_CHUNK = {"native": 16, "vmap": 256}


class Results(NamedTuple):
    """Results of many runs."""

    values: Any  # a pytree of NumPy arrays with a leading axis [rows]
    finished: np.ndarray  # [rows] bool: False where a keyboard interrupt came first (values are 0 there)


def resolve_mapping(mapping: Mapping) -> Literal["native", "vmap"]:
    """What a mapping means on this machine.

    Raises:
        ValueError: an unknown mapping.
    """
    if mapping not in get_args(Mapping):
        raise ValueError(f"mapping must be one of {', '.join(map(repr, get_args(Mapping)))}, got {mapping!r}")
    if mapping == "vmap" or (mapping == "auto" and jax.default_backend() != "cpu"):
        return "vmap"
    return "native" if xla.native_loops_available() else "vmap"


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compile_mapped(
    function: Callable[[Any], Any], mapping: Literal["native", "vmap"], nested: bool = False
) -> Callable[[Any], Any]:
    """A jitted function of a chunk of rows. Build it once for a function and keep it.

    `nested` says that its steps hold loops of their own, see `hrljax.xla.NESTED_OPTIONS`.
    """
    if mapping == "vmap":
        return jax.jit(jax.vmap(function))
    options = xla.NESTED_OPTIONS if nested else xla.OPTIONS
    return jax.jit(lambda rows: lax.map(function, rows), compiler_options=dict(options))


def chunk_length(num_rows: int, cores: int, mapping: Literal["native", "vmap"], chunk_size: int | None) -> int:
    """Rows in a chunk: small enough that every core gets several, for progress and Ctrl-C."""
    if chunk_size is not None:
        return min(chunk_size, num_rows)
    shares = 4 * cores if mapping == "native" else 1
    return max(1, min(_MAX_CHUNK[mapping], -(-num_rows // shares)))


def run_many(
    compiled: Callable[[Any], Any],
    rows: Any,
    *,
    mapping: Literal["native", "vmap"],
    cores: int | None = None,
    chunk_size: int | None = None,
    progress: str | None = None,
) -> Results:
    """Runs every row.

    All chunks have one length, the last filled up with copies of its last row, so that one
    compilation serves all. A keyboard interrupt ends the work after the chunks that are running
    and returns what is finished; a second one raises.

    Args:
        compiled: what `compile_mapped` returned.
        rows: a pytree of arrays with a leading axis [rows].
        mapping: the mapping that `compiled` was made for.
        cores: chunks that run at a time; all usable cores if None. One under `vmap`, which spreads
            a chunk over cores by itself.
        chunk_size: rows in a chunk; chosen if None.
        progress: title of the progress bar; none if None.
    """
    num_rows = len(jax.tree.leaves(rows)[0])
    cores = 1 if mapping == "vmap" else min(cores or usable_cores(), num_rows)
    length = chunk_length(num_rows, cores, mapping, chunk_size)
    finished = np.zeros(num_rows, np.bool_)
    values: Any = None

    def run(start: int) -> tuple[int, Any]:
        index = np.minimum(np.arange(start, start + length), num_rows - 1)
        chunk = jax.tree.map(lambda a: a[jnp.asarray(index)], rows)
        return start, jax.tree.map(np.asarray, jax.block_until_ready(compiled(chunk)))

    with tqdm(total=num_rows, desc=progress, unit="run", disable=progress is None, leave=False) as bar:
        for start, chunk in _in_parallel(run, range(0, num_rows, length), cores):
            stop = min(start + length, num_rows)
            if values is None:
                values = jax.tree.map(lambda a: np.zeros((num_rows, *a.shape[1:]), a.dtype), chunk)
            for whole, part in zip(jax.tree.leaves(values), jax.tree.leaves(chunk), strict=True):
                whole[start:stop] = part[: stop - start]
            finished[start:stop] = True
            bar.update(stop - start)
    if values is None:
        raise KeyboardInterrupt
    return Results(values, finished)


def _in_parallel(run: Callable[[int], Any], starts: range, cores: int) -> Iterator[Any]:
    """Results of `run` as they come, at most `cores` at a time; stops early on a keyboard interrupt."""
    waiting = iter(starts)
    with ThreadPoolExecutor(cores) as pool:
        running: set[Future[Any]] = {pool.submit(run, start) for start in islice(waiting, cores)}
        interrupted = False
        while running:
            done: set[Future[Any]] = set()
            try:
                done, running = wait(running, return_when=FIRST_COMPLETED)
                if not interrupted:
                    running |= {pool.submit(run, start) for start in islice(waiting, len(done))}
            except KeyboardInterrupt:
                if interrupted:
                    raise
                interrupted = True
            for future in done:
                yield future.result()
