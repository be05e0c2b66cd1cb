"""Learning curves for the pages of learners, each beside what it is compared with."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import hrljax as hrl

SEEDS = 100


def curves(env: Any, learners: Mapping[str, Any], episodes: int, **options: Any) -> Figure:
    """A picture of what `draw_curves` draws."""
    figure = Figure(figsize=(7.5, 4), layout="constrained")
    draw_curves(figure.subplots(), env, learners, episodes, **options)
    return figure


def draw_curves(
    ax: Axes,
    env: Any,
    learners: Mapping[str, Any],
    episodes: int,
    *,
    window: int,
    lowest: float,
    title: str,
    params: Any = None,
    seeds: int = SEEDS,
) -> None:
    """Returns per episode, exploration included, and the exact optimum; prints what pages say of the curves."""
    runs = {
        name: hrl.sweep(env, learner, seeds=seeds, num_episodes=episodes, params=params, progress=False)
        for name, learner in learners.items()
    }
    optimum = env.initial_distribution(params) @ hrl.solvers.value_iteration(env.model(params)).value
    hrl.plots.learning_curves(runs, window=window, ax=ax, references={"optimum": float(optimum)})
    ax.set_title(f"{title}, {seeds} seeds")
    ax.set_ylim(lowest, float(optimum) + 0.06 * (float(optimum) - lowest))
    for name, run in runs.items():
        returns = run["return"]
        parts = {"last eighth": returns[:, -max(1, run.sizes["episode"] // 8) :], "all": returns}
        means = {part: hrl.stats.mean_interval(of.mean("episode")) for part, of in parts.items()}
        said = [f"{part} {float(of['mean']):.2f} ± {float(of['high'] - of['mean']):.2f}" for part, of in means.items()]
        print(f"{title}, {name}: {', '.join(said)}", flush=True)


def rooms(learners: Mapping[str, Any], episodes: int = 150) -> Figure:
    return curves(hrl.make("Gridworld"), learners, episodes, window=5, lowest=-200, title="Four rooms")


def maze(learners: Mapping[str, Any]) -> Figure:
    return curves(hrl.make("Maze"), learners, 150, window=5, lowest=-30, title="Maze")


def taxi(learners: Mapping[str, Any]) -> Figure:
    return curves(hrl.make("Taxi"), learners, 500, window=20, lowest=-120, title="Taxi")


def bus(learners: Mapping[str, Any]) -> Figure:
    return curves(hrl.make("Bus"), learners, 5_000, window=100, lowest=-120, title="Bus")


def q_learning() -> Figure:
    return maze({f"step_size={alpha:g}": hrl.QLearning(step_size=alpha) for alpha in (0.05, 0.2, 1.0)})


def sarsa() -> Figure:
    env = hrl.make("Gridworld", map="cliff")
    learners = {"SARSA(0)": hrl.SARSA(step_size=0.5), "Q-learning": hrl.QLearning(step_size=0.5)}
    return curves(env, learners, 500, window=20, lowest=-100, title="Cliff")


def traces() -> Figure:
    return rooms(
        {
            "SARSA(0.9)": hrl.SARSALambda(step_size=0.2),
            "Q(0.9)": hrl.QLambda(step_size=0.2),
            "SARSA(0)": hrl.SARSA(step_size=0.2),
            "Q-learning": hrl.QLearning(step_size=0.2),
        }
    )


def dyna_q() -> Figure:
    return rooms({f"planning_steps={n}": hrl.DynaQ(step_size=0.2, planning_steps=n) for n in (0, 5, 50)})


def r_max() -> Figure:
    return maze(
        {
            "R-MAX": hrl.RMax(known_after=1),
            "Dyna-Q": hrl.DynaQ(step_size=0.5),
            "Q-learning": hrl.QLearning(step_size=0.5),
        }
    )


def rl_dt() -> Figure:
    """The effects of actions said in two ways, and a forest, beside learners that do not generalise."""
    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2)

    def learners(known_after: int, **options: Any) -> dict[str, Any]:
        options |= {"optimistic_value": 20.0}
        return {
            "RL-DT, relative effects": hrl.RLDT(**options),
            "RL-DT, absolute effects": hrl.RLDT(effects="absolute", **options),
            "R-MAX": hrl.RMax(optimistic_value=20.0, known_after=known_after),
        }

    dyna = hrl.DynaQ(step_size=0.5, planning_steps=50)
    draw_curves(
        left, hrl.make("Taxi"), learners(1) | {"Dyna-Q": dyna}, 120, window=5, lowest=-400, title="Taxi", seeds=20
    )
    of_chance = learners(5, refit_interval=10) | {
        "Dyna-Q": hrl.DynaQ(step_size=0.2, planning_steps=50, outcomes_kept=8),
        "RL-DT, a forest of five": hrl.RLDT(optimistic_value=20.0, refit_interval=10, num_trees=5),
    }
    stochastic = hrl.make("Taxi", stochastic=True)
    draw_curves(right, stochastic, of_chance, 200, window=10, lowest=-400, title="Stochastic Taxi", seeds=8)
    return figure


def sdyna() -> Figure:
    learners = {
        "SPITI": hrl.SPITI(least_score=4.0),
        "RL-DT": hrl.RLDT(),
        "R-MAX": hrl.RMax(known_after=1),
        "Q-learning": hrl.QLearning(step_size=0.5),
    }
    return curves(hrl.make("Maze"), learners, 60, window=3, lowest=-60, title="Maze", seeds=20)


def kwik() -> Figure:
    learners = {
        "KWIK-R-MAX": hrl.KWIKRMax(optimistic_value=20.0),
        "R-MAX": hrl.RMax(optimistic_value=20.0, known_after=5),
    }
    env = hrl.make("Taxi", stochastic=True)
    return curves(env, learners, 200, window=5, lowest=-400, title="Stochastic Taxi", seeds=10)


def options() -> Figure:
    env = hrl.make("Gridworld")
    ways = hrl.options_from(env.hierarchy(), env)
    return rooms(
        {
            "options, SMDP": hrl.OptionQ(ways, step_size=0.2),
            "options, intra-option": hrl.OptionQ(ways, step_size=0.2, update="intra_option"),
            "Q-learning": hrl.QLearning(step_size=0.2),
        }
    )


def discovered_options() -> Figure:
    env = hrl.make("Gridworld")
    discovered = {"to a bottleneck": hrl.bottleneck_options(env), "eigen-options": hrl.eigen_options(env)}
    figure = Figure(figsize=(12, 4.2), layout="constrained")
    first, second, right = figure.subplots(1, 3, width_ratios=(1, 1, 1.3))
    for ax, options in zip((first, second), discovered.values(), strict=True):
        hrl.plots.policy(env, np.where(options.initiation[0], options.policy[0], -1), ax)
        ax.set_title(options.names[0])
    learners = {name: hrl.OptionQ(options, step_size=0.2) for name, options in discovered.items()}
    learners |= {"hallways, given": hrl.OptionQ(hrl.options_from(env.hierarchy(), env), step_size=0.2)}
    learners |= {"Q-learning": hrl.QLearning(step_size=0.2)}
    runs = {
        name: hrl.sweep(env, learner, seeds=SEEDS, num_episodes=150, progress=False)
        for name, learner in learners.items()
    }
    hrl.plots.learning_curves(runs, window=5, ax=right)
    right.set_ylim(-800, 0)
    right.set_title(f"Four rooms, {SEEDS} seeds")
    return figure


def h_dyna() -> Figure:
    env = hrl.make("Gridworld")
    ways = hrl.options_from(env.hierarchy(), env)
    return rooms(
        {
            "H-DYNA": hrl.HDyna(ways, step_size=0.5),
            "options, SMDP": hrl.OptionQ(ways, step_size=0.5),
            "Dyna-Q": hrl.DynaQ(step_size=0.5),
            "Q-learning": hrl.QLearning(step_size=0.5),
        },
        episodes=60,
    )


def linear_dyna() -> Figure:
    env = hrl.make("Bus")
    features, subtasks = hrl.variable_features(env), {"hierarchy": env.hierarchy(), "initial_value": -25.0}
    learners = {
        "HORDQ under a linear root": hrl.SharedHORDQ(root=hrl.LinearRoot(features), **subtasks),
        "HORDQ under the model-based root": hrl.SharedHORDQ(root=hrl.ModelRoot(), **subtasks),
        "Q-learning": hrl.QLearning(initial_value=-25.0),
        "linear Dyna alone": hrl.LinearDyna(features, initial_value=-25.0),
    }
    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    short = {
        name: hrl.sweep(env, learner, seeds=20, num_episodes=500, progress=False) for name, learner in learners.items()
    }
    hrl.plots.learning_curves(short, window=20, ax=left)
    left.set_title("Bus, 20 seeds")
    del learners["linear Dyna alone"]
    long = {
        name: hrl.sweep(env, learner, seeds=20, num_episodes=20_000, progress=False)
        for name, learner in learners.items()
    }
    hrl.plots.learning_curves(long, window=1000, ax=right, references={"optimum": -24.59})
    right.set_ylim(-80, -23)
    right.set_title("the same for longer")
    return figure


def biased_roots() -> Figure:
    """HORDQ under roots whose models are biased."""
    env = hrl.make("Bus")
    subtasks = {"hierarchy": env.hierarchy(), "initial_value": -25.0}
    trees = hrl.RLDTRoot(refit_interval=2000, planning_sweeps=50)
    linear = hrl.LinearRoot(hrl.variable_features(env))
    learners = {
        "shared HORDQ, RL-DT root": hrl.SharedHORDQ(root=trees, **subtasks),
        "shared HORDQ, linear root": hrl.SharedHORDQ(root=linear, **subtasks),
        "HORDQ, pseudo_reward=5, RL-DT root": hrl.HORDQ(root=trees, pseudo_reward=5.0, **subtasks),
        "HORDQ, pseudo_reward=5, linear root": hrl.HORDQ(root=linear, pseudo_reward=5.0, **subtasks),
        "HORDQ, fading, RL-DT root": hrl.HORDQ(root=trees, pseudo_reward=hrl.Fading(), **subtasks),
        "Q-learning": hrl.QLearning(initial_value=-25.0),
    }
    return curves(env, learners, 20_000, window=1000, lowest=-60, title="Bus", seeds=12)


def feudal_q() -> Figure:
    learners = {
        "feudal Q-learning, 3 scales": hrl.FeudalQ(step_size=0.5),
        "feudal Q-learning, 2 scales": hrl.FeudalQ(2, step_size=0.5),
        "the same, ties at random": hrl.FeudalQ(2, step_size=0.5, ties="random"),
        "Q-learning": hrl.QLearning(step_size=0.5),
    }
    env = hrl.make("Gridworld", map="barrier")
    return curves(env, learners, 150, window=5, lowest=-200, title="Barrier")


def hamq() -> Figure:
    hierarchy = hrl.make("Taxi").hierarchy()
    return taxi({"HAMQ": hrl.HAMQ(hierarchy, step_size=0.5), "Q-learning": hrl.QLearning(step_size=0.5)})


def maxq() -> Figure:
    hierarchy = hrl.make("Taxi").hierarchy()
    return taxi(
        {
            "MAXQ-Q, pseudo_reward=20": hrl.MAXQ(hierarchy, step_size=0.5, pseudo_reward=20.0),
            "MAXQ-0": hrl.MAXQ0(hierarchy, step_size=0.5),
            "Q-learning": hrl.QLearning(step_size=0.5),
        }
    )


def hordq() -> Figure:
    hierarchy, root = hrl.make("Bus").hierarchy(), hrl.ModelRoot()
    learners = {
        f"HORDQ, pseudo_reward={kappa:g}": hrl.HORDQ(hierarchy, root=root, initial_value=-25.0, pseudo_reward=kappa)
        for kappa in (0.0, 5.0, 60.0)
    }
    return bus(learners | {"Q-learning": hrl.QLearning(initial_value=-25.0)})


def shared_hordq() -> Figure:
    hierarchy, root = hrl.make("Bus").hierarchy(), hrl.ModelRoot()
    return bus(
        {
            "shared, fading": hrl.SharedHORDQ(hierarchy, root=root, initial_value=-25.0),
            "shared, pseudo_reward=5": hrl.SharedHORDQ(hierarchy, root=root, initial_value=-25.0, pseudo_reward=5.0),
            "HORDQ, pseudo_reward=5": hrl.HORDQ(hierarchy, root=root, initial_value=-25.0, pseudo_reward=5.0),
            "Q-learning": hrl.QLearning(initial_value=-25.0),
        }
    )


def roots() -> Figure:
    hierarchy = hrl.make("Bus").hierarchy()
    kinds = {"ModelRoot()": hrl.ModelRoot(), "RandomRoot()": hrl.RandomRoot(), "None, which learns": None}
    return bus(
        {f"root={name}": hrl.SharedHORDQ(hierarchy, root=root, initial_value=-25.0) for name, root in kinds.items()}
    )


PICTURES: dict[str, Callable[[], Figure]] = {
    f"learners/{draw.__name__}": draw
    for draw in (
        q_learning,
        sarsa,
        traces,
        dyna_q,
        r_max,
        rl_dt,
        sdyna,
        kwik,
        options,
        discovered_options,
        h_dyna,
        linear_dyna,
        biased_roots,
        feudal_q,
        hamq,
        maxq,
        hordq,
        shared_hordq,
        roots,
    )
}
