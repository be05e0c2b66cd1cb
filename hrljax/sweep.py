"""Many seeds and hyper-parameters in one call, with labelled results."""

from __future__ import annotations

import dataclasses
import itertools
import json
import time
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax import batch, random
from hrljax.envs.base import concrete_params
from hrljax.learners.base import Learner
from hrljax.train import bin_sizes, check_arguments, check_count, default_bin_size, train

if TYPE_CHECKING:
    import xarray as xr

_ENV_PREFIX = "env."


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
    mapping: batch.Mapping = "auto",
    cores: int | None = None,
    chunk_size: int | None = None,
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
        mapping: ``"native"``, ``"vmap"``, or ``"auto"``: the former on CPUs, the latter elsewhere.
        cores: cores to use, all if None.
        chunk_size: runs in a chunk; chosen if None.
        progress: whether to show a progress bar.

    Returns:
        A dataset with dimensions of the axes, then ``seed``, then ``episode`` (the last episode of
        each bin). Variables: ``return``, ``length`` and the environment's events, means per episode
        of the bin; ``steps`` of each run; with `evaluate_every`, ``greedy_return`` over
        ``checkpoint``. Attributes: every setting, the versions, the key, ``seconds``
        (``compile_seconds`` apart) and ``complete``; after a keyboard interrupt the unfinished runs
        are NaN and ``complete`` is 0.

    Raises:
        TypeError, ValueError: a bad argument, before anything is compiled.
    """
    check_arguments(env, learner, num_episodes, bin_size, evaluate_every)
    check_count("seeds", seeds)
    for name, value in (("cores", cores), ("chunk_size", chunk_size)):
        if value is not None:
            check_count(name, value)
    root_key = jax.random.key(_checked_seed(key)) if isinstance(key, int) else key
    random.check_key(root_key)
    params = concrete_params(env.default_params if params is None else params)
    columns = _checked_axes(learner, params, axes or {})
    if evaluate_every is not None and any(name.startswith(_ENV_PREFIX) for name in columns):
        raise ValueError("evaluate_every needs fixed params: it cannot be combined with an axis of the environment")
    bin_size = bin_size or default_bin_size(num_episodes)
    if evaluate_every is not None and evaluate_every > len(bin_sizes(num_episodes, bin_size)):
        raise ValueError(f"evaluate_every must be at most the number of bins, got {evaluate_every}")
    resolved = batch.resolve_mapping(mapping)
    attributes = _attributes(env, learner, params, root_key)

    grid = list(itertools.product(*columns.values()))
    rows = {
        "key": jnp.tile(jax.vmap(partial(jax.random.fold_in, root_key))(jnp.arange(seeds)), len(grid)),
        "axes": {
            name: jnp.repeat(jnp.asarray([p[i] for p in grid], jnp.float32), seeds) for i, name in enumerate(columns)
        },
    }
    started = time.perf_counter()
    length = batch.chunk_length(len(grid) * seeds, cores or batch.usable_cores(), resolved, chunk_size)
    shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct((length, *a.shape[1:]), a.dtype), rows)
    compiled = _compiled(env, _Frozen(learner), params, num_episodes, bin_size, evaluate_every, resolved)(shapes)
    compiled_at = time.perf_counter()
    title = f"{type(learner).__name__} on {env.name}" if progress else None
    results = batch.run_many(compiled, rows, mapping=resolved, cores=cores, chunk_size=length, progress=title)
    seconds = time.perf_counter() - compiled_at

    attributes |= {
        "num_episodes": num_episodes,
        "bin_size": bin_size,
        "mapping": resolved,
        "seconds": seconds,
        "compile_seconds": compiled_at - started,
        "complete": int(results.finished.all()),
    }
    return _dataset(results, columns, seeds, num_episodes, bin_size, evaluate_every, attributes)


class _Frozen:
    """A learner as the key of a cache: equal when its static parts and its plain numbers are."""

    def __init__(self, learner: Learner):
        self.learner = learner
        self._key = (type(learner), tuple((k, _hashable(v)) for k, v in learner.settings().items()))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Frozen) and self._key == other._key


def _hashable(value: Any) -> Any:
    return float(value) if isinstance(value, np.generic | jax.Array) else value


@lru_cache(maxsize=128)
def _compiled(
    env: Any, frozen: _Frozen, params: Any, num_episodes: int, bin_size: int, evaluate_every: int | None, mapping: Any
) -> Callable[[Any], Callable[[Any], Any]]:
    """For shapes of rows: the compiled function of a chunk. Each is compiled once per process."""

    def run(row: dict[str, Any]) -> dict[str, Any]:
        own = {name: value for name, value in row["axes"].items() if not name.startswith(_ENV_PREFIX)}
        of_env = {n.removeprefix(_ENV_PREFIX): v for n, v in row["axes"].items() if n.startswith(_ENV_PREFIX)}
        result = train(
            env,
            frozen.learner.replaced(own),
            row["key"],
            num_episodes,
            params=params._replace(**of_env),
            bin_size=bin_size,
            evaluate_every=evaluate_every,
            lockstep=mapping == "vmap",
        )
        return {"metrics": result.metrics, "greedy_return": result.greedy_return, "steps": result.steps}

    jitted: Any = batch.compile_mapped(run, mapping, env.has_loops)
    by_shape: dict[Any, Any] = {}

    def for_shapes(shapes: Any) -> Any:
        signature = str(jax.tree.map(lambda s: (s.shape, s.dtype), shapes))
        if signature not in by_shape:
            by_shape[signature] = jitted.lower(shapes).compile()
        return by_shape[signature]

    return for_shapes


def _checked_seed(key: int) -> int:
    if isinstance(key, bool) or not 0 <= key < 2**32:
        raise ValueError(f"key must be a new-style key or an integer in [0, 2**32), got {key!r}")
    return key


def _checked_axes(learner: Learner, params: Any, axes: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    """The axes as lists of floats, each value checked as the hyper-parameter would be."""
    of_learner = learner.sweepable()
    of_env = [_ENV_PREFIX + f for f in params._fields if f != "max_steps"]
    columns: dict[str, list[float]] = {}
    for name, values in axes.items():
        if name not in of_learner and name not in of_env:
            known = ", ".join([*of_learner, *of_env])
            raise ValueError(f"axes: {name!r} cannot be swept; sweepable are {known}")
        try:
            columns[name] = [float(v) for v in values]
        except (TypeError, ValueError):
            raise ValueError(f"axes: the values of {name!r} must be a sequence of numbers, got {values!r}") from None
        if not columns[name] or len(set(columns[name])) < len(columns[name]):
            raise ValueError(f"axes: the values of {name!r} must be at least one and different, got {values!r}")
        for value in columns[name]:
            if name in of_learner:
                learner.replaced({name: value})
            else:
                concrete_params(params._replace(**{name.removeprefix(_ENV_PREFIX): value}))
    return columns


def _attributes(env: Any, learner: Learner, params: Any, key: Array) -> dict[str, Any]:
    settings = {f"learner.{name}": _attribute(value) for name, value in learner.settings().items()}
    numbers = {_ENV_PREFIX + name: _attribute(value) for name, value in params._asdict().items()}
    options = {_ENV_PREFIX + f.name: str(getattr(env, f.name)) for f in dataclasses.fields(env)}
    versions = {f"version.{p}": version(p) for p in ("hrljax", "jax", "jaxlib", "numpy", "xarray")}
    return {
        "environment": env.name,
        "learner": learner.name,
        **settings,
        **numbers,
        **options,
        **versions,
        "key": json.dumps(np.asarray(jax.random.key_data(key)).tolist()),
    }


def _attribute(value: Any) -> str | int | float:
    if isinstance(value, np.floating):
        return float(str(value))
    return value if isinstance(value, str | int | float) else repr(value)


def _dataset(
    results: batch.Results,
    columns: dict[str, list[float]],
    seeds: int,
    num_episodes: int,
    bin_size: int,
    evaluate_every: int | None,
    attributes: dict[str, Any],
) -> xr.Dataset:
    import xarray as xr  # here, because importing it takes longer than the rest of hrljax

    shape = (*(len(values) for values in columns.values()), seeds)
    dims = (*columns, "seed")
    last_episode = np.cumsum(bin_sizes(num_episodes, bin_size))

    def labelled(values: np.ndarray, *more: str) -> xr.Variable:
        values = np.array(values, np.float64)
        values[~results.finished] = np.nan
        return xr.Variable((*dims, *more), values.reshape(*shape, *values.shape[1:]))

    variables = {name: labelled(values, "episode") for name, values in results.values["metrics"].items()}
    variables["steps"] = labelled(results.values["steps"])
    coordinates: dict[str, Any] = {**columns, "seed": np.arange(seeds), "episode": last_episode}
    if evaluate_every is not None:
        variables["greedy_return"] = labelled(results.values["greedy_return"], "checkpoint")
        coordinates["checkpoint"] = last_episode[evaluate_every - 1 :: evaluate_every]
    dataset = xr.Dataset(variables, coordinates, attributes)
    dataset["return"].attrs = {"long_name": "return per episode"}
    dataset["length"].attrs = {"long_name": "steps per episode", "units": "steps"}
    dataset["episode"].attrs = {"long_name": "last episode of the bin", "units": "episodes"}
    return dataset
