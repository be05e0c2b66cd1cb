"""How wrong Mario's trees are on held-back steps, and on the steps that a search with them looks at."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import interruptible  # noqa: F401
import jax

from hrljax.core import checks
from hrljax.experiments import mario_hybrid, mario_tree_errors, mario_tree_models, program
from hrljax.experiments.rows import Row


@dataclass(frozen=True)
class Options:
    """Errors of several kinds of trees, side by side, fitted to the steps of a run of the best learned configuration.

    Writes summary.json: a list of "name", "held_back" with "x", "y", "reward" (root of the mean squared error; tiles)
    and "deaths_foreseen" (a share), "visited" with the same of the nodes of searches, places after 1 and 6 steps and
    "plans_that_die_unforeseen" (a share), "rows" and "searches".
    """

    episodes: int = 100
    """Episodes of the run."""
    games: int = 10
    """Games from whose moments is searched."""
    models: tuple[str, ...] = tuple(mario_tree_models.MODELS)
    """Which kinds of trees."""
    out: Path = Path("runs/mario_tree_errors")
    """Folder for what is written."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    program.check_counts(options, "episodes", "games")
    for name in options.models:
        checks.choice("--models", name, tuple(mario_tree_models.MODELS))
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for row in program.until_interrupted(_rows(options)):
        rows.append(row)
        program.write_summary(options.out, rows)
    if rows:
        print(mario_tree_errors.table(rows))
    return program.ended(options.out)


def _rows(options: Options) -> Iterator[Row]:
    env = mario_hybrid.environment()
    models = {name: mario_tree_models.MODELS[name] for name in options.models}
    of = mario_tree_errors.material(env, options.episodes, options.games, jax.random.key(options.key))
    yield from mario_tree_errors.compared(env, models, of)


if __name__ == "__main__":
    program.run(main, Options)
