"""Best-first searches and generated nodes a second on one core, side by side with peers.

Contestants search on the same 37 regression trees (`planner_trees.py`) from the same random screens:
hrljax's native loop and its `vmap`; the same search written with numpy, scikit-learn's trees and
heapq, with scikit-learn's public `predict` and with the tree inside it, which checks nothing; a
hand-written numba loop; and mctx's two policies with as many simulations. mctx does not
search best-first and generates one node a simulation, so that its nodes a second are what compares.
All but mctx must find the same first actions and values. Seconds are those of the processor, since
machines are shared; all run in turns, round after round, and the median is reported.

    pip install -e '.[bench]' scikit-learn && pip install --no-deps mctx && python benchmarks/mario_planner.py
"""

import heapq
import importlib.util
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from hrljax.engine import batch
from hrljax.experiments import program
from hrljax.search.best_first import best_first_search

program.require("bench", "numba", "sklearn")

try:
    from benchmarks import numba_planner, planner_trees
    from benchmarks.rounds import save
except ModuleNotFoundError:
    import numba_planner
    import planner_trees
    from rounds import save

DEPTH = 6
CASES: dict[str, dict[str, Any]] = {
    "300 generated": {"max_nodes": 300, "count": "generated", "stop_reward": np.inf},
    "300 generated, stop at +6": {"max_nodes": 300, "count": "generated", "stop_reward": 6.0},
    "300 expanded": {"max_nodes": 300, "count": "expanded", "stop_reward": np.inf},
}
Found = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Of every search: generated nodes, first action, value of the best node."""


@dataclass(frozen=True)
class Options:
    """Searches a second on one core, hrljax side by side with peers."""

    searches: int = 512
    """Searches in a round; the slow peers do fewer."""
    rounds: int = 5
    """Rounds; every contestant runs once in each."""
    json: Path | None = None
    """Where to write the rows."""
    peers: bool = True
    """Whether to run the peers written in Python, and mctx."""


@dataclass
class Contestant:
    """`run` does one round."""

    case: str
    name: str
    run: Callable[[], Found]
    same_search: bool = True
    compile_seconds: float = 0.0


@dataclass
class Problem:
    """Trees, screens and starts; every contestant takes as many of the first as it does in a round."""

    fitted: list[Any]
    trees: planner_trees.Trees
    screens: np.ndarray
    starts: planner_trees.Node

    def on_device(self) -> tuple[planner_trees.Trees, tuple[jax.Array, planner_trees.Node]]:
        return jax.tree.map(jnp.asarray, (self.trees, (self.screens, self.starts)))


def expansions(case: str) -> int:
    options = CASES[case]
    return options["max_nodes"] if options["count"] == "expanded" else -(-options["max_nodes"] // planner_trees.ACTIONS)


def by_hrljax(case: str, problem: Problem, mapping: Any) -> Contestant:
    trees, rows = problem.on_device()
    loop = "while" if mapping == "native" else "scan"

    def search(row: tuple[jax.Array, planner_trees.Node]) -> tuple[jax.Array, jax.Array, jax.Array]:
        screen, start = row
        model = planner_trees.model(trees, screen)
        result = best_first_search(model, start, planner_trees.ACTIONS, depth=DEPTH, loop=loop, **CASES[case])
        return result.tree.num_nodes - 1, result.action, result.value

    began = time.perf_counter()
    compiled = batch.compile_mapped(search, mapping).lower(rows).compile()
    seconds = time.perf_counter() - began
    return Contestant(
        case, f"hrljax {mapping}", lambda: jax.tree.map(np.asarray, compiled(rows)), compile_seconds=seconds
    )


def by_numba(case: str, problem: Problem) -> Contestant:
    starts = np.stack(problem.starts, axis=1)
    limits = planner_trees.ACTIONS, DEPTH, expansions(case), np.float32(CASES[case]["stop_reward"])
    arguments = *problem.trees, problem.screens, starts, *limits
    began = time.perf_counter()
    numba_planner.search_all(*arguments)
    return Contestant(
        case, "numba, binary heap", lambda: numba_planner.search_all(*arguments),
        compile_seconds=time.perf_counter() - began,
    )  # fmt: skip


def in_python(case: str, problem: Problem, checked: bool, searches: int) -> Contestant:
    """numpy, scikit-learn, heapq; the reward tree predicts all actions at once."""
    predict = [tree.predict if checked else tree.tree_.predict for tree in problem.fitted]
    actions, stop = planner_trees.ACTIONS, CASES[case]["stop_reward"]
    all_actions = np.arange(actions, dtype=np.float32)[:, None]

    def search(screen: np.ndarray, start: planner_trees.Node) -> tuple[int, int, float]:
        nodes = [(start, np.float32(0), 0, -1)]
        heap = [(0.0, 0)]
        best = (-np.inf, 0)
        for _ in range(expansions(case)):
            if not heap or best[0] > stop:
                break
            node, value, depth, first = nodes[heapq.heappop(heap)[1]]
            inputs = np.array([[*planner_trees.cut(screen, node.x, node.y), node.dx, node.dy]], np.float32)
            rewards = predict[-1](np.hstack([np.repeat(inputs, actions, axis=0), all_actions])).ravel()
            for a in range(actions):
                move_x, move_y, dx, dy = (np.float32(predict[4 * a + k](inputs).ravel()[0]) for k in range(4))
                child = planner_trees.Node(node.x + move_x, node.y + move_y, dx, dy)
                total = value + np.float32(rewards[a])
                nodes.append((child, total, depth + 1, a if first < 0 else first))
                if depth + 1 < DEPTH:
                    heapq.heappush(heap, (-float(total), len(nodes) - 1))
                if total > best[0]:
                    best = (total, nodes[-1][3])
        return len(nodes) - 1, best[1], best[0]

    def run() -> Found:
        rows = [
            search(problem.screens[i], planner_trees.Node(*(values[i] for values in problem.starts)))
            for i in range(searches)
        ]
        counts, firsts, values = zip(*rows, strict=True)
        return np.array(counts), np.array(firsts), np.array(values, np.float32)

    return Contestant(case, f"numpy, scikit-learn{'' if checked else ' unchecked'}, heapq", run)


def by_mctx(case: str, problem: Problem, policy: str, searches: int) -> Contestant:
    """One simulation generates one node; logits and values are 0, so that rewards alone guide it."""
    import mctx

    trees, rows = problem.on_device()
    rows = jax.tree.map(lambda x: x[:searches], rows)
    simulations = expansions(case) * planner_trees.ACTIONS
    empty, logits = jnp.zeros(searches), jnp.zeros((searches, planner_trees.ACTIONS))

    def recurrent(screens: jax.Array, _: jax.Array, action: jax.Array, nodes: planner_trees.Node) -> Any:
        step = jax.vmap(lambda screen, node, a: planner_trees.model(trees, screen)(node, a))
        after, reward = step(screens, nodes, action)
        return mctx.RecurrentFnOutput(reward=reward, discount=empty + 1, prior_logits=logits, value=empty), after

    @jax.jit
    def search(screens: jax.Array, nodes: planner_trees.Node) -> tuple[jax.Array, jax.Array]:
        root = mctx.RootFnOutput(prior_logits=logits, value=empty, embedding=nodes)
        output = getattr(mctx, policy)(screens, jax.random.key(0), root, recurrent, simulations, max_depth=DEPTH)
        return output.action, output.search_tree.summary().value

    began = time.perf_counter()
    compiled = search.lower(*rows).compile()
    seconds = time.perf_counter() - began

    def run() -> Found:
        action, value = map(np.asarray, compiled(*rows))
        return np.full(searches, simulations), action, value

    return Contestant(case, f"mctx {policy}", run, same_search=False, compile_seconds=seconds)


def contestants(options: Options, problem: Problem) -> list[Contestant]:
    entries = []
    for case in CASES:
        fewer = max(1, options.searches // (128 if CASES[case]["count"] == "generated" else 1024))
        entries += [by_hrljax(case, problem, "native"), by_hrljax(case, problem, "vmap"), by_numba(case, problem)]
        if options.peers:
            entries += [in_python(case, problem, checked, fewer) for checked in (True, False)]
    if options.peers and importlib.util.find_spec("mctx"):
        policies = ("gumbel_muzero_policy", "muzero_policy")
        entries += [by_mctx("300 generated", problem, policy, max(1, options.searches // 4)) for policy in policies]
    return entries


def measure(entries: list[Contestant], rounds: int) -> list[dict[str, Any]]:
    """Runs everybody in turns; the rows of the result.

    Raises:
        RuntimeError: two that do the same search find different things.
    """
    reference: dict[str, Found] = {}
    speeds: dict[int, list[tuple[float, float]]] = {i: [] for i in range(len(entries))}
    for number in range(rounds):
        for i, entry in enumerate(entries):
            began = time.process_time()
            actual = entry.run()
            seconds = time.process_time() - began
            speeds[i].append((len(actual[0]) / seconds, float(np.sum(actual[0])) / seconds))
            expected = reference.setdefault(entry.case, actual)
            same = map(partial(_starts_with, len(actual[0])), expected, actual)
            if entry.same_search and not all(same):
                raise RuntimeError(f"{entry.name} finds other actions or values than {entries[0].name}: {entry.case}")
        print(f"round {number + 1} of {rounds}", flush=True)
    return [
        {
            "case": entry.case,
            "contestant": entry.name,
            "cores": 1,
            "value": statistics.median(speed[which] for speed in speeds[i]),
            "unit": unit,
            "compile_seconds": entry.compile_seconds,
        }
        for i, entry in enumerate(entries)
        for which, unit in enumerate(("searches/s", "nodes/s"))
    ]


def _starts_with(count: int, expected: np.ndarray, actual: np.ndarray) -> bool:
    return bool(np.array_equal(expected[:count], actual))


def report(rows: list[dict[str, Any]]) -> str:
    """The rows as a table, with the ratio of hrljax's native loop to each, by nodes."""
    lines = [f"{'case':28}{'contestant':40}{'searches/s':>12}{'nodes/s':>13}{'native is x':>13}{'compile s':>11}"]
    for searches, nodes in zip(rows[::2], rows[1::2], strict=True):
        native = next(r for r in rows[1::2] if r["case"] == nodes["case"])
        lines.append(
            f"{nodes['case']:28}{nodes['contestant']:40}{searches['value']:12,.1f}{nodes['value']:13,.0f}"
            f"{native['value'] / nodes['value']:13.2f}{nodes['compile_seconds']:11.2f}"
        )
    return "\n".join(lines)


def main(options: Options) -> None:
    fitted = planner_trees.fit()
    trees = planner_trees.packed(fitted)
    tests = (trees.words != 0).sum(axis=1)
    print(f"{len(fitted)} trees with {tests.sum()} tests, {tests.max()} in the greatest, depth at most", end=" ")
    print(max(tree.get_depth() for tree in fitted))
    problem = Problem(
        fitted, trees, planner_trees.screens(options.searches, 3), planner_trees.starts(options.searches, 4)
    )
    rows = measure(contestants(options, problem), options.rounds)
    print(report(rows))
    names = [name for name in ("jax", "jaxlib", "numba", "scikit-learn", "mctx") if _installed(name)]
    versions = ", ".join(f"{name} {version(name)}" for name in names)
    print(f"median of {options.rounds} rounds; Python {platform.python_version()}, {versions}")
    save(rows, options.json)


def _installed(name: str) -> bool:
    return importlib.util.find_spec(name.replace("scikit-learn", "sklearn")) is not None


if __name__ == "__main__":
    main(tyro.cli(Options))
