"""Trained on some levels of Infinite Mario, played on others: what a hybrid learns that is not of one level."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import Array, lax
from matplotlib.figure import Figure

from hrljax import stats
from hrljax.core.environment import Events
from hrljax.core.numerics import opaque_zero
from hrljax.engine import batch
from hrljax.envs.mario.competition import Episode, begin
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.levels.ascii import to_ascii
from hrljax.envs.mario.levels.generator import generate_level
from hrljax.experiments import mario_hybrid
from hrljax.experiments.rows import Row, interval_row
from hrljax.learners.base import AnyLearner, Context, LearnerState, Transition
from hrljax.learners.relational.a_star_root import AStarRoot
from hrljax.learners.relational.encounter_model import MarioEncounters
from hrljax.learners.relational.learner import RelationalHORDQ, Tables
from hrljax.sweeps.learned import Learned
from hrljax.sweeps.sweep import sweep

LEVEL_TYPES = (0, 1, 2)
"""Overground, underground, castle."""
DIFFICULTIES = (0, 1, 2, 3, 4, 5)
PLAYED_FROM = 10_001
"""The first seed of the levels that are played; those that are trained on have seeds below."""


@dataclass(frozen=True)
class LevelSet:
    """Levels of every given type and difficulty, so many of each, with seeds that count up from `first_seed`."""

    level_types: tuple[int, ...]
    difficulties: tuple[int, ...]
    each: int
    first_seed: int
    actions: Literal["all", "thesis"] = "thesis"

    @cached_property
    def table(self) -> list[tuple[int, int, int]]:
        """Type, difficulty and seed of every level."""
        seeds = range(self.first_seed, self.first_seed + self.each)
        return [(t, d, seed) for t in self.level_types for d in self.difficulties for seed in seeds]

    @cached_property
    def environment(self) -> Mario:
        """Mario by the thesis's rules, an episode on a random one of the levels."""
        levels = (generate_level(seed, t, d) for t, d, seed in self.table)
        return Mario(levels=tuple(map(to_ascii, levels)), preset="thesis", actions=self.actions)


TRAINED_ON = {
    "the thesis's level": LevelSet((0,), (3,), 1, 1247),
    "20 levels like it": LevelSet((0,), (3,), 20, 1),
    "36 levels of all kinds": LevelSet(LEVEL_TYPES, DIFFICULTIES, 2, 1),
    "360 levels of all kinds": LevelSet(LEVEL_TYPES, DIFFICULTIES, 20, 1),
}
_COUNTED = ("win", "distance", "length", "return")
_EXIT_DISTANCE = 316
"""About how many tiles lie between the start of a level and its exit."""
UNTRAINED = "nothing: the model alone"
ENCOUNTERS = RelationalHORDQ(AStarRoot(model=MarioEncounters()), pseudo_reward=mario_hybrid.FOLLOWS, discount=0.9)
"""A* on the model of Mario alone, which learns what it is to meet things."""
LEARNERS = {"values": mario_hybrid.BEST_VALUES, "encounters": ENCOUNTERS}
"""What learns: values of things, in the learner under a search of a few steps, or encounters, in the model of A*."""


def frozen(learner: RelationalHORDQ) -> RelationalHORDQ:
    """The learner as it plays: without exploration."""
    return learner.replaced({"epsilon": 0.0, "step_size": 0.01})


class LevelPlayer:
    """Plays levels without exploring or learning; compiled once for all of them.

    Args:
        env: the levels.
        learner: what decides, at every step as at the first of an episode; without schedules. One without tables, which
            cannot learn, goes on as in training.
        cores: cores to use; all if None.
    """

    def __init__(self, env: Mario, learner: AnyLearner, cores: int | None = None):
        self.env, self.learner, self.cores = env, learner, cores
        self._prepared = learner.prepare(env)
        self._mapping: Literal["native", "vmap"] = batch.resolve_mapping("auto")
        self._compiled = batch.compile_mapped(self._game, self._mapping, nested=env.has_loops)

    def untrained(self) -> Any:
        """The learner's tables before it has learned anything."""
        return jax.tree.map(np.asarray, self.learner.init(self.env, self._prepared).tables)

    def play(self, tables: Any, levels: Sequence[int] | None = None) -> dict[str, np.ndarray]:
        """Plays some levels, each once.

        Args:
            tables: what the learner has learned; may come from an environment of other levels.
            levels: numbers of the levels; all if None.

        Returns:
            By name, for every level: ``win``, ``distance`` (tiles), ``length`` (steps), ``return``; ``[L]`` float32.
        """
        numbers = np.asarray(range(self.env.course.num_levels) if levels is None else levels, np.int32)
        everywhere = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(numbers), *np.shape(leaf))), tables)
        rows = (numbers, everywhere)
        results = batch.run_many(self._compiled, rows, mapping=self._mapping, cores=self.cores, chunk_size=1)
        if not results.finished.all():
            raise KeyboardInterrupt
        return results.values

    def _game(self, row: tuple[Array, Any]) -> dict[str, Array]:
        level, tables = row
        env, learner = self.env, self.learner
        zero = opaque_zero(level.astype(jnp.uint32))
        context = Context(jnp.int32(0), jnp.bool_(True), zero)
        words = (jnp.uint32(0),) * max(learner.num_begin_words, learner.num_words)
        may_learn = bool(jax.tree.leaves(tables))

        def step(carry: tuple[Episode, Any, Array, Events]) -> tuple[Episode, Any, Array, Events]:
            before, kept, _, sums = carry
            control = learner.begin(self._prepared, tables, before, words, context) if may_learn else kept
            action = learner.action(control)
            state, reward, terminated, info = env.transition(before, action, (), env.default_params)
            if not may_learn:
                told = Transition(before, action, reward, state, terminated)
                after = learner.learn(self._prepared, LearnerState(tables, control), told, words, context)
                assert isinstance(after, LearnerState)
                kept = after.control
            new = {"win": info["win"], "distance": info["distance"], "length": jnp.float32(1), "return": reward}
            return state, kept, terminated, {name: sums[name] + jnp.float32(value) for name, value in new.items()}

        sums: dict[str, Array] = {name: jnp.float32(0) for name in _COUNTED}
        first = begin(env.course, level, env.quantum)
        kept = () if may_learn else learner.begin(self._prepared, tables, first, words, context)
        start = (first, kept, jnp.bool_(False), sums)
        return lax.while_loop(lambda carry: ~carry[2], step, start)[3]


def trained_tables(
    level_set: LevelSet, learner: RelationalHORDQ, seeds: int, num_episodes: int, **options: Any
) -> list[Tables]:
    """What each seed has learned on a set of levels; `options` as of `hrljax.sweep`."""
    env = level_set.environment
    curves = sweep(env, learner, seeds=seeds, num_episodes=num_episodes, chunk_size=1, keep_learned=True, **options)
    if not curves.attrs["complete"]:
        raise KeyboardInterrupt
    return [Learned.of(curves, env, learner, seed=seed).tables for seed in range(seeds)]


def rows(
    trained_on: Iterable[str],
    played: LevelSet,
    learner: RelationalHORDQ,
    seeds: int,
    num_episodes: int,
    cores: int | None = None,
    key: int = 0,
    report: Callable[[str], None] = lambda _: None,
) -> Iterator[list[Row]]:
    """For the model alone and every set that is trained on, a row for every type and difficulty."""
    for name in (UNTRAINED, *trained_on):
        report(name)
        playing = frozen(learner)
        if name == UNTRAINED:
            player = LevelPlayer(played.environment, playing.replaced({"pseudo_reward": mario_hybrid.FOLLOWS}), cores)
            tables = [player.untrained()]
        else:
            player = LevelPlayer(played.environment, playing, cores)
            tables = trained_tables(TRAINED_ON[name], learner, seeds, num_episodes, cores=cores, key=key)
        games = [player.play(learned) for learned in tables]
        by_level = {of: np.stack([game[of] for game in games]) for of in games[0]}
        yield list(by_kind(name, played, by_level))


def by_kind(name: str, played: LevelSet, by_level: dict[str, np.ndarray]) -> Iterator[Row]:
    """A row for every type and difficulty, from arrays of seeds and levels."""
    kinds = np.array([kind[:2] for kind in played.table])
    for level_type in played.level_types:
        for difficulty in played.difficulties:
            of_kind = (kinds == (level_type, difficulty)).all(axis=1)
            wins = xr.DataArray(by_level["win"][:, of_kind].mean(axis=1), dims="seed")
            yield {
                "trained_on": name,
                "level_type": level_type,
                "difficulty": difficulty,
                "finished": interval_row(stats.mean_interval(wins)),
                "distance": float(by_level["distance"][:, of_kind].mean()),
                "return": float(by_level["return"][:, of_kind].mean()),
                "length": float(by_level["length"][:, of_kind].mean()),
                "levels": int(of_kind.sum()),
                "seeds": len(wins),
            }


def table(rows: Sequence[Row], of: Literal["finished", "distance"] = "finished") -> str:
    """Percent of levels finished, or mean distance: a line for every set that was trained on and every type."""
    difficulties = sorted({row["difficulty"] for row in rows})
    heads = "".join(f"{'d = ' + str(d):>8}" for d in difficulties)
    lines = [f"{'trained on':26}{'type':>5}  {heads}{'mean':>8}"]
    for name in dict.fromkeys(row["trained_on"] for row in rows):
        for level_type in sorted({row["level_type"] for row in rows}):
            of_type = [row for row in rows if (row["trained_on"], row["level_type"]) == (name, level_type)]
            values = [_shown(row, of) for row in sorted(of_type, key=lambda row: row["difficulty"])]
            cells = "".join(f"{value:8.0f}" for value in (*values, np.mean(values)))
            lines.append(f"{name:26}{level_type:5}  {cells}")
    what = "percent finished" if of == "finished" else "mean distance (tiles)"
    lines.append(f"{what} of {rows[0]['levels']} levels of each type and difficulty d that nothing was trained on")
    return "\n".join(lines)


def _shown(row: Row, of: Literal["finished", "distance"]) -> float:
    return 100 * row["finished"]["mean"] if of == "finished" else row["distance"]


def picture(rows: Sequence[Row]) -> Figure:
    """Mean distance by type and difficulty, a panel for every set that was trained on."""
    names = list(dict.fromkeys(row["trained_on"] for row in rows))
    types, difficulties = (sorted({row[of] for row in rows}) for of in ("level_type", "difficulty"))
    figure = Figure(figsize=(3.1 * len(names) + 0.8, 2.6), layout="constrained")
    axes = figure.subplots(1, len(names), squeeze=False)[0]
    image = None
    for ax, name in zip(axes, names, strict=True):
        values = np.zeros((len(types), len(difficulties)))
        for row in (row for row in rows if row["trained_on"] == name):
            values[types.index(row["level_type"]), difficulties.index(row["difficulty"])] = row["distance"]
        image = ax.imshow(values, vmin=0, vmax=_EXIT_DISTANCE, cmap="viridis")
        for (i, j), value in np.ndenumerate(values):
            ax.text(j, i, f"{value:.0f}", ha="center", va="center", color="white" if value < 190 else "black")
        ax.set_xticks(range(len(difficulties)), [str(d) for d in difficulties])
        ax.set_yticks(range(len(types)), [str(t) for t in types])
        ax.set_title(f"trained on {name}" if name != UNTRAINED else "the model alone", fontsize="medium")
        ax.set_xlabel("difficulty")
    axes[0].set_ylabel("level type")
    assert image is not None
    figure.colorbar(image, ax=axes, label="distance (tiles)", shrink=0.8)
    return figure
