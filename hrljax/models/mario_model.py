"""A learned model of how Mario moves and what he earns, by regression trees (thesis 4.2.3).

Inputs are the tiles around Mario, with the sprites painted over them, and his velocity. For every
action four trees give his displacement and his next velocity; one tree, with the action as another
input, gives the reward. Looking ahead, the model cuts the tiles out of the screen as it is now:
what other things do meanwhile is not modelled.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.envs.mario.competition import COLUMNS, ROWS, Episode, camera_column
from hrljax.envs.mario.course import Course
from hrljax.envs.mario.features import NUM_SYMBOLS, VELOCITY_UNIT, cell, painted, window
from hrljax.envs.mario.state import World
from hrljax.envs.mario.tiles import TILE
from hrljax.models.regression_tree import RegressionTree, Trees, predict

_TARGETS = 4


class Body(NamedTuple):
    """Mario as the model sees him: position and velocity, float32 scalars in pixels and 5 pixels a tick."""

    x: Array
    y: Array  # downwards
    dx: Array
    dy: Array  # downwards


class Replay(NamedTuple):
    """The last N transitions, in a ring; the row after the last is written to where nothing is to be kept."""

    inputs: Array  # [N + 1, F + 1] float32: tiles, velocity, action
    targets: Array  # [N + 1, 4] float32: displacement and next velocity
    reward: Array  # [N + 1] float32
    group: Array  # [N + 1] int32: the action; number of actions if the episode ended, with no next state
    added: Array  # int32: transitions so far


class Learned(NamedTuple):
    """The fitted trees."""

    motion: Trees  # [actions + 1, 4, C]
    reward: Trees  # [1, 1, C]


@dataclass(frozen=True)
class MarioModel:
    """How the model is learned.

    Attributes:
        size: tiles from left to right and from top to bottom around Mario, an odd number.
        rows: N, transitions that are kept and fitted.
        max_depth, min_leaf, num_bins: see `hrljax.models.regression_tree.RegressionTree`.
    """

    size: int = 5
    rows: int = 20_000
    max_depth: int = 12
    min_leaf: int = 5
    num_bins: int = 128

    @property
    def num_inputs(self) -> int:
        return self.size**2 + 2

    @cached_property
    def motion_tree(self) -> RegressionTree:
        return self._tree(())

    def reward_tree(self, num_actions: int) -> RegressionTree:
        return self._tree((num_actions,))

    def _tree(self, more: tuple[int, ...]) -> RegressionTree:
        categories = (NUM_SYMBOLS,) * self.size**2 + (0, 0) + more
        return RegressionTree(categories, self.max_depth, self.min_leaf, self.num_bins)

    def empty(self) -> Replay:
        rows = self.rows + 1
        return Replay(
            inputs=jnp.zeros((rows, self.num_inputs + 1), jnp.float32),
            targets=jnp.zeros((rows, _TARGETS), jnp.float32),
            reward=jnp.zeros(rows, jnp.float32),
            group=jnp.zeros(rows, jnp.int32),
            added=jnp.int32(0),
        )

    def unfitted(self, num_actions: int) -> Learned:
        """Trees that predict 0."""

        def leaves(tree: RegressionTree, *shape: int) -> Trees:
            full = (*shape, tree.capacity(self.rows + 1))
            return Trees(jnp.zeros(full, jnp.int32), jnp.zeros(full, jnp.float32))

        return Learned(leaves(self.motion_tree, num_actions + 1, _TARGETS), leaves(self.reward_tree(num_actions), 1, 1))

    def inputs(self, course: Course, world: World) -> Array:
        """What the model reads of the game, ``[F]`` float32."""
        body = body_of(world)
        return _joined(window(course, world, self.size), body)

    def add(
        self,
        replay: Replay,
        inputs: Array,
        action: Array,
        before: Body,
        after: Body,
        reward: Array,
        terminated: Array,
        num_actions: int,
        live: Array,
    ) -> Replay:
        """Keeps a transition, where `live`. Of a last one only the reward is known."""
        place = lax.select(jnp.asarray(live), replay.added % np.int32(self.rows), jnp.int32(self.rows))
        tile = np.float32(1 / TILE)
        targets = jnp.stack([(after.x - before.x) * tile, (after.y - before.y) * tile, after.dx, after.dy])
        group = lax.select(terminated, jnp.int32(num_actions), action)
        row = jnp.concatenate([inputs, action.astype(jnp.float32)[None]])
        zero = jnp.int32(0)
        return Replay(
            inputs=lax.dynamic_update_slice(replay.inputs, row[None], (place, zero)),
            targets=lax.dynamic_update_slice(replay.targets, targets[None], (place, zero)),
            reward=lax.dynamic_update_slice(replay.reward, reward[None], (place,)),
            group=lax.dynamic_update_slice(replay.group, group[None], (place,)),
            added=replay.added + jnp.asarray(live).astype(jnp.int32),
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

    def look_ahead(self, learned: Learned, course: Course, episode: Episode) -> Any:
        """``model(body, action) -> next_body, reward`` on the screen as it is now, for a planner."""
        margin = self.size // 2
        left, top = camera_column(episode) - np.int32(margin), np.int32(-margin)
        width, height = COLUMNS + 2 * margin, ROWS + 2 * margin
        screen = painted(course, episode.world, left, jnp.int32(top), width, height)
        seen = np.zeros((height, width), np.bool_)
        seen[:, margin : margin + COLUMNS] = True
        screen = jnp.where(seen, screen, 0)

        def model(body: Body, action: Array) -> tuple[Body, Array]:
            column, row = cell(body.x, body.y)
            corner = (row - np.int32(margin) - top, column - np.int32(margin) - left)
            inputs = _joined(lax.dynamic_slice(screen, corner, (self.size, self.size)), body)
            change = [predict(learned.motion, inputs, action, k) for k in range(_TARGETS)]
            with_action = jnp.concatenate([inputs, action.astype(jnp.float32)[None]])
            reward = predict(learned.reward, with_action, 0, 0)
            tile = np.float32(TILE)
            after = Body(body.x + change[0] * tile, body.y + change[1] * tile, change[2], change[3])
            return after, reward

        return model


def body_of(world: World) -> Body:
    """Mario's position and the velocity that the competition shows."""
    player, unit = world.player, np.float32(1 / VELOCITY_UNIT)
    return Body(player.x, player.y, (player.x - player.x_old) * unit, (player.y - player.y_old) * unit)


def _joined(tiles: Array, body: Body) -> Array:
    return jnp.concatenate([tiles.ravel().astype(jnp.float32), jnp.stack([body.dx, body.dy])])
