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

from hrljax.core import checks
from hrljax.core.counting import one_more
from hrljax.envs.mario.competition import COLUMNS, ROWS, Episode, camera_column
from hrljax.envs.mario.engine.course import Course
from hrljax.envs.mario.engine.state import World
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.features import NUM_SYMBOLS, VELOCITY_UNIT, cell, painted, window
from hrljax.envs.mario.levels.tiles import HEIGHT, TILE
from hrljax.learners.base import Transition
from hrljax.learners.relational.visited import is_met, mark, nothing_met
from hrljax.search.best_first import ModelFn
from hrljax.trees.inputs import MAX_BINS
from hrljax.trees.regression_tree import MAX_DEPTH, MAX_ROWS, RegressionTree, Trees, predict

_TARGETS = 4
_LARGEST_SIZE = 11
"""With more tiles there would be more inputs than a tree takes."""
_BELOW = np.int32(NUM_SYMBOLS)
"""The symbol of a cell below the level, for a model that knows it."""
_ROUNDED_TO = np.float32(32)
"""Velocities and places in a tile count as met to a 32nd."""


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
    added: Array  # int32: transitions so far, see `one_more`


class Learned(NamedTuple):
    """The fitted trees."""

    motion: Trees  # [actions + 1, 4, C]
    reward: Trees  # [1, 1, C]


class ModelTables(NamedTuple):
    """What a `MarioModel` has learned."""

    replay: Replay
    learned: Learned
    met: Any  # which inputs and actions have been met, see `hrljax.learners.relational.visited`; () without pessimism


@dataclass(frozen=True)
class MarioModel:
    """How the model is learned.

    Attributes:
        size: tiles from left to right and from top to bottom around Mario, an odd number up to 11.
        offsets: whether Mario's place within his tile is an input too, in x and y.
        below: whether what lies below the level is a tile of its own; if not, the level goes on.
        rows: N, transitions that are kept and fitted.
        max_depth, min_leaf, num_bins: see `hrljax.trees.regression_tree.RegressionTree`.
        pessimism: taken off the predicted reward of a step whose inputs, numbers rounded to a 32nd,
            have not been met with its action (as Kidambi et al. 2020 do).

    Raises:
        TypeError, ValueError: an attribute is of the wrong kind or out of range.
    """

    size: int = 5
    offsets: bool = False
    below: bool = False
    rows: int = 20_000
    max_depth: int = 12
    min_leaf: int = 5
    num_bins: int = 128
    pessimism: float = 0.0

    def __post_init__(self) -> None:
        for option, least, most in (
            ("rows", 1, MAX_ROWS),
            ("max_depth", 1, MAX_DEPTH),
            ("min_leaf", 1, MAX_ROWS),
            ("num_bins", 2, MAX_BINS),
        ):
            self._set(option, checks.integer(f"MarioModel: {option}", getattr(self, option), least, most))
        self._set("size", checks.odd("MarioModel: size", self.size, _LARGEST_SIZE))
        for option in ("offsets", "below"):
            checks.flag(f"MarioModel: {option}", getattr(self, option))
        self._set("pessimism", checks.number("MarioModel: pessimism", self.pessimism, checks.NOT_NEGATIVE))

    def _set(self, option: str, value: Any) -> None:
        object.__setattr__(self, option, value)

    @property
    def num_inputs(self) -> int:
        return self.size**2 + (4 if self.offsets else 2)

    @cached_property
    def motion_tree(self) -> RegressionTree:
        return self._tree(())

    def reward_tree(self, num_actions: int) -> RegressionTree:
        return self._tree((num_actions,))

    def _tree(self, more: tuple[int, ...]) -> RegressionTree:
        tiles = self.size**2
        categories = (NUM_SYMBOLS + self.below,) * tiles + (0,) * (self.num_inputs - tiles) + more
        return RegressionTree(categories, self.max_depth, self.min_leaf, self.num_bins)

    def init(self, env: Mario) -> ModelTables:
        met = nothing_met() if self.pessimism else ()
        return ModelTables(self.empty(), self.unfitted(env.num_actions), met)

    def observe(self, env: Mario, tables: ModelTables, transition: Transition, learns: Array) -> ModelTables:
        """Keeps a transition for the next fit, where `learns`."""
        before, after = transition.state.world, transition.next_state.world
        inputs, met = self.inputs(env.course, before), tables.met
        if self.pessimism:
            met = mark(met, self._rounded(inputs, transition.action), learns)
        replay = self.add(
            tables.replay,
            inputs,
            transition.action,
            body_of(before),
            body_of(after),
            transition.reward,
            transition.terminated,
            env.num_actions,
            learns,
        )
        return tables._replace(replay=replay, met=met)

    def refit(self, env: Mario, tables: ModelTables) -> ModelTables:
        """Fits the trees to what is kept."""
        return tables._replace(learned=self.fit(tables.replay, env.num_actions))

    def planned(self, env: Mario, tables: ModelTables, episode: Episode) -> tuple[ModelFn, Body]:
        """What a planner searches from a moment of an episode: the model, and the state to start in."""
        return self.look_ahead(tables.learned, env.course, episode, tables.met), body_of(episode.world)

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
        _, row = cell(body.x, body.y)
        return self._joined(self._marked(window(course, world, self.size), row - np.int32(self.size // 2)), body)

    def _marked(self, tiles: Array, top: Array) -> Array:
        """A part of the screen, its first row being `top`, with what lies below the level as a kind of its own."""
        if not self.below:
            return tiles
        rows = top + np.arange(len(tiles), dtype=np.int32)
        return jnp.where(rows[:, None] < HEIGHT, tiles, _BELOW)

    def _joined(self, tiles: Array, body: Body) -> Array:
        numbers = [body.dx, body.dy]
        if self.offsets:
            column, row = cell(body.x, body.y)
            tile = np.float32(1 / TILE)
            numbers += [body.x * tile - column.astype(jnp.float32), body.y * tile - row.astype(jnp.float32)]
        return jnp.concatenate([tiles.ravel().astype(jnp.float32), jnp.stack(numbers)])

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
        learns: Array,
    ) -> Replay:
        """Keeps a transition, where `learns`. Of a last one only the reward is known."""
        place = lax.select(jnp.asarray(learns), replay.added % np.int32(self.rows), jnp.int32(self.rows))
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

    def _rounded(self, inputs: Array, action: Array) -> Array:
        """Inputs and action as whole numbers, int32 ``[F + 1]``."""
        is_tile = np.arange(self.num_inputs) < self.size**2
        steps = np.where(is_tile, np.float32(1), _ROUNDED_TO)
        return jnp.append(jnp.round(inputs * steps).astype(jnp.int32), action)

    def look_ahead(self, learned: Learned, course: Course, episode: Episode, met: Any = ()) -> Any:
        """``model(body, action) -> next_body, reward`` on the screen as it is now, for a planner."""
        margin = self.size // 2
        left, top = camera_column(episode) - np.int32(margin), np.int32(-margin)
        width, height = COLUMNS + 2 * margin, ROWS + 2 * margin
        screen = painted(course, episode.world, left, jnp.int32(top), width, height)
        seen = np.zeros((height, width), np.bool_)
        seen[:, margin : margin + COLUMNS] = True
        screen = self._marked(jnp.where(seen, screen, 0), jnp.int32(top))

        def model(body: Body, action: Array) -> tuple[Body, Array]:
            column, row = cell(body.x, body.y)
            corner = (row - np.int32(margin) - top, column - np.int32(margin) - left)
            inputs = self._joined(lax.dynamic_slice(screen, corner, (self.size, self.size)), body)
            change = [predict(learned.motion, inputs, action, k) for k in range(_TARGETS)]
            with_action = jnp.concatenate([inputs, action.astype(jnp.float32)[None]])
            reward = predict(learned.reward, with_action, 0, 0)
            if self.pessimism:
                known = is_met(met, self._rounded(inputs, action))
                reward = reward - lax.select(known, jnp.float32(0), jnp.float32(self.pessimism))
            tile = np.float32(TILE)
            after = Body(body.x + change[0] * tile, body.y + change[1] * tile, change[2], change[3])
            return after, reward

        return model


def body_of(world: World) -> Body:
    """Mario's position and the velocity that the competition shows."""
    player, unit = world.player, np.float32(1 / VELOCITY_UNIT)
    return Body(player.x, player.y, (player.x - player.x_old) * unit, (player.y - player.y_old) * unit)
