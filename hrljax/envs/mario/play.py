"""Single games on the host, for films and tables: policies, and a game tick by tick."""

import csv
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from os import PathLike
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from hrljax.core.environment import Events
from hrljax.envs.base import numbers_of
from hrljax.envs.mario import features
from hrljax.envs.mario.competition import OBSERVED, PLAYING, TICKS, Episode, held_keys, keys_of, unbegun
from hrljax.envs.mario.engine.course import Course
from hrljax.envs.mario.engine.state import World
from hrljax.envs.mario.engine.tick import tick
from hrljax.envs.mario.env import ALL_ACTIONS, Mario, MarioParams
from hrljax.envs.mario.levels.level import PIRANHA
from hrljax.envs.mario.levels.tiles import HEIGHT, TILE
from hrljax.envs.mario.recordings import LevelId, read_episodes

Action = tuple[int, int, int]
"""Direction (-1 left, 0, 1 right), jump (0, 1), speed (0, 1)."""
Policy = Callable[[Episode], Action | None]
"""What to do in an episode; None gives up."""

MarioStep: TypeAlias = tuple[Episode, jax.Array, jax.Array, Events]
"""What `Mario.transition` returns."""

COLUMNS = (
    "step", "direction", "jump", "speed", "reward", "return", "x", "y", "size", "coins", "kills", "terminated",
)  # fmt: skip
"""Columns of `table`."""
_NO_OP = ALL_ACTIONS.index((0, 0, 0))
_AHEAD = 4
"""Columns that the runner looks ahead; at full speed he covers three in a step."""


class Step(NamedTuple):
    """One step of a game."""

    action: Action
    reward: float
    terminated: bool
    worlds: list[World]  # after each tick that was played, up to 5
    episode: Episode  # after the step


def play(env: Mario, policy: Policy, params: MarioParams | None = None, level: int = 0) -> Iterator[Step]:
    """Plays one episode and yields its steps.

    Args:
        env: with all twelve actions.
        policy: chooses the actions.
        params: numbers of the environment; its own if not given.
        level: number of the level among the environment's.

    Raises:
        ValueError: `env` lacks some of the actions, or has no such level.
    """
    if env.action_table != ALL_ACTIONS:
        raise ValueError('env must have actions="all"')
    if not 0 <= level < env.course.num_levels:
        raise ValueError(f"level must be in 0..{env.course.num_levels - 1}, got {level}")
    numbers = numbers_of(env, params)
    take_step, take_tick = _compiled(env)
    # The first observation comes after a step without keys.
    episode = take_step(unbegun(env.course, level), jnp.int32(_NO_OP), numbers)[0]
    while int(episode.phase) != OBSERVED:
        action = policy(episode)
        if action is None:
            return
        after, reward, terminated, _ = take_step(episode, jnp.int32(ALL_ACTIONS.index(action)), numbers)
        worlds = _worlds(take_tick, episode, after, keys_of(*action), int(after.time) >= numbers.max_steps)
        episode = after
        yield Step(action, float(reward), bool(terminated), worlds, episode)


@lru_cache(maxsize=4)
def _compiled(env: Mario) -> tuple[Callable[..., MarioStep], Callable[..., World]]:
    """The step of an environment, and a single tick of it."""

    def take_step(episode: Episode, action: jax.Array, params: MarioParams) -> MarioStep:
        return env.transition(episode, action, (), params)

    def take_tick(number: jax.Array, last: jax.Array, keys: jax.Array, late: jax.Array, world: World) -> World:
        return tick(env.course, world, held_keys(number, last, keys), late & (number == 0), env.quantum)

    return jax.jit(take_step), jax.jit(take_tick)


def _worlds(take_tick: Callable[..., World], before: Episode, after: Episode, keys: int, late: bool) -> list[World]:
    """The worlds after the ticks of a step; an episode may end in the middle of it."""
    world, worlds = before.world, []
    for number in range(TICKS if int(before.phase) == PLAYING else 0):
        world = take_tick(jnp.int32(number), before.keys, jnp.int32(keys), jnp.bool_(late), world)
        worlds.append(world)
        if int(after.phase) == OBSERVED and (int(world.player.death_time) or int(world.player.win_time)):
            break
    return worlds


def table(steps: Sequence[Step]) -> list[tuple[str | int, ...]]:
    """A row of `COLUMNS` for each step: x and y in tiles, y upwards; size 0 small, 1 large, 2 fire."""
    rows, total = [], 0.0
    for number, step in enumerate(steps, start=1):
        world, total = step.episode.world, total + step.reward
        player = world.player
        x, y = float(player.x) / TILE, HEIGHT + 1 - float(player.y) / TILE
        reals = (f"{step.reward:.6g}", f"{total:.6g}", f"{x:.4f}", f"{y:.4f}")
        counts = (int(features.own_state(player).size), int(world.coins), int(world.kills), int(step.terminated))
        rows.append((number, *step.action, *reals, *counts))
    return rows


def random_policy(seed: int, right: float = 0.8, stay: float = 0.6) -> Policy:
    """Random actions, mostly to the right: a new one is drawn with probability ``1 - stay``.

    Args:
        seed: of the random numbers.
        right: probability of the direction right in a new action.
        stay: probability of repeating the last action.
    """
    random = np.random.default_rng(seed)
    last = ALL_ACTIONS[-1]

    def choose(episode: Episode) -> Action:
        nonlocal last
        if random.random() >= stay:
            direction = 1 if random.random() < right else int(random.integers(-1, 1))
            last = (direction, int(random.integers(2)), int(random.integers(2)))
        return last

    return choose


def runner_policy(course: Course) -> Policy:
    """Runs to the right and jumps over what the window of tiles shows: walls, pits and monsters."""
    look = jax.jit(partial(features.window, course, size=2 * _AHEAD + 1))

    def choose(episode: Episode) -> Action:
        cells = np.asarray(look(episode.world))
        player = episode.world.player
        rises = float(player.y) < float(player.y_old)
        return 1, int(_danger(cells) or (rises and not bool(player.on_ground))), 1

    return choose


def _danger(cells: np.ndarray) -> bool:
    """Whether a wall, a pit or a monster lies ahead in a window with Mario in its middle."""
    names = np.array(features.SYMBOL_NAMES)
    holds = np.isin(names, ("solid", "pipe", "brick", "question block", "blocking 1"))[cells]
    blocks = np.isin(names, ("solid", "pipe", "brick", "question block"))[cells]
    is_monster = (cells > features.SYMBOL_OF_KIND) & (cells <= features.SYMBOL_OF_KIND + PIRANHA)
    ahead, feet = slice(_AHEAD + 1, None), _AHEAD
    wall = blocks[feet, _AHEAD + 1 : -1].any()
    pit = (~holds[feet + 1 :, _AHEAD : _AHEAD + 3].any(axis=0)).any()
    return bool(wall or pit or is_monster[feet - 2 : feet + 2, ahead].any())


def recorded_policy(actions: Sequence[Action]) -> Policy:
    """The actions of a recording in their order; gives up when they are used up."""
    remaining = iter(actions)
    return lambda episode: next(remaining, None)


def read_actions(path: str | PathLike[str], case: int = 0) -> tuple[list[Action], LevelId | None]:
    """Actions from a file.

    Args:
        path: a CSV with columns direction, jump and speed, or an ``.npz`` of recorded competition steps.
        case: which of the games of an ``.npz``.

    Returns:
        The actions, and the level on which they were recorded if the file says so.

    Raises:
        ValueError: the file lacks a column or the case, or an action is none of the twelve; says where.
    """
    if str(path).endswith(".npz"):
        episodes = read_episodes(path)
        if not 0 <= case < len(episodes):
            raise ValueError(f"case must be in 0..{len(episodes) - 1} for {path}, got {case}")
        rows, level = episodes[case].actions[1:].tolist(), episodes[case].id
    else:
        rows, level = _read_csv(path), None
    actions = [(int(direction), int(jump), int(speed)) for direction, jump, speed in rows]
    for i, action in enumerate(actions):
        if action not in ALL_ACTIONS:
            raise ValueError(f"{path}: action {i + 1} is {action}; direction must be -1, 0 or 1, jump and speed 0 or 1")
    return actions, level


def _read_csv(path: str | PathLike[str]) -> list[list[int]]:
    names = ("direction", "jump", "speed")
    with open(path, newline="") as file:
        reader = csv.DictReader(file)
        missing = [name for name in names if name not in (reader.fieldnames or ())]
        if missing:
            raise ValueError(f"{path} has no column {', '.join(missing)}; it must have {', '.join(names)}")
        rows = []
        for line in reader:
            try:
                rows.append([int(line[name]) for name in names])
            except (TypeError, ValueError) as error:
                raise ValueError(f"{path}, line {reader.line_num}: {', '.join(names)} must be integers") from error
    return rows
