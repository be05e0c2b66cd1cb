"""How often Mario finishes the thesis's level, by a model, by TD learning and by both (Table 4.1)."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import interruptible  # noqa: F401
import jax
from matplotlib.figure import Figure

from hrljax.envs.mario.env import Mario
from hrljax.experiments import mario_hybrid, program
from hrljax.experiments.mario_search_picture import largest_search, search_picture
from hrljax.experiments.rows import curves_csv
from hrljax.learners.relational.learner import RelationalHORDQ
from hrljax.learners.relational.search_root import PlanningRoot
from hrljax.sweeps import io

COMPARED = mario_hybrid.name_of(10.0)


@dataclass(frozen=True)
class Options:
    """Levels finished in 1000 episodes (thesis Table 4.1), for many pseudo-rewards.

    Writes table_4_1.csv (distance, wins and so on by episode), table_4_1.png (levels finished by
    pseudo-reward), figure_4_5.png (distance by episode), a Zarr store for every method, finished.gif (a
    finished level, or the farthest game), search.png (its largest search, drawn on the level) and summary.json: a
    list of "name", "finished" with "mean", "lo", "hi", "finished_by_seed", "thesis", "distance",
    "return", "deaths", "steps", "seeds", "episodes"; Model+HORDQ(10) has "ahead_of", too: by how many finished levels
    it is ahead of each other method, run by run of the same seed.
    """

    seeds: int = 10
    """Runs of each method."""
    episodes: int = 1000
    """Episodes of each run."""
    pseudo_rewards: tuple[float, ...] = (*mario_hybrid.PSEUDO_REWARDS, mario_hybrid.FOLLOWS)
    """Pseudo-rewards of Model+HORDQ; a million stands for the model alone."""
    model: Literal["learned", "remembers", "given"] = "learned"
    """The root: the thesis's regression trees, the best learned model, or Mario's own dynamics, given."""
    best: tuple[Literal["given", "learned"], ...] = ("given", "learned")
    """With which kinds of models to run the best configuration that was found, too."""
    film: bool = True
    """Whether to make the film and the picture of a search."""
    out: Path = Path("runs/table_4_1")
    """Folder for what is written."""
    stores: Path | None = None
    """Folder that keeps every finished run; what is in it of the same settings is not run again."""
    cores: int | None = None
    """Cores to use; all if not given."""
    key: int = 0
    """Seed of all random numbers."""


def main(options: Options) -> int:
    program.check_counts(options, "seeds", "episodes")
    options.out.mkdir(parents=True, exist_ok=True)
    env, root = mario_hybrid.environment(), mario_hybrid.ROOTS[options.model]
    runs = mario_hybrid.run(
        env,
        root,
        options.seeds,
        options.episodes,
        options.pseudo_rewards,
        [f"best found, {kind} model" for kind in options.best],
        options.stores,
        cores=options.cores,
        key=options.key,
    )
    curves, rows = {}, []
    for name, dataset in program.until_interrupted(runs):
        io.save(dataset, options.out / "curves" / f"{len(curves):02d}.zarr")
        curves[name] = dataset
        rows.append(mario_hybrid.summary_row(name, dataset))
    if not rows:
        return program.ended(options.out)
    ahead = mario_hybrid.differences(curves, COMPARED) if COMPARED in curves else {}
    for row in rows:
        row |= {"ahead_of": ahead} if row["name"] == COMPARED else {}
    program.write_summary(options.out, rows)
    (options.out / "table_4_1.csv").write_text(curves_csv(("", name, dataset) for name, dataset in curves.items()))
    mario_hybrid.counts_picture(rows).savefig(options.out / "table_4_1.png", dpi=110)
    shown = {name: curves[name] for name in (*mario_hybrid.THESIS, *mario_hybrid.BEST) if name in curves}
    mario_hybrid.distance_picture(shown).savefig(options.out / "figure_4_5.png", dpi=110)
    print(mario_hybrid.table(rows))
    if ahead:
        print(mario_hybrid.differences_table(ahead, COMPARED))
    if options.film:
        best = max(rows, key=lambda row: row["finished"]["mean"])["name"]
        for picture in program.until_interrupted(_pictures(env, _learner(best, root, options), options)):
            picture.savefig(options.out / "search.png", dpi=100)
    return program.ended(options.out)


def _pictures(env: Mario, learner: RelationalHORDQ, options: Options) -> Iterator[Figure]:
    """Makes the film, and gives the picture of a search."""
    agent = mario_hybrid.trained(env, learner, options.episodes, jax.random.key(options.key))
    game = mario_hybrid.best_game(agent, tries=20)
    mario_hybrid.film(agent, game, options.out / "finished.gif")
    yield search_picture(agent, game, largest_search(agent, game))


def _learner(name: str, root: PlanningRoot, options: Options) -> RelationalHORDQ:
    """The learner of a row that has a root to look into; the model alone in place of SARSA."""
    if name in mario_hybrid.BEST:
        return mario_hybrid.BEST[name]
    named = {mario_hybrid.name_of(k): k for k in options.pseudo_rewards}
    return RelationalHORDQ(root, pseudo_reward=named.get(name, mario_hybrid.FOLLOWS))


if __name__ == "__main__":
    program.run(main, Options)
