"""Where a run begins that goes on from what was learned before."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import chex
import jax
import numpy as np
from jax.core import Tracer

from hrljax.core import checks
from hrljax.envs.base import AnyEnvironment
from hrljax.learners.base import AnyLearner

LEARNED = "learned"
"""Name of a learner's tables, and first part of the names of each."""


class Start(NamedTuple):
    """What a run goes on from."""

    learned: chex.ArrayTree  # the learner's tables
    episodes: Any  # int32: episodes that they were learned from; schedules are read from there on
    step_words: Any  # [2] uint32: primitive steps of these episodes, the low and the high half of 64 bits


@runtime_checkable
class Startable(Protocol):
    """What `hrljax.train` can start from: a `hrljax.Run` or a `hrljax.Learned`."""

    def as_start(self) -> Start: ...


def checked_start(start: object, env: AnyEnvironment, learner: AnyLearner, num_episodes: int) -> Start:
    """Where a run of `learner` on `env` begins, for `start` as of `hrljax.train`.

    Raises:
        TypeError: `start` is nothing to start from.
        ValueError: it holds other tables, or too many episodes.
    """
    if isinstance(start, Startable) and not isinstance(start, type):
        start = start.as_start()
    if not isinstance(start, Start):
        raise TypeError(f"start must be what hrljax.train returned or a hrljax.Learned, got {checks.described(start)}")
    expected = described(learned_shapes(env, learner))
    if described(start.learned) != expected:
        raise ValueError(
            f"start must hold the tables of one run of {learner.name} on {env.name}, {expected}; "
            f"it has {described(start.learned)}"
        )
    if not isinstance(start.episodes, Tracer) and int(start.episodes) + num_episodes >= 2**31:
        raise ValueError(f"start: {int(start.episodes)} episodes before and {num_episodes} more must be below 2**31")
    return start


def step_words(steps: Any) -> np.ndarray:
    """Numbers of steps (int64, any shape) as ``[..., 2]`` uint32: the low half and the high one."""
    steps = np.asarray(steps, np.int64)
    return np.stack([steps & 0xFFFFFFFF, steps >> 32], -1).astype(np.uint32)


def steps_of(words: Any) -> Any:
    """The way back from `step_words`."""
    low, high = np.moveaxis(np.asarray(words), -1, 0).astype(np.int64)
    return low + (high << 32)


def named_leaves(learned: chex.ArrayTree) -> Iterable[tuple[str, Any]]:
    """The leaves of a learner's tables with names such as ``"learned.root.model"``."""
    return [
        (LEARNED + jax.tree_util.keystr(path), leaf)
        for path, leaf in jax.tree_util.tree_flatten_with_path(learned)[0]
        if leaf.size
    ]


def tree_of(learned: chex.ArrayTree, named: dict[str, np.ndarray], rows: tuple[int, ...] = ()) -> Any:
    """Tables like `learned` with the leaves of given names, the way back from `named_leaves`.

    Args:
        learned: tables, or their shapes.
        named: leaves by name; leaves without entries need not be among them.
        rows: shape that each of `named` has before its own.

    Raises:
        ValueError: a leaf is missing.
    """
    leaves, structure = jax.tree_util.tree_flatten_with_path(learned)
    names = [LEARNED + jax.tree_util.keystr(path) for path, _ in leaves]
    missing = [name for name, (_, leaf) in zip(names, leaves, strict=True) if leaf.size and name not in named]
    if missing:
        raise ValueError(f"the tables {', '.join(missing)} are missing; there are {sorted(named)}")
    empty = (np.zeros((*rows, *leaf.shape), leaf.dtype) for _, leaf in leaves)
    values = [named.get(name, leaf) for name, leaf in zip(names, empty, strict=True)]
    return jax.tree_util.tree_unflatten(structure, values)


def learned_shapes(env: AnyEnvironment, learner: AnyLearner) -> chex.ArrayTree:
    """Shapes and types of a learner's tables, as a tree of `jax.ShapeDtypeStruct`."""
    prepared = learner.prepare(env)
    return jax.eval_shape(lambda: learner.init(env, prepared).tables)


def learned_bytes(env: AnyEnvironment, learner: AnyLearner) -> int:
    """What a learner's tables take in memory."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(learned_shapes(env, learner)))


def described(tables: chex.ArrayTree) -> str:
    """Names, dtypes and shapes of tables."""
    return ", ".join(f"{name}: {leaf.dtype}{list(leaf.shape)}" for name, leaf in named_leaves(tables))
