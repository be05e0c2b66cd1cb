"""What a sweep is asked for: its arguments, once they are found to be fine, and what follows from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from hrljax.core import checks, interrupts, random
from hrljax.core.environment import Numbers
from hrljax.engine import batch
from hrljax.engine.run import bin_sizes, default_bin_size
from hrljax.engine.start import Startable
from hrljax.engine.train import check_arguments, checked_steps
from hrljax.envs.base import AnyEnvironment, numbers_of
from hrljax.envs.checks import check_before_training
from hrljax.learners.base import AnyLearner
from hrljax.learners.measured import Measure, checked_measures
from hrljax.sweeps import fingerprint
from hrljax.sweeps.axes import Points, checked_axes, of_env
from hrljax.sweeps.continuation import NUM_STEPS, Continuation, continuation
from hrljax.sweeps.job import CHECKPOINT, EPISODE, Job, Rows
from hrljax.sweeps.schema import Grid, Schema, variables_of
from hrljax.sweeps.versions import Attributes

if TYPE_CHECKING:
    import xarray as xr


@jax.jit
def _seed_words(key: Array, seeds: Array) -> Array:
    """``[seeds, 2]`` uint32: the words of the key of each seed."""
    return jax.random.key_data(jax.vmap(partial(jax.random.fold_in, key))(seeds))


@dataclasses.dataclass(frozen=True)
class SweepRequest:
    """Which runs a sweep consists of. Made by `checked`."""

    job: Job  # what every run does
    grid: Grid  # which runs there are
    key: Array
    start: Continuation | None

    @classmethod
    @interrupts.postponed()
    def checked(
        cls,
        env: AnyEnvironment,
        learner: AnyLearner,
        *,
        seeds: int,
        num_episodes: int,
        axes: Mapping[str, Sequence[float]] | Points | None,
        key: Array | int,
        params: Numbers | None,
        bin_size: int | None,
        evaluate_every: int | None,
        keep_learned: bool,
        mapping: batch.Mapping,
        start: xr.Dataset | Startable | None = None,
        num_steps: int | None = None,
        measures: Sequence[Measure] = (),
    ) -> SweepRequest:
        """The request with these arguments of `hrljax.sweep`.

        Raises:
            TypeError, ValueError: a bad argument.
        """
        num_episodes, bin_size, evaluate_every = check_arguments(env, learner, num_episodes, bin_size, evaluate_every)
        seeds = checks.integer("seeds", seeds, 1)
        keep_learned = checks.flag("keep_learned", keep_learned)
        root_key = random.as_key(key)
        numbers = numbers_of(env, params)
        if any(isinstance(value, Tracer) for value in (root_key, *numbers, *learner.settings().values())):
            raise TypeError(
                "a sweep compiles and maps its runs itself, so jax.jit and jax.vmap cannot trace it; map train"
            )
        grid = Grid(checked_axes(learner, numbers, axes), seeds, isinstance(axes, Points))
        if evaluate_every is not None and of_env(grid.axes):
            raise ValueError("evaluate_every needs fixed params: it cannot be combined with an axis of the environment")
        check_before_training(env, numbers, grid.settings_of_env())
        bin_size = bin_size or default_bin_size(num_episodes)
        if evaluate_every is not None and evaluate_every > len(bin_sizes(num_episodes, bin_size)):
            raise ValueError(f"evaluate_every must be at most the number of bins, got {evaluate_every}")
        batch.resolve_mapping(mapping)
        job = Job(env, learner, numbers, num_episodes, bin_size, evaluate_every, keep_learned, mapping)
        job = dataclasses.replace(job, num_steps=checked_steps(num_steps), measures=checked_measures(measures))
        if start is None:
            return cls(job, grid, root_key, None)
        begin = continuation(start, env, learner, grid, num_episodes)
        return cls(dataclasses.replace(job, first_episode=begin.episodes), grid, root_key, begin)

    @property
    def mapping(self) -> Literal["native", "vmap"]:
        """What the job's mapping means on this machine."""
        return batch.resolve_mapping(self.job.mapping)

    @cached_property
    @interrupts.postponed()
    def rows(self) -> Rows:
        """What tells the runs apart."""
        seeds, combinations = self.grid.seeds, np.array(self.grid.combinations, np.float32)
        words = _seed_words(self.key, jnp.arange(seeds))
        rows: Rows = {
            "key": np.tile(np.asarray(words), (len(combinations), 1)),
            "axes": {name: np.repeat(combinations[:, i], seeds) for i, name in enumerate(self.grid.axes)},
        }
        if self.start is not None:
            rows["start"] = self.start.rows
        return rows

    def chunks(self, cores: int | None, chunk_size: int | None, portable: bool) -> tuple[int, list[range]]:
        """The most runs in a chunk, and the runs of each.

        Portable chunks hold one combination of hyper-parameters and are the same on every machine.
        """
        num_runs, seeds = self.grid.num_runs, self.grid.seeds
        if portable:
            length = batch.portable_chunk_length(num_runs, seeds, self.mapping, chunk_size)
            return length, batch.chunks_of(num_runs, length, within=seeds)
        at_once = batch.most_at_once(self.mapping, cores, num_runs)
        length = batch.chunk_length(num_runs, at_once, self.mapping, chunk_size)
        return length, batch.chunks_of(num_runs, length)

    def schema(self, length: int) -> Schema:
        """Names and places of the values, of what a run gives: it is traced here, in chunks of `length` runs.

        Where the sweep is compiled in this process, for the same `length`, this takes no time of its own.
        """
        ends = np.cumsum(bin_sizes(self.job.num_episodes, self.job.bin_size)) + self.job.first_episode
        coordinates, every = {EPISODE: ends}, self.job.evaluate_every
        if every is not None:
            coordinates[CHECKPOINT] = ends[every - 1 :: every]
        return Schema(self.grid, coordinates, variables_of(self.job.shapes(self.rows, length)))

    @property
    def attributes(self) -> Attributes:
        """Of the dataset: every setting."""
        job = self.job
        return {
            **fingerprint.attributes(job.env, job.learner, job.params, self.key, self.grid.axes),
            "num_episodes": job.num_episodes,
            "bin_size": job.bin_size,
            **({} if job.num_steps is None else {NUM_STEPS: job.num_steps}),
            **({"measures": ", ".join(job.measures)} if job.measures else {}),
            **({} if self.start is None else self.start.attributes()),
        }

    @cached_property
    def identity(self) -> Attributes:
        """What a store of this sweep has to agree with: the attributes, and digests of what they do not tell."""
        job = self.job
        return {
            **self.attributes,
            "evaluate_every": job.evaluate_every or 0,
            "keep_learned": int(job.keep_learned),
            **self.grid.attributes,
            **({} if self.start is None else {"digest.start": self.start.digest()}),
            **fingerprint.digests(job.env, job.learner, job.first_episode + job.num_episodes),
        }
