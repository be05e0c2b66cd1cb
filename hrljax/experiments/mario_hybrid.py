"""Infinite Mario by a model, by relational TD learning and by both (thesis Table 4.1 and Figure 4.5)."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import xarray as xr
from matplotlib.figure import Figure

from hrljax import plots, stats
from hrljax.core.numerics import opaque_zero
from hrljax.engine.train import train
from hrljax.envs.film import save_gif
from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.drawing import picture
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.play import Action, Policy, Step, play
from hrljax.experiments.rows import Row, interval_row
from hrljax.learners.base import Context
from hrljax.learners.hyperparameters import with_tabulated_schedules
from hrljax.learners.relational.a_star_root import AStarRoot
from hrljax.learners.relational.given_model import MarioDynamics
from hrljax.learners.relational.learner import RelationalHORDQ, Tables
from hrljax.learners.relational.memory_model import MarioMemory
from hrljax.learners.relational.multiway_model import MultiwayModel
from hrljax.learners.relational.search_root import PlanningRoot, SearchRoot
from hrljax.search.a_star import AStarResult
from hrljax.search.best_first import SearchResult
from hrljax.sweeps.sweep import sweep

PSEUDO_REWARDS = (0.0, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0)
FOLLOWS = 1e6
"""A pseudo-reward that no value reaches: the agent follows its root."""
WINDOW = 20
"""Episodes of the moving average in the picture."""
THESIS = {"SARSA": 1, "Model": 0, "Model+HORDQ(10)": 277, "Model+HORDQ(20)": 64}
"""Levels finished in 1000 episodes (thesis Table 4.1)."""


def _halved(start: float, every: int, end: float) -> optax.Schedule:
    """Constant for 100 episodes, then halved in every so many, down to `end`."""
    return optax.exponential_decay(start, every, 0.5, transition_begin=100, end_value=end)


ROOTS = {
    "learned": SearchRoot(),
    "given": SearchRoot(model=MarioDynamics(), priority="last_reward", answer="leaf"),
    "remembers": SearchRoot(
        model=MultiwayModel(rows=20_000, pessimism=5.0, weighted=False, memory=True, death_decay=0.8),
        max_nodes=1000,
        priority="last_reward",
        answer="sequence",
    ),
}
"""The thesis's root, which learns its model; one that is given Mario's own dynamics in a level without things; and one
with the thesis's inputs and the best learned model that was found: whole plans on Orange's trees, and a memory."""
BEST_VALUES = RelationalHORDQ(
    SearchRoot(stop_reward=12.0, model=MarioDynamics(), max_nodes=600, priority="last_reward", answer="leaf"),
    pseudo_reward=15.0,
    step_size=_halved(0.1, every=100, end=0.01),
    epsilon=_halved(0.001, every=100, end=0.0001),
    discount=0.9,
    trace_decay=0.8,
    trace_length=12,
)
"""The best learner of values over the given model that was found by sweeps on this level: not the thesis's."""
BEST_GIVEN = RelationalHORDQ(
    AStarRoot(model=MarioMemory()), pseudo_reward=FOLLOWS, epsilon=_halved(0.01, every=50, end=0.00001)
)
"""A* on the given model, which learns what it is to meet things and remembers: the best found with a given model."""
BEST_LEARNED = replace(
    BEST_VALUES,
    root=ROOTS["remembers"],
    step_size=0.1,
    epsilon=_halved(0.01, every=50, end=0.00001),
    bias="shared",
)
"""The best configuration with a learned model that was found."""
BEST = {"best found, given model": BEST_GIVEN, "best found, learned model": BEST_LEARNED}
"""By name the best that was found."""


def environment() -> Mario:
    """The thesis's level: seed 1247, type 0, difficulty 3."""
    return Mario(preset="thesis")


def name_of(pseudo_reward: float) -> str:
    return "Model" if pseudo_reward >= FOLLOWS else f"Model+HORDQ({pseudo_reward:g})"


def run(
    env: Mario,
    root: PlanningRoot,
    seeds: int,
    num_episodes: int,
    pseudo_rewards: Iterable[float],
    best: Iterable[str] = (),
    stores: Path | None = None,
    **options: Any,
) -> Iterator[tuple[str, xr.Dataset]]:
    """Every method's name and curve, one bin an episode, those of `BEST` that are named at last; `options` as of
    `hrljax.sweep`.

    Runs are kept in `stores`, a store for each method, and those that are there are not run again. Ends with a method
    that was interrupted.
    """
    hybrid = RelationalHORDQ(root)
    methods: list[tuple[str, RelationalHORDQ, list[float]]] = [("SARSA", RelationalHORDQ(), [])]
    methods += [(name_of(k), hybrid, [k]) for k in pseudo_rewards]
    methods += [(name, BEST[name], []) for name in best]
    for name, learner, pseudo_reward in methods:
        # An axis of one value is no constant of the program, which is the same for every pseudo-reward.
        axes = {"pseudo_reward": pseudo_reward} if pseudo_reward else None
        store = stores and stores / f"{name}.zarr"
        common = {"seeds": seeds, "num_episodes": num_episodes, "bin_size": 1, "chunk_size": 1, **options}
        curve = sweep(env, learner, axes=axes, store=store, **common)
        yield name, curve.squeeze("pseudo_reward") if axes else curve
        if not curve.attrs["complete"]:
            return


def summary_row(name: str, dataset: xr.Dataset) -> Row:
    """What one method did: levels finished in all episodes of a run, and how far it came."""
    episodes = dataset.sizes["episode"]
    per_run = dataset["win"].sum("episode", skipna=False)
    return {
        "name": name,
        "finished": interval_row(stats.mean_interval(per_run)),
        "finished_by_seed": [None if np.isnan(count) else int(count) for count in per_run.values],
        "thesis": THESIS.get(name),
        "distance": interval_row(stats.mean_interval(dataset["distance"].mean("episode", skipna=False))),
        "return": interval_row(stats.mean_interval(dataset["return"].mean("episode", skipna=False))),
        "deaths": float(dataset["death"].mean()) * episodes,
        "steps": float(dataset["steps"].mean()),
        "seeds": int(per_run.notnull().sum()),
        "episodes": episodes,
    }


def table(rows: list[Row]) -> str:
    """The rows as text."""
    lines = [f"{'':22}{'levels finished':>16}  {'95 %':>15}{'thesis':>8}{'distance':>10}{'return':>9}{'steps':>9}"]
    for row in rows:
        low, high = row["finished"]["lo"], row["finished"]["hi"]
        ends = "" if low is None else f"{low:.1f} to {high:.1f}"
        thesis = "" if row["thesis"] is None else str(row["thesis"])
        lines.append(
            f"{row['name']:22}{row['finished']['mean']:16.1f}  {ends:>15}{thesis:>8}{row['distance']['mean']:10.1f}"
            f"{row['return']['mean']:9.1f}{row['steps']:9.0f}"
        )
    lines.append(f"of {rows[0]['episodes']} episodes, mean of {rows[0]['seeds']} seeds; distance in tiles")
    return "\n".join(lines)


def differences(curves: dict[str, xr.Dataset], of: str) -> dict[str, dict[str, float | None]]:
    """By how many finished levels a method is ahead of each of the others, run by run of the same seed."""
    finished = {name: curve["win"].sum("episode", skipna=False) for name, curve in curves.items()}
    return {
        name: interval_row(stats.mean_interval(stats.paired_differences(finished[of], others)))
        for name, others in finished.items()
        if name != of
    }


def differences_table(ahead: dict[str, dict[str, float | None]], of: str) -> str:
    """What `differences` gives, as text."""
    lines = [f"{of} less{'':18}{'levels':>6}  {'95 %':>17}"]
    for name, row in ahead.items():
        ends = "" if row["lo"] is None else f"{row['lo']:.1f} to {row['hi']:.1f}"
        lines.append(f"  {name:{len(of) + 21}}{row['mean']:6.1f}  {ends:>17}")
    return "\n".join(lines)


def distance_picture(curves: dict[str, xr.Dataset]) -> Figure:
    """The distance that Mario moves in each episode (thesis Figure 4.5)."""
    figure = Figure(figsize=(9, 5.2), layout="constrained")
    ax = plots.learning_curves(curves, "distance", window=WINDOW, ax=figure.subplots())
    ax.set_ylabel(f"distance (tiles), moving average over {WINDOW} episodes")
    ax.set_title("Level 1247, type 0, difficulty 3; the exit is 316 tiles away")
    return figure


def counts_picture(rows: list[Row]) -> Figure:
    """Levels finished against the pseudo-reward, with the thesis's two."""
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    ax = figure.subplots()
    for x, row in enumerate(rows):
        reach = [[0.0], [0.0]]
        if row["finished"]["lo"] is not None:
            mean = row["finished"]["mean"]
            reach = [[mean - row["finished"]["lo"]], [row["finished"]["hi"] - mean]]
        ax.errorbar(x, row["finished"]["mean"], yerr=reach, fmt="o", color=plots.COLOURS[0], capsize=3)
        if row["thesis"] is not None:
            ax.plot(x, row["thesis"], "x", color=plots.COLOURS[1], ms=8)
    ax.set_xticks(range(len(rows)), [row["name"].replace("Model+HORDQ", "") for row in rows], rotation=30)
    ax.set_xlabel("method; a number is the pseudo-reward of Model+HORDQ")
    ax.set_ylabel(f"levels finished of {rows[0]['episodes']}")
    ax.set_title(f"circles: mean of {rows[0]['seeds']} seeds with 95 % intervals; crosses: the thesis")
    ax.spines[["top", "right"]].set_visible(False)
    return figure


class Agent:
    """A trained agent that plays without learning on."""

    def __init__(self, env: Mario, learner: RelationalHORDQ, tables: Tables):
        self.env, self.learner, self.tables = env, learner, tables
        prepared = learner.prepare(env)
        settled = with_tabulated_schedules(learner, 1)

        def decide(tables: Tables, episode: Episode, word: jax.Array) -> jax.Array:
            context = Context(jnp.int32(0), jnp.bool_(True), opaque_zero(word))
            return settled.begin(prepared, tables, episode, (word,), context).action

        def search(tables: Tables, episode: Episode) -> SearchResult | AStarResult:
            assert learner.root is not None
            return learner.root.search(env, tables.root, episode)

        self._decide, self.search = jax.jit(decide), jax.jit(search)

    def policy(self, seed: int) -> Policy:
        """Chooses as the learner does, exploration included."""
        random = np.random.default_rng(seed)

        def choose(episode: Episode) -> Action:
            word = jnp.uint32(random.integers(1 << 24))
            return self.env.action_table[int(self._decide(self.tables, episode, word))]

        return choose


def trained(env: Mario, learner: RelationalHORDQ, num_episodes: int, key: jax.Array) -> Agent:
    """An agent after one run."""
    learned = jax.jit(lambda key: train(env, learner, key, num_episodes, bin_size=num_episodes).learned)(key)
    return Agent(env, learner, learned)


def best_game(agent: Agent, tries: int, report: Callable[[int], None] = lambda _: None) -> list[Step]:
    """The first finished game of some, or the one that came farthest."""
    twin = Mario(seeds=agent.env.seeds, level_type=agent.env.level_type, difficulty=agent.env.difficulty,
                 width=agent.env.width, levels=agent.env.levels, preset=agent.env.preset, actions="all")  # fmt: skip
    best: list[Step] = []
    for seed in range(tries):
        steps = list(play(twin, agent.policy(seed)))
        report(seed)
        if not best or _place(steps) > _place(best):
            best = steps
        if int(steps[-1].episode.world.player.win_time) > 0:
            break
    return best


def _place(steps: list[Step]) -> float:
    return float(steps[-1].episode.world.player.x)


def film(agent: Agent, steps: list[Step], path: str | Path) -> None:
    """A GIF of a game, one picture every second tick."""
    worlds = [world for step in steps for world in step.worlds][::2]
    save_gif((picture.screen(agent.env.course, world, tile_pixels=16) for world in worlds), path, fps=12)
