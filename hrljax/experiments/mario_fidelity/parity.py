"""Comparison of the engine with recordings of the original program, field by field, bit by bit."""

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.engine.compiler import nested_options
from hrljax.envs.mario import recordings
from hrljax.envs.mario.competition import (
    OBSERVED,
    Episode,
    Objects,
    advance,
    camera_column,
    keys_of,
    objects,
    screen,
    unbegun,
)
from hrljax.envs.mario.engine.course import Course, make_course, start
from hrljax.envs.mario.engine.sprite_list import KILLED
from hrljax.envs.mario.engine.state import Player, Sprites, World
from hrljax.envs.mario.engine.tick import tick
from hrljax.envs.mario.levels.generator import generate_level
from hrljax.envs.mario.levels.level import Level
from hrljax.envs.mario.levels.tiles import HEIGHT
from hrljax.envs.mario.recordings import (
    MARIO_FLOATS,
    MARIO_INTS,
    SPRITE_FLAG_BITS,
    SPRITE_FLOATS,
    SPRITE_INTS,
    LevelId,
    Trajectory,
)

_CHUNK = 256
"""Ticks that one call computes; shorter games are played on with no keys and cut."""


class Verdict(NamedTuple):
    """How much of a file is identical."""

    identical: int
    total: int
    first_difference: str  # in words; empty if there is none


class TickRecord(NamedTuple):
    """What is compared after each tick, each array ``[T, ...]``."""

    player: Player
    sprites: Sprites
    counts: dict[str, Array]
    tiles: Array


def level_of(level_id: LevelId) -> Level:
    """The generated level of a recorded game."""
    return generate_level(level_id.seed, level_id.level_type, level_id.difficulty, level_id.width)


def _record(world: World) -> TickRecord:
    counts = {
        "coins": world.coins, "kills": world.kills, "active_tick": world.active_ticks, "x_cam": world.camera,
        "fireballs_on_screen": world.fireballs_on_screen, "n_sprites": world.num_sprites, "paused": world.paused,
        "overflow": world.overflow,
    }  # fmt: skip
    return TickRecord(world.player, world.sprites, counts, world.tiles)


def _play(course: Course, world: World, keys: Array, quantum: int | None) -> tuple[World, TickRecord]:
    def step(world: World, keys: Array) -> tuple[World, TickRecord]:
        world = tick(course, world, keys, quantum=quantum)
        return world, _record(world)

    return lax.scan(step, world, keys)


@lru_cache
def _compiled(quantum: int | None) -> Callable[..., tuple[World, TickRecord]]:
    return jax.jit(partial(_play, quantum=quantum), compiler_options=nested_options())


def play(
    course: Course, index: int, keys: np.ndarray, *, mode: int = 0, no_enemies: bool = False, quantum: int | None = None
) -> TickRecord:
    """Plays a game on level `index` of a course, one tick for each of `keys` ([T], at least 1).

    Args:
        course: levels, best as JAX arrays.
        index: number of the level.
        keys: the keys held in each tick (bits of `hrljax.envs.mario.engine.state`).
        mode: Mario at the start: 0 small, 1 large, 2 with fire.
        no_enemies: leaves out all monsters.
        quantum: see `tick`.

    Returns:
        What happened, as NumPy arrays of `T` ticks.
    """
    world = start(course, index, mode > 0, mode == 2)
    if no_enemies:
        world = world._replace(template_states=jnp.full_like(world.template_states, KILLED))
    padded = np.zeros(-(-len(keys) // _CHUNK) * _CHUNK, np.int32)
    padded[: len(keys)] = keys
    parts = []
    for i in range(0, len(padded), _CHUNK):
        world, record = _compiled(quantum)(course, world, jnp.asarray(padded[i : i + _CHUNK]))
        parts.append(jax.tree.map(np.asarray, record))
    return jax.tree.map(lambda *chunks: np.concatenate(chunks)[: len(keys)], *parts)


def replay(course: Course, index: int, game: Trajectory, quantum: int | None = None) -> TickRecord:
    """Plays the keys of a recorded game."""
    return play(course, index, game.keys, mode=game.mode, no_enemies=game.no_enemies, quantum=quantum)


def _mario_columns(record: TickRecord, ids: np.ndarray) -> dict[str, Any]:
    """The recorded columns of Mario, by name."""
    player, counts = record.player, record.counts
    flags = (
        player.on_ground * 1 + player.was_on_ground * 2 + player.may_jump * 4 + player.sliding * 8
        + player.can_shoot * 16 + player.large * 64 + player.fire * 128 + counts["paused"] * 256
    )  # fmt: skip
    status = np.where(player.win_time > 0, 2, np.where(player.death_time > 0, 1, 0))
    return {**player._asdict(), **counts, "flags": flags, "status": status, "carried_id": ids}


def _bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values).view(np.int32) if values.dtype == np.float32 else values.astype(np.int32)


class _Differences:
    """Which ticks of a game differ, and the first difference of each in words."""

    def __init__(self, num_ticks: int):
        self.wrong = np.zeros(num_ticks, bool)
        self.notes: dict[int, str] = {}

    def at(self, tick: int, text: str) -> None:
        self.wrong[tick] = True
        self.notes.setdefault(tick, text)

    def column(self, what: str, ours: np.ndarray, theirs: np.ndarray) -> None:
        differs = _bits(ours) != _bits(theirs)
        self.wrong |= differs
        if differs.any():
            t = int(np.argmax(differs))
            self.notes.setdefault(t, f"{what} is {ours[t]}, not {theirs[t]}")


def compare_trajectory(course: Course, index: int, trajectory: Trajectory) -> Verdict:
    """Compares a game tick by tick in all recorded fields of Mario, the sprites and the tiles."""
    record, tiles = replay(course, index, trajectory), np.asarray(course.tiles[index])
    differences = _Differences(trajectory.num_ticks)
    ids = _serial_ids(record)
    _compare_sprites(trajectory, record, ids, differences)
    columns = _mario_columns(record, np.array([ids.get(int(serial), -2) for serial in record.player.carried]))
    recorded = dict(zip(MARIO_FLOATS, trajectory.mario_floats[1:].T, strict=True))
    recorded |= dict(zip(MARIO_INTS, trajectory.mario_ints[1:].T, strict=True))
    for name, values in recorded.items():
        if name != "keys":
            differences.column(f"Mario's {name}", columns[name], values)
    _compare_tiles(trajectory, tiles, record, differences)
    for t in np.flatnonzero(record.counts["overflow"]):
        differences.at(int(t), "the places for sprites are used up")
    first = min(differences.notes, default=None)
    text = "" if first is None else f"{_name(trajectory)}: after tick {first + 1} {differences.notes[first]}"
    identical = int(trajectory.num_ticks - differences.wrong.sum())
    return Verdict(identical, trajectory.num_ticks, text)


def _name(case: recordings.Trajectory | recordings.Episode) -> str:
    i = case.id
    return f"{case.agent} on level seed {i.seed}, type {i.level_type}, difficulty {i.difficulty}, width {i.width}"


def _serial_ids(record: TickRecord) -> dict[int, int]:
    """Numbers of sprites in the order of their first appearance in the list; -1, no sprite, is -1."""
    ids: dict[int, int] = {}
    for count, serials in zip(record.counts["n_sprites"], record.sprites.serial, strict=True):
        for serial in serials[:count][::-1]:
            ids.setdefault(int(serial), len(ids))
    return ids | {-1: -1}


def _compare_sprites(
    trajectory: Trajectory, record: TickRecord, ids: dict[int, int], differences: _Differences
) -> None:
    ours = record.sprites._asdict()
    ours["flags"] = ours["flags"] & sum(SPRITE_FLAG_BITS.values())
    ours["id"] = np.vectorize(lambda serial: ids.get(serial, -2), otypes=[np.int32])(ours["serial"])
    for t, count in enumerate(record.counts["n_sprites"]):
        floats, ints = trajectory.sprites(t + 1)
        if len(floats) != count:
            kinds = ours["kind"][t, :count][::-1].tolist()
            differences.at(t, f"the kinds of sprites are {kinds}, not {ints[:, 0].tolist()}")
            continue
        recorded = dict(zip(SPRITE_FLOATS, floats.T, strict=True)) | dict(zip(SPRITE_INTS, ints.T, strict=True))
        for name, theirs in recorded.items():
            mine = ours[name][t, :count][::-1]
            differs = _bits(mine) != _bits(theirs)
            if differs.any():
                i = int(np.argmax(differs))
                differences.at(t, f"sprite {i} (kind {ints[i, 0]}): {name} is {mine[i]}, not {theirs[i]}")


def _compare_tiles(trajectory: Trajectory, tiles: np.ndarray, record: TickRecord, differences: _Differences) -> None:
    events: dict[int, list[tuple[int, int]]] = {}
    for row, x, y, tile in trajectory.tile_events.tolist():
        events.setdefault(row, []).append((x * HEIGHT + y, tile))
    expected = tiles.copy()
    for t, ours in enumerate(record.tiles):
        for place, tile in events.get(t + 1, ()):
            expected[place] = tile
        if (ours != expected).any():
            i = int(np.argmax(ours != expected))
            differences.at(t, f"the tile at {divmod(i, HEIGHT)} is {ours[i]:#04x}, not {expected[i]:#04x}")


def courses(ids: Sequence[LevelId]) -> dict[LevelId, tuple[Course, int]]:
    """For each level its course, shared by all levels of its width, and its index there."""
    by_level = {}
    for width in sorted({i.width for i in ids}):
        of_this_width = sorted({i for i in ids if i.width == width})
        course = jax.tree.map(jnp.asarray, make_course(*map(level_of, of_this_width)))
        by_level |= {level_id: (course, index) for index, level_id in enumerate(of_this_width)}
    return by_level


def check_trajectories(path: recordings.Path) -> Iterator[Verdict]:
    """Compares a file of recorded ticks, game by game."""
    cases = recordings.read_trajectories(path)
    of = courses([case.id for case in cases])
    for case in cases:
        yield compare_trajectory(*of[case.id], case)


def check_levels(path: recordings.Path) -> Iterator[Verdict]:
    """Compares a file of recorded levels with the generator, level by level."""
    for recorded in recordings.read_levels(path):
        made = level_of(recorded.id)
        text = _level_difference(made, recorded)
        where = f"level seed {recorded.id.seed}, type {recorded.id.level_type}, difficulty {recorded.id.difficulty}"
        yield Verdict(int(not text), 1, f"{where}, width {recorded.id.width}: {text}" if text else "")


def _level_difference(made: Level, recorded: recordings.RecordedLevel) -> str:
    for name in ("tiles", "spawns"):
        ours, theirs = getattr(made, name), getattr(recorded.level, name)
        if ours.shape != theirs.shape:
            return f"{name} have shape {list(ours.shape)}, not {list(theirs.shape)}"
        if (ours != theirs).any():
            column, row = np.argwhere(ours != theirs)[0].tolist()
            return f"{name} at column {column}, row {row} is {ours[column, row]:#04x}, not {theirs[column, row]:#04x}"
    ours, theirs = (int(made.exit_column), made.exit_row), (int(recorded.level.exit_column), recorded.exit_row)
    return "" if ours == theirs else f"the exit is at column and row {ours}, not {theirs}"


class StepRecord(NamedTuple):
    """What is compared after each step, each array ``[N, ...]``; first row: before the first step."""

    objects: Objects
    screen: Array
    camera: Array
    phase: Array
    coins: Array
    kills: Array
    won: Array


def _observe(course: Course, episode: Episode) -> StepRecord:
    world = episode.world
    won = world.player.win_time > 0
    column = camera_column(episode)
    return StepRecord(
        objects(world), screen(course, episode), column, episode.phase, world.coins, world.kills, won
    )  # fmt: skip


def _play_steps(course: Course, episode: Episode, keys: Array, max_steps: Array) -> tuple[Episode, StepRecord]:
    def step(episode: Episode, keys: Array) -> tuple[Episode, StepRecord]:
        episode = advance(course, episode, keys, max_steps)
        return episode, _observe(course, episode)

    return lax.scan(step, episode, keys)


@lru_cache
def _compiled_steps() -> Callable[..., tuple[Episode, StepRecord]]:
    return jax.jit(_play_steps, compiler_options=nested_options())


def play_steps(course: Course, index: int, recorded: recordings.Episode) -> StepRecord:
    """Plays the actions of a recorded episode on level `index` of a course, as NumPy arrays."""
    episode = unbegun(course, index)
    count = recorded.num_steps + 1
    keys = np.zeros(-(-count // _CHUNK) * _CHUNK, np.int32)
    keys[1:count] = [keys_of(*action) for action in recorded.actions[1:].tolist()]
    parts = []
    for i in range(0, len(keys), _CHUNK):
        chunk = jnp.asarray(keys[i : i + _CHUNK])
        episode, record = _compiled_steps()(course, episode, chunk, jnp.int32(recorded.max_steps))
        parts.append(jax.tree.map(np.asarray, record))
    return jax.tree.map(lambda *chunks: np.concatenate(chunks)[:count], *parts)


_GOAL, _DEATH, _STEP, _COIN, _KILL = 100.0, -10.0, -0.01, 1.0, 1.0


def compare_episode(course: Course, index: int, recorded: recordings.Episode) -> Verdict:
    """Compares an episode step by step: objects, velocities, characters, camera, reward, terminal."""
    ours = play_steps(course, index, recorded)
    count = recorded.num_steps + 1
    steps = np.arange(count)
    terminal = ours.phase == OBSERVED
    # At the end the program gives the observation of the step before once more.
    seen = np.where(terminal, np.maximum(steps - 1, 0), steps)
    value = _STEP * (steps - 1).astype(np.float64) + _COIN * ours.coins + _KILL * ours.kills
    reward = np.concatenate([[0.0], np.diff(value)])
    reward = np.where(terminal, np.where(ours.won, _GOAL, _DEATH), reward)
    identical, first = 0, ""
    for t in range(count):
        problem = _step_difference(ours, recorded, t, int(seen[t]), bool(terminal[t]), float(reward[t]))
        identical += not problem
        if problem and not first:
            first = f"{_name(recorded)}: after step {t} {problem}"
    return Verdict(identical, count, first)


def _step_difference(
    ours: StepRecord, recorded: recordings.Episode, t: int, seen: int, terminal: bool, reward: float
) -> str:
    """What differs in a row, in words; empty if nothing."""
    if terminal != bool(recorded.terminals[t]):
        return f"the episode is {'' if terminal else 'not '}over"
    if reward != recorded.rewards[t]:
        return f"the reward is {reward!r}, not {recorded.rewards[t]!r}"
    if ours.camera[seen] != recorded.camera_tiles[t]:
        return f"the camera is at column {ours.camera[seen]}, not {recorded.camera_tiles[t]}"
    if (ours.screen[seen] != recorded.symbols[t]).any():
        row, column = np.argwhere(ours.screen[seen] != recorded.symbols[t])[0]
        symbols = chr(ours.screen[seen, row, column]), chr(recorded.symbols[t, row, column])
        return "the character in row {}, column {} is {!r}, not {!r}".format(row, column, *symbols)
    types, numbers = recorded.objects(t)
    count = int(ours.objects.present[seen].sum())
    mine = {name: values[seen, :count] for name, values in ours.objects._asdict().items()}
    if count != len(types):
        return f"the kinds of objects are {mine['kind'].tolist()}, not {types[:, 0].tolist()}"
    mine["y"] = 16.0 - mine["depth"].astype(np.float64)
    theirs = dict(zip(("kind", "winged", "x", "y", "dx", "dy"), (*types.T, *numbers.T), strict=True))
    for name, values in theirs.items():
        replayed = mine[name].astype(values.dtype)
        differs = replayed.view(np.uint8).reshape(count, -1) != np.ascontiguousarray(values).view(np.uint8).reshape(
            count, -1
        )
        if differs.any():
            i = int(np.argmax(differs.any(axis=1)))
            return f"object {i}: {name} is {replayed[i]}, not {values[i]}"
    return ""


def check_episodes(path: recordings.Path) -> Iterator[Verdict]:
    """Compares a file of recorded steps, episode by episode."""
    cases = recordings.read_episodes(path)
    of = courses([case.id for case in cases])
    for case in cases:
        yield compare_episode(*of[case.id], case)
