"""Comparison of the engine with recordings of the original program, field by field, bit by bit."""

from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax import xla
from hrljax.envs.mario import recordings
from hrljax.envs.mario.competition import (
    OBSERVED, Episode, Objects, advance, begin, camera_column, keys_of, objects, screen,
)  # fmt: skip
from hrljax.envs.mario.course import Course, make_course, start
from hrljax.envs.mario.generator import generate_level
from hrljax.envs.mario.level import Level
from hrljax.envs.mario.recordings import (
    MARIO_FLOATS, MARIO_INTS, SPRITE_FLAG_BITS, SPRITE_FLOATS, SPRITE_INTS, LevelId, Trajectory,
)  # fmt: skip
from hrljax.envs.mario.sprite_list import KILLED
from hrljax.envs.mario.state import Player, Sprites, World
from hrljax.envs.mario.tick import tick
from hrljax.envs.mario.tiles import HEIGHT

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


def _options() -> dict[str, Any] | None:
    """Compiler options of a native loop over ticks.

    Without region analysis: with it, some loops of the engine read values that were overwritten.
    """
    if not xla.native_loops_available():
        return None
    return {name: value for name, value in xla.OPTIONS.items() if "region_analysis" not in name}


@lru_cache
def _compiled(quantum: int | None) -> Any:
    return jax.jit(partial(_play, quantum=quantum), compiler_options=_options())


def play(
    course: Course, index: int, trajectory: Trajectory, quantum: int | None = None
) -> tuple[np.ndarray, TickRecord]:
    """Plays the keys of a recorded game on level `index` of a course.

    Returns:
        the tiles before the first tick, and what happened, with NumPy arrays of ``T`` ticks.
    """
    world = start(course, index, trajectory.mode > 0, trajectory.mode == 2)
    first_tiles = np.asarray(world.tiles)
    if trajectory.no_enemies:
        world = world._replace(template_states=jnp.full_like(world.template_states, KILLED))
    count = trajectory.num_ticks
    keys = np.zeros(-(-count // _CHUNK) * _CHUNK, np.int32)
    keys[:count] = trajectory.keys
    parts = []
    for i in range(0, len(keys), _CHUNK):
        world, record = _compiled(quantum)(course, world, jnp.asarray(keys[i : i + _CHUNK]))
        parts.append(jax.tree.map(np.asarray, record))
    return first_tiles, jax.tree.map(lambda *chunks: np.concatenate(chunks)[:count], *parts)


def _mario_columns(record: TickRecord, ids: np.ndarray) -> dict[str, np.ndarray]:
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


def compare_trajectory(course: Course, index: int, trajectory: Trajectory) -> Verdict:
    """Compares a game tick by tick in all recorded fields of Mario, the sprites and the tiles."""
    tiles, record = play(course, index, trajectory)
    count = trajectory.num_ticks
    wrong = np.zeros(count, bool)
    notes: dict[int, str] = {}

    def note(ticks: np.ndarray, text: Any) -> None:
        for t in np.flatnonzero(ticks)[:1]:
            notes.setdefault(int(t), text(int(t)))
        wrong[ticks] = True

    _compare_sprites(trajectory, record, note)
    columns = _mario_columns(record, _carried_ids(trajectory, record))
    recorded = dict(zip(MARIO_FLOATS, trajectory.mario_floats[1:].T, strict=True))
    recorded |= dict(zip(MARIO_INTS, trajectory.mario_ints[1:].T, strict=True))
    for name, values in recorded.items():
        if name != "keys":
            ours = columns[name]
            note(_bits(ours) != _bits(values), lambda t, a=ours, b=values, n=name: f"Mario's {n} is {a[t]}, not {b[t]}")
    _compare_tiles(trajectory, tiles, record, note)
    note(record.counts["overflow"], lambda t: "the places for sprites are used up")
    first = min(notes, default=None)
    text = "" if first is None else f"{_name(trajectory)}: after tick {first + 1} {notes[first]}"
    return Verdict(int(count - wrong.sum()), count, text)


def _name(case: Any) -> str:
    i = case.id
    return f"{case.agent} on level seed {i.seed}, type {i.level_type}, difficulty {i.difficulty}, width {i.width}"


def _serial_ids(record: TickRecord) -> dict[int, int]:
    """Numbers of sprites in the order of their first appearance in the list."""
    ids: dict[int, int] = {}
    for count, serials in zip(record.counts["n_sprites"], record.sprites.serial, strict=True):
        for serial in serials[:count][::-1]:
            ids.setdefault(int(serial), len(ids))
    return ids


def _carried_ids(trajectory: Trajectory, record: TickRecord) -> np.ndarray:
    ids = _serial_ids(record) | {-1: -1}
    return np.array([ids.get(int(serial), -2) for serial in record.player.carried], np.int32)


def _compare_sprites(trajectory: Trajectory, record: TickRecord, note: Any) -> None:
    sprites = record.sprites
    ids = _serial_ids(record)
    flags = sprites.flags & sum(SPRITE_FLAG_BITS.values())
    ours_by_name = {**sprites._asdict(), "flags": flags}
    for t, count in enumerate(record.counts["n_sprites"]):
        floats, ints = trajectory.sprites(t + 1)
        this = np.arange(trajectory.num_ticks) == t
        if len(floats) != count:
            kinds = sprites.kind[t, :count][::-1]
            note(this, lambda _, a=kinds, b=ints: f"the kinds of sprites are {a.tolist()}, not {b[:, 0].tolist()}")
            continue
        recorded = dict(zip(SPRITE_FLOATS, floats.T, strict=True)) | dict(zip(SPRITE_INTS, ints.T, strict=True))
        for name, values in recorded.items():
            if name == "id":
                ours = np.array([ids[int(s)] for s in sprites.serial[t, :count]], np.int32)[::-1]
            else:
                ours = ours_by_name[name][t, :count][::-1]
            differs = _bits(ours) != _bits(values)
            if differs.any():
                i = int(np.argmax(differs))
                kind = ints[i, 0]
                note(this, lambda _, a=ours, b=values, n=name, i=i, k=kind: f"sprite {i} (kind {k}): {n} is {a[i]}, not {b[i]}")  # fmt: skip


def _compare_tiles(trajectory: Trajectory, tiles: np.ndarray, record: TickRecord, note: Any) -> None:
    events = {}
    for row, x, y, tile in trajectory.tile_events.tolist():
        events.setdefault(row, []).append((x * HEIGHT + y, tile))
    expected = tiles.copy()
    for t in range(trajectory.num_ticks):
        for place, tile in events.get(t + 1, ()):
            expected[place] = tile
        differs = record.tiles[t] != expected
        if differs.any():
            i = int(np.argmax(differs))
            this = np.arange(trajectory.num_ticks) == t
            note(this, lambda _, i=i, a=record.tiles[t, i], b=expected[i]: f"the tile at {divmod(i, HEIGHT)} is {a:#04x}, not {b:#04x}")  # fmt: skip


def courses(ids: Sequence[LevelId]) -> dict[LevelId, tuple[Course, int]]:
    """For each level its course, shared by all levels of its width, and its index there."""
    found = {}
    for width in sorted({i.width for i in ids}):
        own = sorted({i for i in ids if i.width == width})
        course = jax.tree.map(jnp.asarray, make_course(*map(level_of, own)))
        found |= {level_id: (course, index) for index, level_id in enumerate(own)}
    return found


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
def _compiled_steps() -> Any:
    return jax.jit(_play_steps, compiler_options=_options())


_begin = jax.jit(lambda course, index: begin(course, index))
_first_record = jax.jit(lambda course, episode: _observe(course, episode))


def play_steps(course: Course, index: int, recorded: recordings.Episode) -> StepRecord:
    """Plays the actions of a recorded episode on level `index` of a course, as NumPy arrays."""
    episode = _begin(course, jnp.int32(index))
    count = recorded.num_steps
    keys = np.zeros(-(-count // _CHUNK) * _CHUNK, np.int32)
    keys[:count] = [keys_of(*action) for action in recorded.actions[1:].tolist()]
    parts = [jax.tree.map(lambda a: np.asarray(a)[None], _first_record(course, episode))]
    for i in range(0, len(keys), _CHUNK):
        chunk = jnp.asarray(keys[i : i + _CHUNK])
        episode, record = _compiled_steps()(course, episode, chunk, jnp.int32(recorded.max_steps))
        parts.append(jax.tree.map(np.asarray, record))
    return jax.tree.map(lambda *chunks: np.concatenate(chunks)[: count + 1], *parts)


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
        own = mine[name].astype(values.dtype)
        differs = own.view(np.uint8).reshape(count, -1) != np.ascontiguousarray(values).view(np.uint8).reshape(count, -1)
        if differs.any():
            i = int(np.argmax(differs.any(axis=1)))
            return f"object {i}: {name} is {own[i]}, not {values[i]}"
    return ""


def check_episodes(path: recordings.Path) -> Iterator[Verdict]:
    """Compares a file of recorded steps, episode by episode."""
    cases = recordings.read_episodes(path)
    of = courses([case.id for case in cases])
    for case in cases:
        yield compare_episode(*of[case.id], case)
