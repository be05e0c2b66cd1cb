"""The values of a given hierarchical policy in the parts of the hierarchical Bellman equations."""

from typing import NamedTuple

import numpy as np

from hrljax.core import checks
from hrljax.solvers.joint import JointProcess, Totals


class Decomposed(NamedTuple):
    """Values of a hierarchical policy by context, state and slot; NaN where a child cannot be invoked."""

    reward: np.ndarray  # [C, S, K] Q_r: until the child has ended
    completion: np.ndarray  # [C, S, K] Q_c: from there until the subtask has ended
    exit: np.ndarray  # [C, S, K] Q_e: from there until the episode has ended
    value: np.ndarray  # [C, S] of the policy

    @property
    def q(self) -> np.ndarray:
        """``[C, S, K]``: ``Q_r + Q_c + Q_e`` (thesis eq. 3.2)."""
        return self.reward + self.completion + self.exit


def decompose(process: JointProcess, weights: np.ndarray) -> Decomposed:
    """Q_r, Q_c and Q_e of a hierarchical policy (thesis eq. 3.3, 3.4 and 3.6).

    Values are conditioned on the calling stack. Q_e bootstraps on whoever has control after the
    subtask's end: its value is that of the next subtask of the leaf cover (i' of eq. 3.6) in
    expectation over the choices of the subtasks between them, which take no time.

    Each part comes from its own linear equations, so that their sum equals the value of the whole
    process by Theorem 1 and not by construction.

    Args:
        process: the hierarchy on its model.
        weights: ``[R]`` probabilities of rows (`JointProcess.weights`).

    Raises:
        TypeError, ValueError: `weights` are no probabilities of rows.
        NoBestPolicyError: with discount 1, the policy cannot end the episode from some node.
    """
    weights = checks.as_array("weights", weights, np.floating, process.row_node.shape, "numbers, one a row,")
    process.require_an_end(weights)
    chain, gains = process.chain(weights), process.sums(weights * process.reward)
    below = [process.contexts.under(c)[process.context] for c in range(process.contexts.size)]
    totals = [Totals(chain, inside) for inside in below]
    whole = totals[0].of(gains)
    until_end = [total.of(gains) for total in totals]  # by context: reward until its subtask ends

    reward, completion, exit = np.zeros((3, len(process.row_node)))
    for number in range(process.contexts.size):
        context_rows = np.flatnonzero(process.context[process.row_node] == number)
        in_context = process.context == number
        caller_goes_on = np.where(in_context, until_end[number], 0.0)
        after_exit = np.where(below[number], 0.0, whole)
        later = np.where(in_context, totals[number].on_leaving(after_exit), after_exit)
        composite = process.contexts.called[number][process.row_slot[context_rows]]
        for child in np.unique(composite):
            rows = context_rows[composite == child]
            if child < 0:
                reward[rows] = process.reward[rows]
                completion[rows] = process.follows[rows] @ caller_goes_on
                exit[rows] = process.follows[rows] @ later
            else:
                at = process.node[child, process.state[process.row_node[rows]]]
                reward[rows] = until_end[child][at]
                completion[rows] = totals[child].on_leaving(caller_goes_on)[at]
                exit[rows] = totals[child].on_leaving(later)[at]
    spread = process.spread
    return Decomposed(spread(reward), spread(completion), spread(exit), process.spread_nodes(whole))
