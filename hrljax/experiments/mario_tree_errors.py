"""How wrong trees are about steps that were held back, and about the steps that a search with them looks at.

A search takes steps that nobody took. So the game is played along every branch of its tree, and says what the actions
that lead to a node really bring.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.engine import compiler
from hrljax.envs.mario.competition import OBSERVED, PLAYING, Episode
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.levels.tiles import TILE
from hrljax.envs.mario.play import play
from hrljax.experiments import mario_hybrid
from hrljax.experiments.rows import Row
from hrljax.learners.relational.learned_model import MarioModel, Replay
from hrljax.learners.relational.multiway_model import Rows
from hrljax.learners.relational.screen_model import ModelTables, ScreenModel
from hrljax.learners.relational.search_root import SearchRoot
from hrljax.search.best_first import SearchResult, Tree

HELD_BACK = 5
"""One step of so many is held back."""
SEARCH = mario_hybrid.ROOTS["remembers"]
"""How is searched."""
_FATAL = np.float32(-25)
"""A predicted reward below this foresees a death, half of whose reward it is."""


class Material(NamedTuple):
    """What models are fitted to and judged by."""

    rows: np.ndarray  # [N, F + 7] float32: inputs, action, change, reward, whether it was the last one
    moments: Episode  # [M]: moments of games, to search from


def material(env: Mario, episodes: int, games: int, key: Array) -> Material:
    """All different steps of a run of the best learned configuration, and moments of games of that agent.

    Args:
        env: the level.
        episodes: of training.
        games: how many are played; each gives every fourth of its moments.
        key: of training.
    """
    agent = mario_hybrid.trained(env, mario_hybrid.BEST_LEARNED, episodes, key)
    learned: Any = agent.tables.root
    replay: Rows = learned.replay
    rows = np.asarray(replay.values).reshape(len(replay.weights), -1)[: int(replay.filled), :-1]
    everything = replace(env, actions="all")
    played = [list(play(everything, agent.policy(seed))) for seed in range(games)]
    moments = [step.episode for game in played for step in game[::4] if int(step.episode.phase) == PLAYING]
    return Material(rows, jax.tree.map(lambda *leaves: jnp.stack(leaves), *moments))


class Games(NamedTuple):
    """The games that the nodes of a search stand for, ``[nodes]``."""

    x: Array  # float32: Mario's place in pixels
    y: Array
    reward: Array  # float32: of the last step
    is_dead: Array  # bool
    was_over: Array  # bool: whether the game was over before its last step


@dataclass(frozen=True)
class Judged:
    """A model in a form that fits whatever rows it is given, and what is asked about it; compiled."""

    env: Mario
    model: ScreenModel

    @cached_property
    def fit(self) -> Any:
        def fit(rows: Array, count: Array) -> ModelTables:
            model, f = self.model, self.model.num_inputs
            if isinstance(model, MarioModel):
                group = jnp.where(rows[:, -1] > 0, np.int32(self.env.num_actions), rows[:, f].astype(jnp.int32))
                replay: Any = Replay(rows[:, : f + 1], rows[:, f + 1 : f + 5], rows[:, f + 5], group, count)
            else:
                empty: Rows = model.empty(self.env.num_actions)
                replay = empty._replace(values=rows.ravel(), weights=jnp.ones(len(rows)), filled=count)
            return ModelTables(replay, model.fit(replay, self.env.num_actions), ())

        return _compiled(fit)

    @cached_property
    def predictions(self) -> Any:
        """Change, reward and whether it is the last one, of every row: ``[N, 6]``."""

        def one(tables: ModelTables, row: Array) -> Array:
            f = self.model.num_inputs
            foreseen = self.model.foreseen(tables, row[:f], jnp.int32(0), row[f].astype(jnp.int32))
            ends = (foreseen.reward < _FATAL) | jnp.asarray(foreseen.ended)
            return jnp.stack([*foreseen.change, foreseen.reward, ends.astype(jnp.float32)])

        return _compiled(lambda tables, rows: lax.map(lambda row: one(tables, row), rows))

    @cached_property
    def search(self) -> Any:
        root: SearchRoot = replace(SEARCH, model=self.model)
        return _compiled(lambda tables, episode: root.search(self.env, tables, episode))


def _compiled(function: Any) -> Any:
    return jax.jit(function, compiler_options=compiler.nested_options())


def along(env: Mario) -> Any:
    """A compiled function that plays the game along every branch of a tree, from where its search began."""

    def games(tree: Tree, episode: Episode) -> Games:
        def one(node: Array, carry: tuple[Episode, Games]) -> tuple[Episode, Games]:
            episodes, games = carry
            before = jax.tree.map(lambda leaf: leaf[tree.parent[node]], episodes)
            after, reward, _, _ = env.transition(before, tree.action[node], (), env.default_params)
            player = after.world.player
            game = Games(player.x, player.y, reward, player.death_time > 0, before.phase == OBSERVED)
            put = lambda table, value: table.at[node].set(value)  # noqa: E731
            return jax.tree.map(put, episodes, after), jax.tree.map(put, games, game)

        count = len(tree.parent)
        episodes = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *leaf.shape)), episode)
        zeros, flags = jnp.zeros(count), jnp.zeros(count, jnp.bool_)
        start = episodes, Games(zeros, zeros, zeros, flags, flags)
        return lax.fori_loop(jnp.int32(1), tree.num_nodes, one, start)[1]

    return _compiled(games)


def compared(env: Mario, models: Mapping[str, ScreenModel], of: Material) -> Iterator[Row]:
    """What every model makes of the held-back steps and of the nodes of its searches."""
    is_held = np.random.default_rng(0).permutation(len(of.rows)) < len(of.rows) // HELD_BACK
    known, held = of.rows[~is_held], of.rows[is_held]
    # One row more, which nothing is fitted to, as models have it.
    padded = jnp.asarray(np.concatenate([known, np.zeros_like(known[:1])]))
    play_along = along(env)
    for name, model in models.items():
        judged = Judged(env, replace(model, rows=len(known)))
        tables = judged.fit(padded, jnp.int32(len(known)))
        searches = []
        for number in range(len(of.moments.time)):
            episode: Episode = jax.tree.map(lambda leaf, number=number: leaf[number], of.moments)
            result = judged.search(tables, episode)
            searches.append(looked_at(result, play_along(result.tree, episode)))
        yield {
            "name": name,
            "held_back": errors(held[:, model.num_inputs + 1 :], np.asarray(judged.predictions(tables, held))),
            "visited": _visited(searches),
            "rows": len(known),
            "searches": len(searches),
        }


def errors(real: np.ndarray, predicted: np.ndarray) -> Row:
    """Of rows: root of the mean squared error, and the share of deaths that were foreseen."""
    lasts = real[:, 5] > 0
    goes_on = real[~lasts, :2] - predicted[~lasts, :2]
    dies = lasts & (real[:, 4] < _FATAL)
    return {
        "x": _root_mean_square(goes_on[:, 0]),
        "y": _root_mean_square(goes_on[:, 1]),
        "reward": _root_mean_square(real[:, 4] - predicted[:, 4]),
        "deaths_foreseen": _share(predicted[dies, 5] > 0),
    }


def looked_at(result: SearchResult, games: Games) -> dict[str, np.ndarray]:
    """What a search looked at: of every node whose game was not over before, errors and deaths; and its plan."""
    result, games = jax.device_get((result, games))
    tree = result.tree
    values = {
        "depth": tree.depth,
        "x": (tree.state.x - games.x) / TILE,
        "y": (tree.state.y - games.y) / TILE,
        "reward": tree.reward - games.reward,
        "dies": games.reward < _FATAL,
        "foreseen": tree.reward < _FATAL,
    }
    is_real = ~games.was_over & (np.arange(len(tree.depth)) < tree.num_nodes) & (tree.depth > 0)
    of_plan = {"plan_dies": games.is_dead[result.node], "plan_says_so": result.value < _FATAL}
    return {name: value[is_real] for name, value in values.items()} | {k: np.array([v]) for k, v in of_plan.items()}


def _visited(searches: Sequence[dict[str, np.ndarray]]) -> Row:
    """Errors at the nodes of all searches together: of places after the first and the last step of a plan."""
    of = {name: np.concatenate([search[name] for search in searches]) for name in searches[0]}
    lives, depth = ~of["dies"], of["depth"]
    places = {
        f"{axis}_{steps}": _root_mean_square(of[axis][lives & (depth == steps)])
        for steps in (1, SEARCH.depth)
        for axis in ("x", "y")
    }
    return places | {
        "reward": _root_mean_square(of["reward"]),
        "deaths_foreseen": _share(of["foreseen"][of["dies"]]),
        "plans_that_die_unforeseen": _share(of["plan_dies"] & ~of["plan_says_so"]),
        "nodes": len(depth),
    }


def _root_mean_square(differences: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(differences)))) if len(differences) else float("nan")


def _share(which: np.ndarray) -> float:
    return float(which.mean()) if len(which) else float("nan")


def table(rows: Sequence[Row]) -> str:
    """The rows as text."""
    lines = [
        f"{'':18}{'held back':>30} |{'searched':>50}",
        f"{'trees':18}{'x':>7}{'y':>7}{'reward':>8}{'deaths':>8} |"
        f"{'x 1':>6}{'y 1':>6}{'x 6':>6}{'y 6':>6}{'reward':>8}{'deaths':>8}{'surprises':>11}",
    ]
    for row in rows:
        held, visited = row["held_back"], row["visited"]
        places = "".join(f"{visited[name]:6.2f}" for name in ("x_1", "y_1", "x_6", "y_6"))
        lines.append(
            f"{row['name']:18}{held['x']:7.3f}{held['y']:7.3f}{held['reward']:8.2f}{held['deaths_foreseen']:8.0%} |"
            f"{places}{visited['reward']:8.2f}{visited['deaths_foreseen']:8.0%}"
            f"{visited['plans_that_die_unforeseen']:11.0%}"
        )
    lines.append(f"fitted to {rows[0]['rows']} different steps, asked in {rows[0]['searches']} searches; in tiles")
    return "\n".join(lines)
