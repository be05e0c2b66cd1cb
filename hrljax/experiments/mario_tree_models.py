"""Kinds of trees to compare as models of Mario, on the thesis's 27 inputs: Orange's in four readings, and others."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import opaque_zero
from hrljax.learners.relational.learned_model import MarioModel
from hrljax.learners.relational.multiway_model import MultiwayModel, Rows
from hrljax.learners.relational.screen_model import NUM_CHANGES, Foreseen, ModelTables, ScreenModel
from hrljax.trees.classification import ClassificationTrees, Data
from hrljax.trees.inputs import bin_inputs

_CLASSES, _FINENESS = 64, np.float32(8)
"""Classes of a number, each an eighth wide, around 0; the outer two hold all that is beyond them."""
_BINS = 64
_ACTIONS = 9
_LEAST_SCORE = np.float32(1e-4)
_LIKELY = np.float32(0.5)


@dataclass(frozen=True)
class ForestModel(MultiwayModel):
    """The mean of several trees, each fitted to rows drawn with replacement (bagging, Breiman 1996)."""

    num_trees: int = 5

    def fit(self, replay: Rows, num_actions: int) -> Any:
        def one(key: Array) -> Any:
            drawn = jax.random.randint(key, (self.rows + 1,), 0, lax.max(replay.filled, jnp.int32(1)))
            values = replay.values.reshape(self.rows + 1, -1)[drawn]
            return super(ForestModel, self).fit(replay._replace(values=values.ravel()), num_actions)

        return lax.map(one, jax.random.split(jax.random.key(0), self.num_trees))

    def foreseen(self, tables: ModelTables, inputs: Array, last_keys: Array, action: Array) -> Foreseen:
        def one(learned: Any) -> Array:
            foreseen = super(ForestModel, self).foreseen(tables._replace(learned=learned), inputs, last_keys, action)
            return jnp.stack([*foreseen.change, foreseen.reward, jnp.asarray(foreseen.ended, jnp.float32)])

        mean = lax.map(one, tables.learned).mean(axis=0)
        return Foreseen(list(mean[:NUM_CHANGES]), mean[NUM_CHANGES], mean[NUM_CHANGES + 1] > _LIKELY)


class ClassLeaves(NamedTuple):
    """What a `ClassModel` has learned."""

    likeliest: Array  # [nodes of all trees] int32: the class of most rows
    means: Array  # [6 * classes] float32: of what is in a class
    lows: Array  # [cells] float32: where the bins of the inputs begin
    forest: Any


@dataclass(frozen=True)
class ClassModel(MultiwayModel):
    """Classes of changes in place of numbers, as RL-DT has them: a leaf never takes the mean of two changes.

    A tree for every number that a step brings, with the action as an input; velocities are cut into bins (Hester and
    Stone 2009, whose states have few values).
    """

    @property
    def _sizes(self) -> tuple[int, ...]:
        return (*(size or _BINS for size in self.categories), _ACTIONS)

    @cached_property
    def trees(self) -> ClassificationTrees:
        ordered = (*(not size for size in self.categories), False)
        return ClassificationTrees(self._sizes, ordered, (_CLASSES,) * (NUM_CHANGES + 1) + (2,), max_nodes=4095)

    def fit(self, replay: Rows, num_actions: int) -> Any:
        values, trees, f = replay.values.reshape(self.rows + 1, -1)[: self.rows], self.trees, self.num_inputs
        binned = bin_inputs(values[:, : f + 1], replay.filled, (*self.categories, num_actions), _BINS)
        outcomes = values[:, f + 1 : f + 1 + NUM_CHANGES + 2]
        kinds, numbers = _classes(outcomes), np.arange(outcomes.shape[1], dtype=np.int32)[None]
        is_row = (jnp.arange(self.rows) < replay.filled)[:, None]
        # Of a last step nothing but the reward and the end is known.
        is_known = is_row & ((outcomes[:, -1:] == 0) | (numbers >= NUM_CHANGES))
        rows = jnp.arange(self.rows, dtype=jnp.int32)
        counts = jnp.zeros((self.rows, trees.width), jnp.int32)
        places = kinds + np.array(trees.first_class, np.int32)[None]
        counts = counts.at[rows[:, None], places].add(is_known.astype(jnp.int32))
        counts = jnp.append(counts.ravel(), jnp.zeros(trees.most_classes, jnp.int32))
        zero = opaque_zero(lax.bitcast_convert_type(values[0, f + 1], jnp.uint32))
        data = Data(binned.cells.astype(jnp.int32), counts, rows, replay.filled)
        forest = trees.fit(data, jnp.float32(_LEAST_SCORE), zero)
        which = (kinds + numbers * np.int32(_CLASSES)).ravel()
        sums, times = (
            jnp.zeros(outcomes.shape[1] * _CLASSES).at[which].add(jnp.where(is_known, what, 0).ravel())
            for what in (outcomes, jnp.ones_like(outcomes))
        )
        likeliest = jnp.argmax(forest.counts.reshape(-1, trees.most_classes), axis=1).astype(jnp.int32)
        return ClassLeaves(likeliest, sums / lax.max(times, jnp.float32(1)), binned.low, forest)

    def foreseen(self, tables: ModelTables, inputs: Array, last_keys: Array, action: Array) -> Foreseen:
        learned: ClassLeaves = tables.learned
        ends = np.cumsum(self._sizes).tolist()
        bins = zip([*inputs, action.astype(jnp.float32)], [0, *ends], ends, strict=False)
        cells = [
            np.int32(first) + lax.max(jnp.sum(value >= learned.lows[first:end], dtype=jnp.int32) - 1, jnp.int32(0))
            for value, first, end in bins
        ]
        leaves = [self.trees.leaves(learned.forest, kind, jnp.stack(cells)[None])[0] for kind in range(NUM_CHANGES + 2)]
        *change, reward, end = (
            learned.means[learned.likeliest[leaf] + np.int32(kind * _CLASSES)] for kind, leaf in enumerate(leaves)
        )
        return Foreseen(change, reward, end > _LIKELY)


def _classes(outcomes: Array) -> Array:
    """The class of every number ``[N, 6]``; the last one is a class as it is."""
    nearest = jnp.round(outcomes * _FINENESS).astype(jnp.int32) + np.int32(_CLASSES // 2)
    is_end = (np.arange(outcomes.shape[1]) == outcomes.shape[1] - 1)[None]
    return jnp.where(is_end, outcomes.astype(jnp.int32), jnp.clip(nearest, 0, _CLASSES - 1))


MODELS: dict[str, ScreenModel] = {
    **{f"multiway, {reading}": MultiwayModel(reading=reading) for reading in ("A", "B", "C", "D")},
    "binary (CART)": MarioModel(),
    "classes (RL-DT)": ClassModel(),
    "five of A, bagged": ForestModel(),
}
"""By name what is compared."""
