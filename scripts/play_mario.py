"""Plays one game of Infinite Mario and writes a film, the steps as a table, and a picture of the level."""

import csv
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import interruptible  # noqa: F401
import numpy as np
from PIL import Image
from tqdm import tqdm

from hrljax.envs.film import save_gif
from hrljax.envs.mario import play
from hrljax.envs.mario.drawing import picture
from hrljax.envs.mario.env import Mario, MarioParams
from hrljax.envs.mario.levels.tiles import TILE
from hrljax.envs.mario.recordings import LevelId
from hrljax.experiments import program


@dataclass(frozen=True)
class Options:
    """One game of Infinite Mario: a film (game.gif), a table (steps.csv), a picture (level.png).

    steps.csv has a row for each step: the action (direction, jump, speed), its reward and the return so
    far, where Mario is afterwards (x, y in tiles from the left and upwards from 16 tiles below the
    top), his size (0 small, 1 large, 2 fire), coins, kills, and whether the episode ended. It can be
    played again with --policy recorded --actions. summary.json holds "policy", "level", "steps",
    "return", "won", "distance" (tiles), "coins", "kills", "frames".
    """

    policy: Literal["runner", "random", "recorded"] = "runner"
    """Scripted right-runner, random actions mostly to the right, or recorded ones."""
    actions: Path | None = None
    """For recorded: a CSV with columns direction, jump, speed, or an .npz of recorded competition steps."""
    case: int = 0
    """For recorded: which game of an .npz. Its level is played unless --level is given."""
    seed: int = 1247
    """Seed of the level."""
    type: int = 0
    """Type of the level: 0 overground, 1 underground, 2 castle."""
    difficulty: int = 3
    """Difficulty of the level, 0 and up."""
    width: int = 320
    """Nominal width of the level in tiles."""
    level: Path | None = None
    """A level as text, in place of a generated one."""
    preset: Literal["competition", "thesis"] = "competition"
    """Rewards."""
    max_steps: int = 1000
    """The step in which Mario runs out of time."""
    key: int = 0
    """Seed of the random policy."""
    tile_pixels: int = 24
    """Points per tile in the pictures."""
    ticks_per_frame: int = 2
    """Ticks of the game (24 a second) from one picture of the film to the next."""
    out: Path = Path("runs/play_mario")
    """Folder for what is written."""


def main(options: Options) -> int:
    program.check_counts(options, "max_steps", "ticks_per_frame", "tile_pixels")
    env, level_id, policy = _game(options)
    params = env.default_params._replace(max_steps=options.max_steps)
    options.out.mkdir(parents=True, exist_ok=True)
    for steps, worlds in program.until_interrupted(_played(env, policy, params)):
        with (options.out / "steps.csv").open("w", newline="") as file:
            csv.writer(file).writerows([play.COLUMNS, *play.table(steps)])
        shown = [*worlds[:: options.ticks_per_frame], steps[-1].episode.world]
        track = np.array([(world.player.x, world.player.y) for world in worlds])
        Image.fromarray(picture.level_strip(env.level_list[0], 16, 100, track)).save(options.out / "level.png")
        last = steps[-1].episode.world
        summary = {
            "policy": options.policy,
            "level": str(options.level) if options.level else level_id._asdict(),
            "steps": len(steps),
            "return": sum(step.reward for step in steps),
            "won": steps[-1].terminated and int(last.player.win_time) > 0,
            "distance": float(track[:, 0].max() / TILE - 2),
            "coins": int(last.coins),
            "kills": int(last.kills),
            "frames": len(shown),
        }
        program.write_summary(options.out, summary)
        for frames in program.until_interrupted(_frames(env, shown, options.tile_pixels)):
            save_gif(frames, options.out / "game.gif", 24 / options.ticks_per_frame)
        for name, value in summary.items():
            print(f"{name:>10}  {f'{value:.2f}' if isinstance(value, float) else value}")
    return program.ended(options.out)


def _played(env: Mario, policy: play.Policy, params: MarioParams) -> Iterator[tuple[list[play.Step], list[Any]]]:
    """The steps of the one game, and Mario's world in every tick."""
    steps, worlds = [], []
    for step in tqdm(play.play(env, policy, params), unit="step", file=sys.stderr):
        steps.append(step._replace(worlds=[]))
        worlds += step.worlds
    if not steps:
        raise ValueError("nothing was played: there are no recorded actions")
    yield steps, worlds


def _frames(env: Mario, worlds: list[Any], tile_pixels: int) -> Iterator[list[np.ndarray]]:
    """The pictures of the one film."""
    yield [picture.screen(env.course, world, tile_pixels) for world in tqdm(worlds, "film", file=sys.stderr)]


def _game(options: Options) -> tuple[Mario, LevelId, play.Policy]:
    """The environment, what its level is generated from, and the policy."""
    if (options.policy == "recorded") != (options.actions is not None):
        raise ValueError("--actions goes with --policy recorded, and only with it")
    level_id, actions = LevelId(options.seed, options.type, options.difficulty, options.width), []
    if options.actions is not None:
        actions, recorded_level = play.read_actions(options.actions, options.case)
        level_id = recorded_level or level_id
    texts = (options.level.read_text(),) if options.level else ()
    numbers = level_id.level_type, level_id.difficulty, level_id.width
    env = Mario((level_id.seed,), *numbers, levels=texts, preset=options.preset, actions="all")
    if options.policy == "recorded":
        return env, level_id, play.recorded_policy(actions)
    random = options.policy == "random"
    return env, level_id, play.random_policy(options.key) if random else play.runner_policy(env.course)


if __name__ == "__main__":
    program.run(main, Options)
