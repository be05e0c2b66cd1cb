"""A learned model of how Mario moves and what he earns, by binary regression trees (thesis 4.2.3).

Inputs are the tiles around Mario, with the sprites painted over them, and his velocity. For every
action four trees give his displacement and his next velocity; one tree, with the action as another
input, gives the reward.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.counting import one_more
from hrljax.learners.relational.screen_model import NUM_CHANGES, Experience, Foreseen, ModelTables, ScreenModel
from hrljax.trees.inputs import MAX_BINS
from hrljax.trees.regression_tree import MAX_DEPTH, Descent, RegressionTree, Trees, predict_all
from hrljax.trees.rows import MAX_ROWS


class Replay(NamedTuple):
    """The last N transitions, in a ring; the row after the last is written to where nothing is to be kept."""

    inputs: Array  # [N + 1, F + 1] float32: tiles, velocity, action
    targets: Array  # [N + 1, 4] float32: displacement and next velocity
    reward: Array  # [N + 1] float32
    group: Array  # [N + 1] int32: the action; number of actions if the episode ended, with no next state
    added: Array  # int32: transitions so far, see `one_more`


class Learned(NamedTuple):
    """The fitted trees."""

    motion: Trees  # [actions + 1, 4, C]
    reward: Trees  # [1, 1, C]


@dataclass(frozen=True)
class MarioModel(ScreenModel):
    """Binary trees, fitted to the last transitions.

    Attributes:
        max_depth, min_leaf, num_bins: see `hrljax.trees.regression_tree.RegressionTree`; the others are
            `ScreenModel`'s.
    """

    max_depth: int = 12
    min_leaf: int = 5
    num_bins: int = 128

    def __post_init__(self) -> None:
        super().__post_init__()
        for option, least, most in (("max_depth", 1, MAX_DEPTH), ("min_leaf", 1, MAX_ROWS), ("num_bins", 2, MAX_BINS)):
            self._check_integer(option, least, most)

    @cached_property
    def motion_tree(self) -> RegressionTree:
        return self._tree(())

    def reward_tree(self, num_actions: int) -> RegressionTree:
        return self._tree((num_actions,))

    def _tree(self, more: tuple[int, ...]) -> RegressionTree:
        return RegressionTree(self.categories + more, self.max_depth, self.min_leaf, self.num_bins)

    def empty(self, num_actions: int) -> Replay:
        rows = self.rows + 1
        return Replay(
            inputs=jnp.zeros((rows, self.num_inputs + 1), jnp.float32),
            targets=jnp.zeros((rows, NUM_CHANGES), jnp.float32),
            reward=jnp.zeros(rows, jnp.float32),
            group=jnp.zeros(rows, jnp.int32),
            added=jnp.int32(0),
        )

    def unfitted(self, num_actions: int) -> Learned:
        """Trees that predict 0."""

        def leaves(tree: RegressionTree, *shape: int) -> Trees:
            full = (*shape, tree.capacity(self.rows + 1))
            return Trees(jnp.zeros(full, jnp.int32), jnp.zeros(full, jnp.float32))

        return Learned(
            leaves(self.motion_tree, num_actions + 1, NUM_CHANGES), leaves(self.reward_tree(num_actions), 1, 1)
        )

    def add(self, replay: Replay, new: Experience, num_actions: int, learns: Array) -> Replay:
        """Keeps a transition, where `learns`. Of a last one only the reward is known."""
        place = lax.select(jnp.asarray(learns), replay.added % np.int32(self.rows), jnp.int32(self.rows))
        group = lax.select(new.terminated, jnp.int32(num_actions), new.action)
        row = jnp.concatenate([new.inputs, new.action.astype(jnp.float32)[None]])
        zero = jnp.int32(0)
        return Replay(
            inputs=lax.dynamic_update_slice(replay.inputs, row[None], (place, zero)),
            targets=lax.dynamic_update_slice(replay.targets, new.change[None], (place, zero)),
            reward=lax.dynamic_update_slice(replay.reward, new.reward[None], (place,)),
            group=lax.dynamic_update_slice(replay.group, group[None], (place,)),
            added=one_more(replay.added, self.rows, jnp.asarray(learns)),
        )

    def fit(self, replay: Replay, num_actions: int) -> Learned:
        """Grows all trees anew from what is kept."""
        count = lax.min(replay.added, jnp.int32(self.rows))
        motion = self.motion_tree.fit_groups(
            replay.inputs[:, :-1], replay.targets, replay.group, num_actions + 1, count
        )
        everything = jnp.zeros_like(replay.group)
        reward = self.reward_tree(num_actions).fit_groups(replay.inputs, replay.reward[:, None], everything, 1, count)
        return Learned(motion, reward)

    def foreseen(self, tables: ModelTables, inputs: Array, last_keys: Array, action: Array) -> Foreseen:
        learned: Learned = tables.learned
        motion = [Descent(learned.motion, inputs, (action, k)) for k in range(NUM_CHANGES)]
        with_action = jnp.concatenate([inputs, action.astype(jnp.float32)[None]])
        *change, reward = predict_all([*motion, Descent(learned.reward, with_action, (0, 0))])
        return Foreseen(change, reward, False)
