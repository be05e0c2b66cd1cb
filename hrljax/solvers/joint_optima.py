"""Best policies of a joint process: policy iteration and value iteration over calling stacks and states."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from hrljax.core import checks
from hrljax.solvers.joint import JointProcess, Totals

Method = Literal["policy_iteration", "value_iteration"]
Ties = Literal["first", "last"]
_MARGIN = 1e-9
"""Values that differ by less, relative to one plus their size, are a tie."""


class Optimum(NamedTuple):
    """What `optimise` found, by rows and nodes of its process."""

    q: np.ndarray  # [R]
    value: np.ndarray  # [N]
    weights: np.ndarray  # [R] probabilities of rows under the policy that was found
    sweeps: int  # sweeps (value iteration) or improvements (policy iteration)


def optimise(
    process: JointProcess,
    weights: np.ndarray | None = None,
    free: np.ndarray | None = None,
    *,
    reward: np.ndarray | None = None,
    method: Method = "policy_iteration",
    tolerance: float = 1e-12,
    max_sweeps: int | None = None,
) -> Optimum:
    """The best values when some contexts choose freely and the others follow a given policy.

    Policy iteration begins with free contexts that choose uniformly; children that tie share the
    probability, and what is as good as the best stays (Howard 1960). Both methods are those that the
    thesis's Theorem 2 names: the values of free contexts satisfy Theorem 1's equations with maxima.

    Args:
        process: the hierarchy on its model.
        weights: ``[R]`` probabilities of the rows of contexts that are not free.
        free: ``[C]`` bool; all if None.
        reward: ``[R]``; the process's own if None.
        method: by exact evaluations and improvements, or by sweeps from zero.
        tolerance: sweeps stop when no value changes by more, relative to one plus the greatest.
        max_sweeps: most sweeps or improvements; 1,000,000 or 1,000 if None.

    Raises:
        TypeError, ValueError: an argument does not fit.
        NoBestPolicyError: with discount 1 some node cannot reach an end, or a policy that never ends is better.
        RuntimeError: `max_sweeps` were not enough; the message names a subtask and a state.
    """
    checks.choice("method", method, Method)
    checks.number("tolerance", tolerance, checks.NOT_NEGATIVE)
    if max_sweeps is not None:
        checks.integer("max_sweeps", max_sweeps, 1)
    for name, rows in (("weights", weights), ("reward", reward)):
        if rows is not None:
            checks.as_array(name, rows, np.floating, process.row_node.shape, "numbers, one a row,")
    chooses = np.ones(process.num_nodes, np.bool_)
    if free is not None:
        chooses = checks.as_array("free", free, np.bool_, (process.contexts.size,), "bools")[process.context]
    if weights is None and not chooses.all():
        raise ValueError("weights are needed for the contexts that are not free")
    gains = process.reward if reward is None else reward
    uniform = process.uniform()
    start = uniform if weights is None else np.where(chooses[process.row_node], uniform, weights)
    process.require_an_end(start)

    if method == "value_iteration":
        return _by_sweeps(process, gains, start, chooses, tolerance, max_sweeps or 1_000_000)
    return _by_improvements(process, gains, start, chooses, max_sweeps or 1000)


def _by_sweeps(
    process: JointProcess, gains: np.ndarray, start: np.ndarray, chooses: np.ndarray, tolerance: float, max_sweeps: int
) -> Optimum:
    value = np.zeros(process.num_nodes)
    change = value
    for sweep in range(1, max_sweeps + 1):
        q = gains + process.follows @ value
        updated = np.where(chooses, process.maxima(q), process.sums(start * q))
        change = np.abs(updated - value)
        value = updated
        if change.max() <= tolerance * (1 + np.abs(value).max()):
            q = gains + process.follows @ value
            weights = np.where(chooses[process.row_node], _shared(process, _ties(process, q)), start)
            return Optimum(q, value, weights, sweep)
    raise RuntimeError(
        f"{max_sweeps} sweeps were not enough; the value changes in {process.where(int(change.argmax()))}"
    )


def _by_improvements(
    process: JointProcess, gains: np.ndarray, start: np.ndarray, chooses: np.ndarray, max_sweeps: int
) -> Optimum:
    everywhere = np.ones(process.num_nodes, np.bool_)
    weights, changed = start, start
    for improvement in range(1, max_sweeps + 1):
        value = Totals(process.chain(weights), everywhere).of(process.sums(weights * gains))
        q = gains + process.follows @ value
        better = process.maxima(q) > value + _MARGIN * (1 + np.abs(value))
        renewed = chooses & (better | (process.maxima(weights) < 1))
        updated = np.where(renewed[process.row_node], _shared(process, _ties(process, q)), weights)
        changed = updated != weights
        if not changed.any():
            return Optimum(q, value, weights, improvement)
        weights = updated
    where = process.where(int(process.row_node[changed.argmax()]))
    raise RuntimeError(f"{max_sweeps} improvements were not enough; the policy changes in {where}")


def greedy(process: JointProcess, best: Optimum, ties: Ties = "first", free: np.ndarray | None = None) -> np.ndarray:
    """One best child at every node, ``[C, S]`` int slots; -1 where a context cannot have control.

    Args:
        process: the hierarchy on its model.
        best: what `optimise` found.
        ties: children that tie are taken in the order of their slots, or from the last. Without
            discounting, a tie may be between staying away from the end for ever and not: there the
            first child is taken that can lead nearer to the end.
        free: ``[C]`` bool; contexts that are not take a child that their policy can take. All if None.
    """
    checks.choice("ties", ties, Ties)
    chooses = True if free is None else np.asarray(free, np.bool_)[process.context[process.row_node]]
    allowed = np.where(chooses, _ties(process, best.q), best.weights > 0)
    numbers = np.arange(len(allowed))
    order = numbers if ties == "first" else -numbers
    worst = len(allowed) + 1

    def chosen_among(rows: np.ndarray) -> np.ndarray:
        return np.abs(np.minimum.reduceat(np.where(rows, order, worst), process.first_row))

    rows = chosen_among(allowed)
    if process.discount == 1:
        rows = _made_to_end(process, rows, allowed, chosen_among)
    slots = np.full(process.node.shape, -1)
    slots[process.context, process.state] = process.row_slot[rows]
    return slots


def _ties(process: JointProcess, q: np.ndarray) -> np.ndarray:
    """``[R]`` bool: rows as good as the best of their node."""
    best = process.maxima(q)
    return q >= (best - _MARGIN * (1 + np.abs(best)))[process.row_node]


def _shared(process: JointProcess, rows: np.ndarray) -> np.ndarray:
    return rows / process.sums(rows.astype(np.float64))[process.row_node]


def _made_to_end(
    process: JointProcess, rows: np.ndarray, allowed: np.ndarray, chosen_among: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Replaces choices from which no end can be reached by allowed ones that lead nearer to one."""
    positive = process.follows.copy()
    positive.data = (positive.data > 0).astype(np.float64)
    reaches = np.zeros(process.num_nodes, np.bool_)
    while True:
        leads = (process.ends > 0) | (positive @ reaches.astype(np.float64) > 0)
        further = reaches | leads[rows]
        if np.array_equal(further, reaches):  # no further node reaches an end by the choices so far
            could = process.maxima((leads & allowed).astype(np.float64)) > 0
            helped = could & ~reaches
            if not helped.any():
                return rows
            rows = np.where(helped, chosen_among(leads & allowed), rows)
            further = reaches | helped
        reaches = further
