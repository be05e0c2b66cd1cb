"""Infinite Mario of the 2009 RL competition as an environment."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import gymnasium
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.environment import Events, Words
from hrljax.core.numerics import exact_product, opaque_zero, take
from hrljax.core.random import WORD_BITS
from hrljax.envs.base import Environment
from hrljax.envs.mario.competition import (
    COLUMNS,
    OBSERVED,
    ROWS,
    Episode,
    Objects,
    advance,
    begin,
    keys_of,
    objects,
    screen,
)
from hrljax.envs.mario.engine.course import Course, make_course
from hrljax.envs.mario.engine.quantum import check_quantum
from hrljax.envs.mario.engine.state import World
from hrljax.envs.mario.levels.ascii import from_ascii
from hrljax.envs.mario.levels.generator import generate_level
from hrljax.envs.mario.levels.level import Level
from hrljax.envs.mario.levels.tiles import TILE

ALL_ACTIONS = tuple((direction, jump, speed) for direction in (-1, 0, 1) for jump in (0, 1) for speed in (0, 1))
"""The competition's actions: direction, jump, speed."""
THESIS_ACTIONS = tuple(action for action in ALL_ACTIONS if action[0] or action == (0, 1, 0))
"""The nine that the thesis uses: without a direction, only the jump."""

_ACTIONS = {"all": ALL_ACTIONS, "thesis": THESIS_ACTIONS}
_MOST_LEVELS = 1 << 16
_INDEX_BITS = 16


class MarioParams(NamedTuple):
    """Numbers of the environment; each may be swept as ``env.<name>``."""

    goal_reward: float = 100.0
    """Of the step that reaches the exit."""
    death_reward: float = -10.0
    """Of the step in which Mario dies, at the limit of steps too."""
    step_reward: float = -0.01
    """Of every other step."""
    coin_reward: float = 1.0
    kill_reward: float = 1.0
    displacement_reward: float = 0.0
    """For every tile that Mario has moved to the right in a step, the last one included."""
    max_steps: int = 1000
    """The step with this number kills Mario in its first tick."""


PRESETS = {
    "competition": ("all", MarioParams()),
    "thesis": ("thesis", MarioParams(death_reward=-50.0, displacement_reward=1.0)),
}
"""Names of settings: which actions, which numbers."""


@dataclass(frozen=True)
class Mario(Environment[Episode, MarioParams]):
    """Infinite Mario: run to the exit, which lies about 318 tiles to the right.

    One step is five ticks of the game (`hrljax.envs.mario.competition`). Coins and kills of the step
    in which the episode ends are lost, as in the original. An episode that ended in the last tick of
    a step is over with the next step. After that nothing changes and rewards are 0.

    Attributes:
        seeds: seeds of the levels; an episode takes place on a random one of them.
        level_type: 0 overground, 1 underground, 2 castle.
        difficulty: 0 and up.
        width: nominal width of the levels in tiles.
        levels: levels as text (`hrljax.envs.mario.levels.ascii`) in place of generated ones.
        preset: ``"competition"`` or ``"thesis"`` (nine actions, -50 for a death, displacement).
        actions: ``"all"`` twelve or the ``"thesis"``'s nine; None: the preset's.
        quantum: positions and velocities are multiples of 1 / quantum pixels after every tick; None:
            exact.

    Raises:
        TypeError: an option is of the wrong kind.
        ValueError: an option is unknown or out of range, or a level cannot be read.
    """

    seeds: tuple[int, ...] = (1247,)
    level_type: int = 0
    difficulty: int = 3
    width: int = 320
    levels: tuple[str, ...] = ()
    preset: Literal["competition", "thesis"] = "competition"
    actions: Literal["all", "thesis"] | None = None
    quantum: int | None = None

    name = "Mario"
    metrics = ("win", "death", "distance", "coins", "kills")
    has_loops = True
    num_words = 0
    num_initial_words = 1
    renderer = "hrljax.envs.mario.drawing.state"

    def __post_init__(self) -> None:
        checks.choice("preset", self.preset, PRESETS)
        checks.choice("actions", self.actions, (None, *_ACTIONS))
        check_quantum(self.quantum)
        for name, value in (("seeds", self.seeds), ("levels", self.levels)):
            checks.instance(name, value, tuple, "a tuple")
        for number, level in enumerate(self.levels):
            checks.text(f"levels[{number}]", level, "hrljax.envs.mario.levels.ascii.to_ascii(level)")
        count = len(self.levels or self.seeds)
        if not 1 <= count <= _MOST_LEVELS:
            raise ValueError(f"seeds or levels must name 1 to {_MOST_LEVELS} levels, got {count}")
        self.course  # noqa: B018  (a level that cannot be made is an error now, not later)

    @cached_property
    def level_list(self) -> list[Level]:
        """The levels, in the order of their numbers."""
        if self.levels:
            return [from_ascii(text) for text in self.levels]
        return [generate_level(seed, self.level_type, self.difficulty, self.width) for seed in self.seeds]

    @cached_property
    def course(self) -> Course:
        """The levels as the engine reads them (NumPy arrays)."""
        return make_course(*self.level_list)

    @property
    def action_table(self) -> tuple[tuple[int, int, int], ...]:
        """Direction, jump and speed of every action."""
        return _ACTIONS[self.actions or PRESETS[self.preset][0]]

    @cached_property
    def action_names(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(map(_action_name, self.action_table))

    @property
    def default_params(self) -> MarioParams:
        return PRESETS[self.preset][1]

    def initial(self, words: Words, params: MarioParams) -> Episode:
        # 16 bits of the word times the number of levels, without overflow.
        word = words[0] >> np.uint32(WORD_BITS - _INDEX_BITS)
        level = (word * np.uint32(self.course.num_levels)) >> np.uint32(_INDEX_BITS)
        return begin(self.course, level.astype(jnp.int32), self.quantum)

    def transition(
        self, state: Episode, action: Array, words: Words, params: MarioParams
    ) -> tuple[Episode, Array, Array, Events]:
        checks.integer("action", action, 0, self.num_actions - 1, may_be_traced=True)
        after = advance(self.course, state, self.keys(action), params.max_steps, self.quantum)
        terminated = after.phase == OBSERVED
        ends = terminated & (state.phase != OBSERVED)
        won = after.world.player.win_time > 0
        reward = _reward(state, after, params, ends, won)
        info = {"win": ends & won, "death": ends & ~won, **_progress(state.world, after.world)}
        return after, reward, terminated, info

    def keys(self, action: Array) -> Array:
        """The keys that an action holds, as bits of `hrljax.envs.mario.engine.state` (int32)."""
        return take(jnp.asarray(np.array([keys_of(*action) for action in self.action_table], np.int32)), action)

    def observation(self, state: Episode) -> Array:
        """The screen as characters, ``[16, 21]`` uint8 (`hrljax.envs.mario.competition.screen`)."""
        return screen(self.course, state)

    def objects(self, state: Episode) -> Objects:
        """Mario and the sprites, as the competition's program describes them."""
        return objects(state.world)

    @property
    def observation_space(self) -> gymnasium.spaces.Box:
        return gymnasium.spaces.Box(0, 255, (ROWS, COLUMNS), np.uint8)


def _action_name(action: tuple[int, int, int]) -> str:
    direction, jump, speed = action
    parts = [{-1: "left", 0: "", 1: "right"}[direction], "jump" * jump, "speed" * speed]
    return " ".join(filter(None, parts)) or "no op"


def _progress(before: World, after: World) -> dict[str, Array]:
    """What a step brought, float32: tiles to the right, coins and kills."""
    return {
        "distance": (after.player.x - before.player.x) * np.float32(1 / TILE),
        "coins": (after.coins - before.coins).astype(jnp.float32),
        "kills": (after.kills - before.kills).astype(jnp.float32),
    }


def _reward(before: Episode, after: Episode, params: MarioParams, ends: Array, won: Array) -> Array:
    zero = opaque_zero(after.time.astype(jnp.uint32))

    def times(number: float, count: Array) -> Array:
        return exact_product(jnp.float32(number), count, zero)

    progress = _progress(before.world, after.world)
    moved = times(params.displacement_reward, progress["distance"])
    collected = times(params.coin_reward, progress["coins"]) + times(params.kill_reward, progress["kills"])
    usual = jnp.float32(params.step_reward) + collected
    last = lax.select(won, jnp.float32(params.goal_reward), jnp.float32(params.death_reward))
    reward = lax.select(ends, last, usual) + moved
    return lax.select(before.phase == OBSERVED, jnp.float32(0), reward)
