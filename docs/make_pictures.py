"""Draws the pictures of environments and learners: ``python docs/make_pictures.py`` draws all, with names only those.

Pictures go to the folders of the pages that show them. Learning curves are means of `SEEDS` seeds.
"""

import sys
from collections.abc import Callable
from contextlib import chdir
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent))
import learner_pictures
from learner_pictures import SEEDS

import hrljax as hrl
from hrljax.experiments import mario_hybrid
from hrljax.experiments.mario_search_picture import largest_search, search_picture
from hrljax.interop.gymnasium import from_table

DOCS = Path(__file__).parent
PICTURES: dict[str, Callable[[], Figure]] = dict(learner_pictures.PICTURES)
"""What draws each picture, by its place below docs/, without ".png"."""
PAGES = {
    "first_picture": "start",
    "heat_map": "sweeps",
    "corridor": "own_environment",
    "corridor_policy": "own_environment",
    "environments/lake": "environments/from_table",
    "step_sizes": "own_learner",
    "guides/first_project": "guides/first_project",
    "guides/drawing": "guides/drawing",
}
"""Pictures that an example of a page saves, and these pages."""


def picture(place: str) -> Callable[[Callable[[], Figure]], Callable[[], Figure]]:
    def add(draw: Callable[[], Figure]) -> Callable[[], Figure]:
        PICTURES[place] = draw
        return draw

    return add


def three_maps(env: Any, height: float, titles: dict[str, dict[str, int]], state: Any = None) -> Figure:
    """A map, the optimal policy and the optimal value side by side.

    Args:
        env: the environment.
        height: of the figure, in inches.
        titles: of the three, each with what it shows of the state besides the cell.
        state: shown in the map.
    """
    solution = hrl.solvers.value_iteration(env.model())
    figure = Figure(figsize=(11, height), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    first, second, third = titles.items()
    hrl.plots.state(env, state, left)
    hrl.plots.policy(env, solution.policy, middle, **second[1])
    hrl.plots.value(env, solution.value, right, **third[1])
    for ax, (title, _) in zip((left, middle, right), (first, second, third), strict=True):
        ax.set_title(title)
    return figure


@picture("environments/bus")
def bus() -> Figure:
    figure = three_maps(hrl.make("Bus"), 4.1, {"Map": {}, "Optimal policy": {}, "Optimal value": {}})
    figure.supxlabel(
        "no passenger on board, no road under construction; S: start, P: passengers, A, B: sites, dotted: doors", size=9
    )
    return figure


@picture("environments/taxi")
def taxi() -> Figure:
    env = hrl.make("Taxi")
    waiting, aboard = {"passenger": 2, "destination": 1}, {"passenger": 4, "destination": 1}
    titles = {"A passenger at Y wants to G": {}, "Optimal policy": waiting, "Optimal value, passenger aboard": aboard}
    middle = env.decode((12 * 5 + 2) * 4 + 1)
    return three_maps(env, 4.1, titles, middle)


@picture("environments/maze")
def maze() -> Figure:
    env = hrl.make("Maze")
    return three_maps(env, 4.4, {"Two rooms, two doors": {}, "Optimal policy": {}, "Optimal value": {}}, env.decode(12))


@picture("environments/gridworld")
def gridworld() -> Figure:
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.35))
    rooms, cliff = hrl.make("Gridworld"), hrl.make("Gridworld", map="cliff")
    hrl.plots.policy(rooms, hrl.solvers.value_iteration(rooms.model()).policy, left)
    slippery = cliff.model(cliff.default_params._replace(slip_probability=0.2))
    hrl.plots.policy(cliff, hrl.solvers.value_iteration(slippery).policy, right)
    left.set_title("map='four_rooms', the default: optimal policy")
    right.set_title("map='cliff' with slip_probability=0.2: optimal policy")
    return figure


@picture("environments/boyanchain")
def boyan_chain() -> Figure:
    """Errors after so many episodes, each by runs of their own."""
    env = hrl.make("BoyanChain")
    matrix, episodes = env.interpolation(), np.array([1, 10, 25, 50, 75, 100])
    optimum = np.asarray(hrl.solvers.value_iteration(env.model()).value)

    def step_size(episode: Any) -> Any:
        return 10.1 / (100 + (jnp.asarray(episode, jnp.float32) + 1) ** 1.1)

    kinds: dict[str, dict[str, Any]] = {
        "no planning, TD(0)": {"planning_steps": 0},
        "planning at random": {"planning": "random"},
        "MG prioritized sweeping": {"planning": "mg"},
    }
    figure = Figure(figsize=(7.5, 4), layout="constrained")
    ax = figure.subplots()
    for name, options in kinds.items():
        learner = hrl.LinearDyna(
            hrl.Features.from_dense(matrix), step_size=step_size, model_step_size=step_size, **options
        )
        errors = []
        for number in episodes.tolist():
            runs = jax.jit(
                lambda keys, n=number, learner=learner: jax.lax.map(lambda key: hrl.train(env, learner, key, n), keys)
            )
            theta = np.asarray(runs(jax.random.split(jax.random.key(0), 30)).learned.theta)
            errors.append(np.sqrt(((theta @ matrix.T - optimum) ** 2).mean(1)))
        middle, spread = np.mean(errors, 1), np.std(errors, 1) / 30**0.5
        ax.plot(episodes, middle, marker=".", label=name)
        ax.fill_between(episodes, middle - 2 * spread, middle + 2 * spread, alpha=0.3)
    ax.set(yscale="log", xlabel="episodes", ylabel="root mean squared error", title="Boyan chain, 30 runs")
    ax.legend()
    return figure


@picture("environments/from_table")
def frozen_lake() -> Figure:
    lake = from_table(gymnasium.make("FrozenLake-v1", is_slippery=False))
    slippery = from_table(gymnasium.make("FrozenLake-v1"))
    curves = {
        name: hrl.sweep(
            env, hrl.QLearning(initial_value=1.0, discount=0.99), seeds=SEEDS, num_episodes=5_000, progress=False
        )
        for name, env in (("FrozenLake", lake), ("slippery FrozenLake", slippery))
    }
    figure = Figure(figsize=(7, 3.8), layout="constrained")
    optimum = slippery.initial_distribution() @ hrl.solvers.value_iteration(slippery.model()).value
    hrl.plots.learning_curves(
        curves, window=100, ax=figure.subplots(), references={"optimum, slippery, without a limit": float(optimum)}
    )
    return figure


@picture("search")
def search() -> Figure:
    """The largest search of a game of the best agent with a given model."""
    agent = mario_hybrid.trained(mario_hybrid.environment(), mario_hybrid.BEST_GIVEN, 1000, jax.random.key(0))
    game = mario_hybrid.best_game(agent, tries=20)
    return search_picture(agent, game, largest_search(agent, game))


def task_graph(env: Any) -> Figure:
    return hrl.plots.task_graph(env.hierarchy()).figure  # type: ignore[return-value]


for name, env in (
    ("bus", hrl.make("Bus")),
    ("taxi", hrl.make("Taxi")),
    ("maze", hrl.make("Maze")),
    ("gridworld", hrl.make("Gridworld")),
):
    PICTURES[f"environments/{name}_hierarchy"] = lambda env=env: task_graph(env)


def drawn_by_page(page: str, name: str) -> bytes:
    """What the examples of a page save under a name; they are run up to there."""
    blocks = [part.split("```")[0] for part in (DOCS / f"{page}.md").read_text().split("```python\n")[1:]]
    namespace: dict[str, Any] = {"__name__": "__main__"}
    with TemporaryDirectory() as folder, chdir(folder):
        for block in blocks:
            exec(block, namespace)
            if Path(name).exists():
                return Path(name).read_bytes()
    raise ValueError(f"{page}.md saves no {name}")


def drawn(place: str) -> bytes:
    """A picture as PNG."""
    if place in PAGES:
        return drawn_by_page(PAGES[place], f"{Path(place).name}.png")
    png = BytesIO()
    PICTURES[place]().savefig(png, dpi=100)
    return png.getvalue()


def save(png: bytes, path: Path) -> None:
    """Writes a PNG with a palette, which is a third of the size of one without."""
    path.parent.mkdir(exist_ok=True)
    Image.open(BytesIO(png)).convert("RGB").quantize(128).save(path, optimize=True)
    print(f"{path.relative_to(DOCS)}: {path.stat().st_size / 1000:.0f} kB", flush=True)


def main(names: list[str]) -> None:
    known = [*PICTURES, *PAGES]
    if unknown := set(names) - set(known):
        sys.exit(f"no picture {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    for place in names or known:
        save(drawn(place), DOCS / f"{place}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
