"""How far a search alone brings Mario under a model without errors: what thesis 4.2.3 leaves open, tried out.

The level has no monsters, so the given model is exact and whatever goes wrong is the search's.
"""

import itertools
from collections.abc import Iterable, Iterator

import numpy as np

from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.levels.ascii import to_ascii
from hrljax.experiments.mario_hybrid import FOLLOWS, environment
from hrljax.experiments.rows import Row
from hrljax.learners.relational.given_model import MarioDynamics
from hrljax.learners.relational.learner import RelationalHORDQ
from hrljax.learners.relational.search_root import SearchRoot
from hrljax.sweeps.sweep import sweep

UNLIMITED = 1e9
"""A reward that no sequence of actions promises."""
STOPS = (6.0, 12.0, UNLIMITED)


def empty_level() -> Mario:
    """The thesis's level without its monsters."""
    (level,) = environment().level_list
    return Mario(levels=(to_ascii(level._replace(spawns=np.zeros_like(level.spawns))),), preset="thesis")


def settings(more_nodes: Iterable[int]) -> Iterator[Row]:
    """The thesis's 300 nodes in all readings of its text, then more nodes as it is read by default."""
    for priority, answer, count in itertools.product(
        ("cumulative", "last_reward"), ("any", "leaf"), ("generated", "expanded")
    ):
        yield {"priority": priority, "answer": answer, "count": count, "max_nodes": 300}
    for max_nodes in more_nodes:
        yield {"priority": "cumulative", "answer": "any", "count": "generated", "max_nodes": max_nodes}


def rows(of: Iterable[Row], stops: tuple[float, ...] = STOPS, cores: int | None = None) -> Iterator[list[Row]]:
    """For every setting a game for every reward at which a search stops; there is no randomness in it.

    After an interrupt only games that were finished.
    """
    env = empty_level()
    for options in of:
        root = SearchRoot(model=MarioDynamics(), **options)
        learner = RelationalHORDQ(root, pseudo_reward=FOLLOWS, epsilon=0.0)
        axes = {"root.stop_reward": list(stops)}
        games = sweep(
            env, learner, seeds=1, num_episodes=1, bin_size=1, chunk_size=1, axes=axes, cores=cores, progress=False
        )
        by_stop = {stop: games.sel({"root.stop_reward": stop}).squeeze() for stop in stops}
        yield [
            {
                **options,
                "stop_reward": None if stop >= UNLIMITED else stop,
                "win": bool(game["win"]),
                "distance": float(game["distance"]),
                "length": int(game["length"]),
            }
            for stop, game in by_stop.items()
            if game["steps"].notnull()
        ]


def table_head() -> str:
    return f"{'priority':12} {'answer':7} {'nodes':>6} {'counted':10} {'stop':>5}  {'distance':>8} {'steps':>6}"


def table_line(row: Row) -> str:
    stop = "-" if row["stop_reward"] is None else f"{row['stop_reward']:g}"
    return (
        f"{row['priority']:12} {row['answer']:7} {row['max_nodes']:6} {row['count']:10} {stop:>5}  "
        f"{row['distance']:8.1f} {row['length']:6}  {'finished' if row['win'] else ''}"
    ).rstrip()
