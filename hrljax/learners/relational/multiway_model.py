"""A learned model of Mario by multiway regression trees, as Orange 2 grew them (thesis 4.2.3).

For every action one tree gives Mario's displacement and next velocity together; two trees, with the action as another
input, give the reward and whether the episode ends. Trees are grown out from all transitions, equal ones kept as one
row with a weight.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import put_row, take, take_row
from hrljax.learners.relational.screen_model import NUM_CHANGES, Experience, Foreseen, ScreenModel
from hrljax.learners.relational.visited import mixed
from hrljax.trees.multiway import READINGS, MultiwayTree, MultiwayTrees, predict

Reading = Literal["A", "B", "C", "D"]
_PLACE_BITS = 19
"""Of the table of rows; two rows may share a place in it: then equal ones can be kept as several rows."""
_LIKELY = np.float32(0.5)


class Rows(NamedTuple):
    """Different transitions, and how often each was met; the row after the last is written to where nothing is kept."""

    values: Array  # [(N + 1) * width] float32: inputs, action, change, reward, whether it was the last one
    weights: Array  # [N + 1] float32
    places: Array  # [2^19] int32: by a hash, the number of a row with it
    filled: Array  # int32: rows so far


class Learned(NamedTuple):
    """The fitted trees."""

    motion: MultiwayTrees  # a tree for each action
    reward: MultiwayTrees
    end: MultiwayTrees


@dataclass(frozen=True)
class MultiwayModel(ScreenModel):
    """Multiway trees, fitted to all different transitions, which foresee ends.

    Attributes:
        reading: how trees are grown, see `hrljax.trees.multiway.READINGS`.
        rows: N, different transitions that are kept; those that come after them are forgotten.
    """

    rows: int = 60_000
    reading: Reading = "A"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_choice("reading", Reading)

    @cached_property
    def motion_tree(self) -> MultiwayTree:
        return MultiwayTree(self.categories, **READINGS[self.reading])

    def outcome_tree(self, num_actions: int) -> MultiwayTree:
        """Of the reward and of the end."""
        return MultiwayTree((*self.categories, num_actions), **READINGS[self.reading])

    @property
    def _width(self) -> int:
        return self.num_inputs + 1 + NUM_CHANGES + 2

    def empty(self, num_actions: int) -> Rows:
        rows = self.rows + 1
        return Rows(
            values=jnp.zeros(rows * self._width, jnp.float32),
            weights=jnp.zeros(rows, jnp.float32),
            places=jnp.full(1 << _PLACE_BITS, self.rows, jnp.int32),
            filled=jnp.int32(0),
        )

    def unfitted(self, num_actions: int) -> Learned:
        """Trees that predict 0."""
        outcome = self.outcome_tree(num_actions).unfitted(self.rows, 1)
        return Learned(self.motion_tree.unfitted(self.rows, NUM_CHANGES, num_actions + 1), outcome, outcome)

    def add(self, replay: Rows, new: Experience, num_actions: int, learns: Array) -> Rows:
        """Counts a transition, where `learns`. Of a last one there is no change."""
        change = jnp.where(new.terminated, np.float32(0), new.change)
        end = new.terminated.astype(jnp.float32)
        others = jnp.stack([new.action.astype(jnp.float32), *change, new.reward, end])
        row = jnp.concatenate([new.inputs, others])
        bits = lax.bitcast_convert_type(row + np.float32(0), jnp.int32)
        place = mixed(bits, _PLACE_BITS)
        known, width = take(replay.places, place), np.int32(self._width)
        is_known = jnp.all(take_row(replay.values, known * width, self._width) == row) & (known < self.rows)
        number = lax.select(is_known, known, lax.min(replay.filled, jnp.int32(self.rows)))
        number = lax.select(jnp.asarray(learns), number, jnp.int32(self.rows))
        is_new = jnp.asarray(learns) & ~is_known & (replay.filled < self.rows)
        weight = take(replay.weights, number) + np.float32(1)
        return Rows(
            values=put_row(replay.values, number * width, row),
            weights=put_row(replay.weights, number, weight[None]),
            places=put_row(replay.places, place, lax.select(is_new, number, known)[None]),
            filled=replay.filled + is_new.astype(jnp.int32),
        )

    def fit(self, replay: Rows, num_actions: int) -> Learned:
        values = replay.values.reshape(-1, self._width)[: self.rows]
        weights, count, f = replay.weights[: self.rows], replay.filled, self.num_inputs
        inputs, with_action = values[:, :f], values[:, : f + 1]
        change, reward, end = values[:, f + 1 : -2], values[:, -2:-1], values[:, -1:]
        action = with_action[:, f].astype(jnp.int32)
        group = jnp.where(end[:, 0] > 0, np.int32(num_actions), action)
        tree = self.outcome_tree(num_actions)
        return Learned(
            motion=self.motion_tree.fit(inputs, change, weights, group, num_actions + 1, count),
            reward=tree.fit(with_action, reward, weights, count=count),
            end=tree.fit(with_action, end, weights, count=count),
        )

    def foreseen(self, learned: Learned, inputs: Array, action: Array) -> Foreseen:
        with_action = jnp.concatenate([inputs, action.astype(jnp.float32)[None]])
        change = predict(learned.motion, inputs, action)
        reward, end = (predict(trees, with_action)[0] for trees in (learned.reward, learned.end))
        return Foreseen(list(change), reward, end > _LIKELY)
