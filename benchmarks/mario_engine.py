"""Ticks a second of the Mario engine, new levels included, in a native loop and under vmap.

Work: random right-biased keys (70 % right, 60 % speed, 50 % jump) in the competition's schedule of
five ticks, on 50 overground levels of difficulty 3 (seeds from 1247 on). On death, on a win or after
2000 ticks the next level begins. The original Java program does 95,000 to 113,000 ticks/s of this on
one core (150,000 without its level generator, which is not in our figures either: levels are made
beforehand, a reset copies one).

What costs, and what was tried (one core of a shared machine, in CPU time, which others' load does
not inflate; a tick costs about 0.5 microseconds):

* A native loop of scalars over the places in use, with real branches, is what makes it fast. What is
  rare (bumping, contacts, spawning, coins, compaction) sits in loops of one turn or none (`when`),
  which, other than `lax.cond`, copy no array.
* The spawn window is not scanned. Templates are sorted by column; only columns that come into the
  window are looked at.
* Tiles are one byte array, read one by one; the probes of one piece of a move are one call that XLA
  may not inline, with one word of bits as its result, so that no probe is repeated in a consumer.
* Decay on integers (exact, subnormal numbers included) is some 30 integer instructions a sprite.
* The compiler option ``xla_cpu_copy_insertion_use_region_analysis`` must be off for the engine
  (`hrljax.engine.compiler.nested_options`): it drops copies that are needed, and sprites differ from the original's.
  A version in which every counter waits for the inner loops ran 7 % faster with it, but still went
  wrong where sprites hit each other.
* Under vmap on a CPU the games of a batch take their ticks one after the other: loops that all games go through
  together, as long as the slowest and with every rare part, took ten times as long. What is left to a native loop
  are the copies of a game's state into the batch and out of it.

    python benchmarks/mario_engine.py --json mario_engine.json
"""

import platform
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax import Array, lax

from hrljax.core import random
from hrljax.engine import batch
from hrljax.engine.compiler import nested_options
from hrljax.envs.mario.engine.course import Course, make_course, start
from hrljax.envs.mario.engine.sprite_list import when
from hrljax.envs.mario.engine.state import JUMP, LEFT, RIGHT, SPEED, World
from hrljax.envs.mario.engine.tick import tick
from hrljax.envs.mario.levels.generator import generate_level

try:
    from benchmarks.rounds import Contestant, measure, save
except ModuleNotFoundError:
    from rounds import Contestant, measure, save

CASE = "Mario, type 0, difficulty 3"
NUM_LEVELS, FIRST_SEED, LONGEST = 50, 1247, 2000
TICKS_A_STEP = 5


@dataclass(frozen=True)
class Options:
    """Ticks a second of the Mario engine, new levels included."""

    ticks: int = 500_000
    """Ticks of a game's run in the native loop."""
    rounds: int = 5
    """Rounds; every contestant runs once in each."""
    cores: int = batch.usable_cores()
    """Greatest number of cores; one core is measured in any case."""
    batches: tuple[int, ...] = (16, 256)
    """Games at once under vmap."""
    vmap_ticks: int = 200
    """Ticks of each game under vmap."""
    json: Path | None = None
    """Where to write the rows."""


class Loop(NamedTuple):
    """The state of the benchmark's loop."""

    number: Array  # int32: ticks done
    world: World
    age: Array  # int32: ticks in this level
    resets: Array  # int32
    keys: Array  # int32: keys of this step
    keys_before: Array  # of the last one


def random_keys(seed: Array, number: Array) -> Array:
    """Keys of a step: right, speed and jump with 70, 60 and 50 %."""
    direction, speed, jump = random.words((seed, seed), number.astype(jnp.uint32), 3)
    keys = lax.select(random.below(direction, 0.85), jnp.int32(LEFT), jnp.int32(0))
    keys = lax.select(random.below(direction, 0.7), jnp.int32(RIGHT), keys)
    keys = keys | lax.select(random.below(speed, 0.6), jnp.int32(SPEED), jnp.int32(0))
    return keys | lax.select(random.below(jump, 0.5), jnp.int32(JUMP), jnp.int32(0))


def play(course: Course, seed: Array, ticks: Array) -> tuple[Array, Array, Array]:
    """Plays; returns the number of levels begun, the coins of the last one and whether sprites were lost."""

    def one(loop: Loop) -> Loop:
        phase = loop.number % TICKS_A_STEP
        begins = phase == 0
        keys_before = lax.select(begins, loop.keys, loop.keys_before)
        keys = lax.cond(begins, lambda: random_keys(seed, loop.number), lambda: loop.keys)
        direction = keys & np.int32(LEFT | RIGHT)
        held = lax.select(begins, keys_before, lax.select(phase == 1, direction, keys))
        world = tick(course, loop.world, held)
        over = (world.player.death_time > 0) | (world.player.win_time > 0) | (loop.age >= LONGEST)
        resets = loop.resets + over.astype(jnp.int32)
        level = (resets + seed.astype(jnp.int32)) % NUM_LEVELS
        world = when(over, lambda world: start(course, level)._replace(overflow=world.overflow), world)
        return Loop(loop.number + 1, world, lax.select(over, 0, loop.age + 1), resets, keys, keys_before)

    zero = jnp.int32(0)
    first = Loop(zero, start(course, seed.astype(jnp.int32) % NUM_LEVELS), zero, zero, zero, zero)
    last = lax.while_loop(lambda loop: loop.number < ticks, one, first)
    return last.resets, last.world.coins, last.world.overflow


def native(course: Course, compiled: Any, seconds: float, cores: int, ticks: int) -> Contestant:
    """One game a core in a native loop, each in its own thread."""

    def one(seed: int) -> None:
        assert not bool(jax.block_until_ready(compiled(course, jnp.uint32(seed), jnp.int32(ticks)))[2])

    def run() -> int:
        with ThreadPoolExecutor(cores) as pool:
            list(pool.map(one, range(cores)))
        return cores * ticks

    return Contestant(CASE, "hrljax native", cores, run, seconds)


def vmapped(course: Course, size: int, ticks: int, cores: int) -> Contestant:
    """A batch of games in lock-step; XLA decides about cores."""
    seeds = jnp.arange(size, dtype=jnp.uint32)
    began = time.perf_counter()
    batched = jax.jit(jax.vmap(play, (None, 0, None)), compiler_options=nested_options())
    compiled = batched.lower(course, seeds, jnp.int32(ticks)).compile()
    seconds = time.perf_counter() - began

    def run() -> int:
        jax.block_until_ready(compiled(course, seeds, jnp.int32(ticks)))
        return size * ticks

    return Contestant(CASE, f"hrljax vmap of {size}", cores, run, seconds)


def report(rows: list[dict[str, Any]]) -> str:
    """The rows as a table."""
    lines = [f"{'contestant':24}{'cores':>6}{'ticks/s':>12}{'best':>12}{'per CPU s':>12}{'compile s':>11}"]
    for row in rows:
        lines.append(
            f"{row['contestant']:24}{row['cores']:6}{row['value']:12,.0f}{row['best']:12,.0f}"
            f"{row['per_cpu_second']:12,.0f}{row['compile_seconds']:11.1f}"
        )
    alone = [row for row in rows if row["contestant"] == "hrljax native"]
    if len(alone) > 1:
        lines.append(f"{alone[1]['cores']} cores do {alone[1]['value'] / alone[0]['value']:.2f} times what one does")
    return "\n".join(lines)


def main(options: Options) -> None:
    levels = [generate_level(FIRST_SEED + i, 0, 3) for i in range(NUM_LEVELS)]
    course = jax.tree.map(jnp.asarray, make_course(*levels))
    began = time.perf_counter()
    lowered = jax.jit(play, compiler_options=nested_options()).lower(course, jnp.uint32(0), jnp.int32(1))
    compiled = lowered.compile()
    seconds = time.perf_counter() - began
    contestants = [native(course, compiled, seconds, cores, options.ticks) for cores in sorted({1, options.cores})]
    contestants += [vmapped(course, size, options.vmap_ticks, options.cores) for size in options.batches]
    rows = measure(contestants, options.rounds, "ticks/s")
    print(report(rows))
    versions = ", ".join(f"{name} {version(name)}" for name in ("jax", "jaxlib"))
    print(f"median of {options.rounds} rounds; Python {platform.python_version()}, {versions}")
    save(rows, options.json)


if __name__ == "__main__":
    main(tyro.cli(Options))
