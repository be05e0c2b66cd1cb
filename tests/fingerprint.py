"""A fingerprint of results: digests of what many learners do and learn, to show which numbers a change has changed.

    python -m tests.fingerprint            # computes every case again and prints what differs from the record
    python -m tests.fingerprint --write    # makes the record

Only names that users have are needed, and a learned table is known by its numbers alone, so that modules, fields
and shapes inside the library may change.
"""

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import hrljax as hrl
from hrljax.interop.gymnasium import from_table
from tests.maps import SMALL

RECORD = Path(__file__).parent / "data" / "fingerprint.json"
LEARNED = "learned"
"""How names of variables begin that hold tables."""
ROOMS = "S....P\n.S.#..\n..S...\nP....G\n"


class Case(NamedTuple):
    """A sweep."""

    env: Any
    learner: Any
    params: dict[str, float] = {}
    axes: dict[str, list[float]] = {}
    num_episodes: int = 40
    evaluate_every: int | None = None
    seeds: int = 3


@cache
def make(name: str, **options: Any) -> Any:
    return hrl.make(name, **options)


def rooms() -> Any:
    return make("Gridworld", map=ROOMS)


def rooms_hierarchy() -> hrl.Hierarchy:
    """Chains of one to four subtasks; Shared has three parents, and cannot be invoked everywhere."""
    row, column = (jnp.asarray(numbers, jnp.int32) for numbers in np.divmod(np.arange(24), 6))

    def at(cells: Any) -> Callable[[Any], Any]:
        return lambda state: cells[state.cell]

    return hrl.Hierarchy(
        rooms().action_names,
        [
            hrl.Subtask("Root", ("Outer", "north", "Shared"), at(row < 0)),
            hrl.Subtask("Outer", ("Inner", "Shared", "east"), at(column >= 4), goal=at(column >= 4)),
            hrl.Subtask("Inner", ("Shared", "south"), at((row == 3) | (column == 5)), goal=at(row == 3)),
            hrl.Subtask(
                "Shared",
                ("west", "east", "north", "south"),
                at((column % 3 == 2) & (column != 5)),
                goal=at((column % 3 == 2) & (row >= 1)),
            ),
        ],
    )


def stepped(first: float, then: float) -> Callable[[Any], Any]:
    """A schedule without arithmetic: the last bit of an optax schedule depends on the version of JAX."""
    return lambda episode: jnp.where(episode < 15, jnp.float32(first), jnp.float32(then))


SLIPPERY = {"slip_probability": 0.3, "max_steps": 60}
USUAL: dict[str, Any] = {"step_size": 0.3, "epsilon": 0.2, "discount": 0.95, "initial_value": -10.0}


def _of_bus(learner: Callable[..., Any], **options: Any) -> Case:
    """A hierarchical learner on a small Bus domain."""
    axes = options.pop("axes", {})
    learner = learner(SMALL.hierarchy(), **USUAL | options)
    return Case(SMALL, learner, {"max_steps": 80}, axes)


def _of_rooms(learner: Callable[..., Any], **options: Any) -> Case:
    return Case(rooms(), learner(rooms_hierarchy(), **USUAL | options), SLIPPERY)


def _of_options(update: Any, **options: Any) -> Case:
    maze = make("Maze")
    chosen = hrl.options_from(maze.hierarchy(), maze, **options)
    return Case(maze, hrl.OptionQ(chosen, update=update, **USUAL), SLIPPERY, evaluate_every=20)


def _of_mario(learner: Any, **options: Any) -> Case:
    env = make("Mario", seeds=(2, 5), difficulty=10, preset="thesis", **options)
    return Case(env, learner, {"max_steps": 40}, {"pseudo_reward": [0.0, 5.0]}, num_episodes=4, seeds=2)


CASES: dict[str, Callable[[], Case]] = {
    "Q-learning, Bus, schedules, axes": lambda: Case(
        make("Bus"),
        hrl.QLearning(step_size=stepped(0.5, 0.1), epsilon=stepped(0.5, 0.2), discount=0.99),
        axes={"initial_value": [0.0, -25.0], "env.slip_probability": [0.05, 0.5]},
        num_episodes=60,
    ),
    "SARSA, small Bus, evaluated": lambda: Case(
        SMALL, hrl.SARSA(**USUAL), {"max_steps": 80}, {"step_size": [0.1, 0.9]}, evaluate_every=10
    ),
    "SARSA(lambda), cliff": lambda: Case(
        make("Gridworld", map="cliff"), hrl.SARSALambda(trace="accumulating", trace_length=9, **USUAL), SLIPPERY
    ),
    "Q(lambda), Maze": lambda: Case(make("Maze"), hrl.QLambda(**USUAL), SLIPPERY, {"trace_decay": [0.5, 1.0]}),
    "Dyna-Q, Maze": lambda: Case(make("Maze"), hrl.DynaQ(planning_steps=5, outcomes_kept=3, **USUAL), SLIPPERY),
    "R-MAX, rooms": lambda: Case(
        rooms(), hrl.RMax(discount=0.95, known_after=2), SLIPPERY, {"planning_tolerance": [0.01, 1.0]}
    ),
    "SARSA, FrozenLake's table": lambda: Case(from_table("FrozenLake-v1"), hrl.SARSA(epsilon=0.3)),
    "options, SMDP, Maze": lambda: _of_options("smdp"),
    "options, intra-option, Maze": lambda: _of_options("intra_option", primitives=False, discount=0.9),
    "HORDQ, Bus, random root": lambda: Case(
        make("Bus"),
        hrl.HORDQ(make("Bus").hierarchy(), hrl.RandomRoot(), **USUAL),
        axes={"pseudo_reward": [0.0, 5.0], "env.slip_probability": [0.1, 0.4]},
    ),
    "HORDQ, small Bus, model root": lambda: _of_bus(
        hrl.HORDQ,
        root=hrl.ModelRoot(interval=3, sweeps=4),
        pseudo_reward=stepped(8.0, 2.0),
        axes={"root.step_size": [0.1, 1.0], "root.unknown_value": [-30.0, 0.0]},
    )._replace(evaluate_every=20),
    "HORDQ, Taxi": lambda: Case(
        make("Taxi", stochastic=True),
        hrl.HORDQ(make("Taxi", stochastic=True).hierarchy(), pseudo_reward=4.0, **USUAL),
        {"max_steps": 150},
    ),
    "HORDQ, rooms, on policy": lambda: _of_rooms(hrl.HORDQ, bootstrap="on_policy", pseudo_reward=4.0),
    "HORDQ, Maze, total leaf cover": lambda: Case(
        make("Maze"),
        hrl.HORDQ(hrl.total_leaf_cover(make("Maze").hierarchy()).hierarchy, pseudo_reward=3.0, **USUAL),
        SLIPPERY,
    ),
    "MAXQ, small Bus, random root": lambda: _of_bus(hrl.MAXQ, root=hrl.RandomRoot(), pseudo_reward=60.0),
    "MAXQ, small Bus, model root": lambda: _of_bus(hrl.MAXQ, root=hrl.ModelRoot(), pseudo_reward=60.0),
    "MAXQ, rooms": lambda: _of_rooms(hrl.MAXQ, pseudo_reward=7.0),
    "MAXQ0, small Bus, random root": lambda: _of_bus(hrl.MAXQ0, root=hrl.RandomRoot()),
    "MAXQ0, Maze": lambda: Case(make("Maze"), hrl.MAXQ0(make("Maze").hierarchy(), **USUAL), SLIPPERY),
    "HAMQ, small Bus, random root": lambda: _of_bus(hrl.HAMQ, root=hrl.RandomRoot()),
    "HAMQ, fickle Taxi": lambda: Case(
        make("Taxi", fickle=True, rules="gymnasium"),
        hrl.HAMQ(make("Taxi", fickle=True, rules="gymnasium").hierarchy(), **USUAL),
        {"max_steps": 150},
    ),
    "relational HORDQ, Mario, learned model": lambda: _of_mario(
        hrl.RelationalHORDQ(
            hrl.SearchRoot(
                model=hrl.MarioModel(rows=64, max_depth=4, min_leaf=2, num_bins=8, offsets=True, pessimism=0.5),
                depth=3,
                max_nodes=18,
            ),
            epsilon=0.2,
            trace_decay=0.8,
            trace_length=5,
        )
    ),
    "relational HORDQ, Mario, given model": lambda: _of_mario(
        hrl.RelationalHORDQ(
            hrl.SearchRoot(
                model=hrl.MarioDynamics(),
                depth=3,
                max_nodes=18,
                priority="last_reward",
                answer="leaf",
                follow="sequence",
            ),
            epsilon=0.2,
            bootstrap="greedy",
        ),
        quantum=16,
    ),
}
"""What is recorded, by name."""
LONG_TO_COMPILE = ("relational HORDQ, Mario, learned model", "relational HORDQ, Mario, given model")
"""Cases that only this program computes; half a minute each.

Under `vmap` the learned model's tables differ from the record in the row that keeps what nobody reads.
"""
UNDER_VMAP_TOO = ("Q(lambda), Maze", "HORDQ, Maze, total leaf cover", "HAMQ, small Bus, random root")
"""Cases that compile soon in the other mapping, too."""


def results(case: Case, mapping: Any) -> Any:
    """The dataset of a case."""
    return hrl.sweep(
        case.env,
        case.learner,
        seeds=case.seeds,
        num_episodes=case.num_episodes,
        params=case.env.default_params._replace(**case.params),
        axes=case.axes,
        key=7,
        bin_size=1,
        evaluate_every=case.evaluate_every,
        keep_learned=True,
        mapping=mapping,
        cores=1,
        chunk_size=4,
        progress=False,
    )


def digest(array: np.ndarray) -> str:
    """Of numbers and their type, not of the shape."""
    return hashlib.sha256(array.dtype.str.encode() + np.ascontiguousarray(array).tobytes()).hexdigest()[:16]


def fingerprint(name: str, mapping: Any = "native") -> dict[str, str]:
    """Steps of every run, and digests: of each variable and coordinate, and of the learned tables in no order."""
    curves = results(CASES[name](), mapping)
    arrays = {str(variable): curves[variable].values for variable in [*curves, *curves.coords]}
    tables = [array for variable, array in arrays.items() if variable.startswith(LEARNED) and array.size]
    named = {variable: digest(array) for variable, array in arrays.items() if not variable.startswith(LEARNED)}
    steps = " ".join(str(int(count)) for count in arrays["steps"].ravel())
    return {**dict(sorted(named.items())), "steps": steps, LEARNED: " ".join(sorted(map(digest, tables)))}


def recorded() -> dict[str, dict[str, str]]:
    """Fingerprints by the name of their case."""
    return json.loads(RECORD.read_text())["cases"] if RECORD.exists() else {}


def differences(expected: dict[str, str], computed: dict[str, str]) -> list[str]:
    """The parts of a fingerprint that differ, as text."""
    return [
        f"{part}: {expected.get(part, 'absent')} recorded, {computed.get(part, 'absent')} now"
        for part in {**expected, **computed}
        if expected.get(part) != computed.get(part)
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="make the record")
    parser.add_argument("--mapping", choices=("native", "vmap"), default="native")
    parser.add_argument("--only", default="", help="cases whose name has this in it")
    options = parser.parse_args()
    old, new, wrong = recorded(), {}, 0
    for name in (name for name in CASES if options.only in name):
        started = time.perf_counter()
        new[name] = fingerprint(name, options.mapping)
        lines = differences(old.get(name, {}), new[name])
        wrong += bool(lines)
        print(f"{'differs' if lines else 'same':8}{time.perf_counter() - started:6.1f} s  {name}", flush=True)
        for line in lines:
            print(f"{'':18}{line}")
    if options.write:
        cases = {name: new.get(name, old.get(name)) for name in CASES if name in {**old, **new}}
        versions = {"python": sys.version.split()[0], "jax": jax.__version__}
        RECORD.write_text(json.dumps({"made with": versions, "cases": cases}, indent=1) + "\n")
        print(f"wrote {RECORD}")
        return 0
    print(f"{len(new) - wrong} of {len(new)} cases are as recorded")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
