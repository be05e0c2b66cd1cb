"""What models of Mario that are learned have in common: what they read of the screen, and a look ahead (thesis 4.2.3).

Looking ahead, a model cuts the tiles out of the screen as it is now: what other things do meanwhile is not modelled.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import Tracer

from hrljax.core import checks
from hrljax.core.flags import Flag
from hrljax.envs.mario.competition import COLUMNS, ROWS, Episode, camera_column
from hrljax.envs.mario.engine.course import Course
from hrljax.envs.mario.engine.state import World
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.features import NUM_SYMBOLS, VELOCITY_UNIT, cell, painted, window
from hrljax.envs.mario.levels.tiles import HEIGHT, TILE
from hrljax.learners.base import Transition
from hrljax.learners.hyperparameters import Hyperparameter, Settings, hyperparameter
from hrljax.learners.relational.visited import is_met, mark, nothing_met
from hrljax.search.best_first import ModelFn
from hrljax.trees.rows import MAX_ROWS

NUM_CHANGES = 4
"""Targets of motion: displacement in tiles and next velocity."""
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
    keys: Array  # int32: of the last action, which hold for one more tick


class ModelTables(NamedTuple):
    """What a model has learned."""

    replay: Any  # the transitions that it is fitted to
    learned: Any  # the fitted trees
    met: Any  # which inputs and actions have been met, see `hrljax.learners.relational.visited`; () without pessimism


class Experience(NamedTuple):
    """A transition as a model sees it."""

    inputs: Array  # [F] float32: tiles, velocity
    action: Array  # int32
    change: Array  # [4] float32: displacement in tiles, next velocity; nothing is known of them if it was the last one
    reward: Array  # float32
    terminated: Array  # bool
    last_keys: Array  # int32: keys of the action before


class Foreseen(NamedTuple):
    """What a model predicts of a step."""

    change: list[Array]  # 4 float32: displacement in tiles, next velocity
    reward: Array  # float32
    ended: Flag  # whether the episode ends with it
    beyond: Array | None = None  # float32: what the steps after it are worth, of a model that says so
    is_met: Array | None = None  # bool: whether it was met, of a model that remembers


@dataclass(frozen=True)
class ScreenModel(Settings):
    """A model that is learned from what is around Mario.

    Attributes:
        size: tiles from left to right and from top to bottom around Mario, an odd number up to 11.
        offsets: whether Mario's place within his tile is an input too, in x and y.
        below: whether what lies below the level is a tile of its own; if not, the level goes on.
        rows: N, transitions that are kept and fitted.
        pessimism: taken off the predicted reward of a step whose inputs, numbers rounded to a 32nd,
            have not been met with its action (as Kidambi et al. 2020 do); may be swept, from a number above 0.

    Raises:
        TypeError, ValueError: an attribute is of the wrong kind or out of range.
    """

    size: int = 5
    offsets: bool = False
    below: bool = False
    rows: int = 20_000
    pessimism: Hyperparameter = hyperparameter(0.0, 0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("rows", 1, MAX_ROWS)
        self._set("size", checks.odd(f"{type(self).__name__}: size", self.size, _LARGEST_SIZE))
        for option in ("offsets", "below"):
            self._check_flag(option)

    @property
    def num_inputs(self) -> int:
        return self.size**2 + (4 if self.offsets else 2)

    @property
    def categories(self) -> tuple[int, ...]:
        """Kinds of the inputs, as trees have them."""
        tiles = self.size**2
        return (NUM_SYMBOLS + self.below,) * tiles + (0,) * (self.num_inputs - tiles)

    @property
    def _is_pessimistic(self) -> bool:
        return isinstance(self.pessimism, Tracer) or bool(self.pessimism)

    @abstractmethod
    def empty(self, num_actions: int) -> Any:
        """Where transitions are kept."""

    @abstractmethod
    def unfitted(self, num_actions: int) -> Any:
        """Trees that predict 0."""

    @abstractmethod
    def add(self, replay: Any, new: Experience, num_actions: int, learns: Array) -> Any:
        """Keeps a transition, where `learns`."""

    @abstractmethod
    def fit(self, replay: Any, num_actions: int) -> Any:
        """Grows all trees anew from what is kept."""

    @abstractmethod
    def foreseen(self, tables: ModelTables, inputs: Array, last_keys: Array, action: Array) -> Foreseen:
        """What is predicted of a step; `last_keys` are those of the action before."""

    @property
    def _marks(self) -> bool:
        """Whether what was met has to be marked."""
        return self._is_pessimistic

    def init(self, env: Mario) -> ModelTables:
        met = nothing_met() if self._marks else ()
        return ModelTables(self.empty(env.num_actions), self.unfitted(env.num_actions), met)

    def observe(self, env: Mario, tables: ModelTables, transition: Transition, learns: Array) -> ModelTables:
        """Keeps a transition for the next fit, where `learns`."""
        inputs, met = self.inputs(env.course, transition.state.world), tables.met
        if self._marks:
            met = mark(met, self._rounded(inputs, transition.action), learns)
        before, after = body_of(transition.state), body_of(transition.next_state)
        tile = np.float32(1 / TILE)
        change = jnp.stack([(after.x - before.x) * tile, (after.y - before.y) * tile, after.dx, after.dy])
        new = Experience(
            inputs, transition.action, change, transition.reward, transition.terminated, transition.state.keys
        )
        return tables._replace(replay=self.add(tables.replay, new, env.num_actions, learns), met=met)

    def refit(self, env: Mario, tables: ModelTables) -> ModelTables:
        """Fits the trees to what is kept."""
        return tables._replace(learned=self.fit(tables.replay, env.num_actions))

    def planned(self, env: Mario, tables: ModelTables, episode: Episode) -> tuple[ModelFn, Body]:
        """What a planner searches from a moment of an episode: the model, and the state to start in."""
        return self.look_ahead(env, tables, episode), body_of(episode)

    def inputs(self, course: Course, world: World) -> Array:
        """What the model reads of the game, ``[F]`` float32."""
        _, row = cell(world.player.x, world.player.y)
        tiles = self._marked(window(course, world, self.size), row - np.int32(self.size // 2))
        return self._joined(tiles, *_place_and_velocity(world))

    def _marked(self, tiles: Array, top: Array) -> Array:
        """A part of the screen, its first row being `top`, with what lies below the level as a kind of its own."""
        if not self.below:
            return tiles
        rows = top + np.arange(len(tiles), dtype=np.int32)
        return jnp.where(rows[:, None] < HEIGHT, tiles, _BELOW)

    def _joined(self, tiles: Array, x: Array, y: Array, dx: Array, dy: Array) -> Array:
        numbers = [dx, dy]
        if self.offsets:
            column, row = cell(x, y)
            tile = np.float32(1 / TILE)
            numbers += [x * tile - column.astype(jnp.float32), y * tile - row.astype(jnp.float32)]
        return jnp.concatenate([tiles.ravel().astype(jnp.float32), jnp.stack(numbers)])

    def _rounded(self, inputs: Array, action: Array) -> Array:
        """Inputs and action as whole numbers, int32 ``[F + 1]``."""
        is_tile = np.arange(self.num_inputs) < self.size**2
        steps = np.where(is_tile, np.float32(1), _ROUNDED_TO)
        return jnp.append(jnp.round(inputs * steps).astype(jnp.int32), action)

    def look_ahead(self, env: Mario, tables: ModelTables, episode: Episode) -> ModelFn:
        """The model on the screen as it is now, for a planner; all is empty beyond it, but the level goes on."""
        margin, course = self.size // 2, env.course
        left, top = camera_column(episode) - np.int32(margin), np.int32(-margin)
        width, height = COLUMNS + 2 * margin, ROWS + 2 * margin
        screen = painted(course, episode.world, left, jnp.int32(top), width, height)
        columns = np.arange(width, dtype=np.int32)
        on_screen = (columns >= margin) & (columns < margin + COLUMNS)
        outside = (left + columns < 0) | (left + columns >= course.num_columns)
        screen = self._marked(jnp.where((on_screen | outside)[None, :], screen, 0), jnp.int32(top))

        def model(body: Body, action: Array) -> tuple[Any, ...]:
            column, row = cell(body.x, body.y)
            corner = (row - np.int32(margin) - top, column - np.int32(margin) - left)
            tiles = lax.dynamic_slice(screen, corner, (self.size, self.size))
            inputs = self._joined(tiles, body.x, body.y, body.dx, body.dy)
            foreseen = self.foreseen(tables, inputs, body.keys, action)
            change, reward, tile = foreseen.change, foreseen.reward, np.float32(TILE)
            if self._is_pessimistic:
                known = foreseen.is_met
                known = is_met(tables.met, self._rounded(inputs, action)) if known is None else known
                reward = reward - lax.select(known, jnp.float32(0), jnp.asarray(self.pessimism, jnp.float32))
            place = (body.x + change[0] * tile, body.y + change[1] * tile)
            after = Body(*place, change[2], change[3], env.keys(action))
            if isinstance(foreseen.ended, bool):
                return after, reward
            return (after, reward, foreseen.ended) + (() if foreseen.beyond is None else (foreseen.beyond,))

        return model


def body_of(episode: Episode) -> Body:
    """Mario's position and the velocity that the competition shows."""
    return Body(*_place_and_velocity(episode.world), episode.keys)


def _place_and_velocity(world: World) -> tuple[Array, Array, Array, Array]:
    player, unit = world.player, np.float32(1 / VELOCITY_UNIT)
    return player.x, player.y, (player.x - player.x_old) * unit, (player.y - player.y_old) * unit
