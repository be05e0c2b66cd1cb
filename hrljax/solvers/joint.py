"""A task hierarchy on a known model, as one sparse decision process over (calling stack, state).

Every node is a moment in which one subtask decides: its calling stack (a *context*, a path of the
task graph from the top) and the state. Its rows are the children that it may invoke there. A
primitive child takes a step, after which the subtask that then has control decides; a composite
child takes no time and hands control to its own node. Values over nodes are exact for any depth and
any number of callers, where a value by (subtask, state) would depend on who called.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from hrljax.core import checks
from hrljax.hierarchy.definition import Hierarchy
from hrljax.solvers.contexts import Contexts, Termination, contexts, control
from hrljax.solvers.model import Model, check_model

if TYPE_CHECKING:  # takes longer to import than the rest of the library: functions import it
    from scipy import sparse


class NoBestPolicyError(ValueError):
    """A problem in which no policy is best, or has a value at all; the message says why."""


@dataclass(frozen=True, eq=False)
class JointProcess:
    """N nodes (context, state) and R rows (node, child), rows sorted by node and slot."""

    hierarchy: Hierarchy
    contexts: Contexts
    node: np.ndarray  # [C, S] int: number of a node; -1 where the context cannot have control
    context: np.ndarray  # [N] int
    state: np.ndarray  # [N] int
    row_node: np.ndarray  # [R] int
    row_slot: np.ndarray  # [R] int: the child's slot in its subtask
    reward: np.ndarray  # [R] expected reward of the step; 0 for a composite child
    goal: np.ndarray  # [R] expected factor of the top's pseudo-reward, paid with the reward of the step
    ends: np.ndarray  # [R] probability that the step ends the episode or the top
    leaves: np.ndarray  # [R] probability that the step ends the top but not the episode
    follows: "sparse.csr_array"  # [R, N] discounted probability of the node that decides next
    discount: float

    @property
    def num_nodes(self) -> int:
        return len(self.state)

    @cached_property
    def first_row(self) -> np.ndarray:
        """``[N]`` int: the first row of each node."""
        return np.searchsorted(self.row_node, np.arange(self.num_nodes))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Contexts, states, slots: of `spread` rows."""
        return (*self.node.shape, self.contexts.called.shape[1])

    def where(self, node: int) -> str:
        """A node in words, for messages."""
        names, context = [], int(self.context[node])
        while context >= 0:
            names.append(self.hierarchy.subtasks[self.contexts.task[context]].name)
            context = int(self.contexts.parent[context])
        called = f" (called by {' < '.join(names[1:])})" if names[1:] else ""
        return f"subtask {names[0]!r}{called} in state {self.state[node]}"

    def spread(self, rows: np.ndarray) -> np.ndarray:
        """Values of rows as ``[C, S, K]``; NaN where a child cannot be invoked."""
        table = np.full(self.shape, np.nan)
        table[self.context[self.row_node], self.state[self.row_node], self.row_slot] = rows
        return table

    def spread_nodes(self, values: np.ndarray) -> np.ndarray:
        """Values of nodes as ``[C, S]``; NaN where a context cannot have control."""
        return np.where(self.node >= 0, np.append(values, np.nan)[self.node], np.nan)

    def by_subtask(self, values: np.ndarray, tolerance: float = 1e-9) -> np.ndarray:
        """Values by context ``[C, S, ...]`` as values by subtask ``[tasks, S, ...]``, where that has a meaning.

        The thesis writes Q(i, s, a) without the caller. It is defined where all callers of a subtask
        give it the same value (within `tolerance`), as for the only caller, for Q_r of a subtask that
        no caller interrupts, or for everything in Theorem 2's optimum; NaN elsewhere.
        """
        table = np.full((len(self.hierarchy.subtasks), *values.shape[1:]), np.nan)
        for task in np.unique(self.contexts.task):
            of_callers = values[self.contexts.task == task]
            low = np.min(np.where(np.isnan(of_callers), np.inf, of_callers), axis=0)
            high = np.max(np.where(np.isnan(of_callers), -np.inf, of_callers), axis=0)
            agree = low + tolerance >= high  # also where no caller has a value: inf against -inf
            table[task] = np.where(agree & np.isfinite(low), low, np.nan)
        return table

    def actions(self, slots: np.ndarray) -> np.ndarray:
        """The primitive action that a choice of slots leads to at once, ``[C, S]`` int; -1 where there is none.

        Args:
            slots: ``[C, S]`` int, one child of every context in every state (`greedy`).
        """
        table = np.full(self.node.shape, -1)
        for number in reversed(range(self.contexts.size)):  # the called before their callers
            children = self.hierarchy.subtasks[self.contexts.task[number]].children
            for slot, child in enumerate(children):
                called = self.contexts.called[number, slot]
                action = table[called] if called >= 0 else self.hierarchy.actions.index(child)
                table[number] = np.where((slots[number] == slot) & (self.node[number] >= 0), action, table[number])
        return table

    def weights(self, policy: np.ndarray, by: Literal["subtask", "stack"] = "subtask") -> np.ndarray:
        """Probabilities of rows ``[R]`` of a hierarchical policy.

        Args:
            policy: slots of children ``[., S]`` (int), or probabilities of slots ``[., S, K]``; the
                first axis counts subtasks or contexts.
            by: ``"subtask"``: one policy for all callers (Definition 4). ``"stack"``: by context.

        Raises:
            ValueError: the shape does not fit, or a subtask's probabilities over the children that
                it may invoke in a state do not sum to one. The message names the subtask.
        """
        policy = np.asarray(policy)
        checks.choice("by", by, ("subtask", "stack"))
        owner = {"subtask": self.contexts.task, "stack": np.arange(self.contexts.size)}[by]
        num_owners = {"subtask": len(self.hierarchy.subtasks), "stack": self.contexts.size}[by]
        _, num_states, width = self.shape
        slots = policy.ndim == 2 and np.issubdtype(policy.dtype, np.integer)
        if policy.shape != ((num_owners, num_states) if slots else (num_owners, num_states, width)):
            expected = f"{(num_owners, num_states)} of ints or {(num_owners, num_states, width)}"
            raise ValueError(f"policy by {by} must have shape {expected}, got {policy.shape} of {policy.dtype}")
        at = owner[self.context[self.row_node]], self.state[self.row_node]
        weights = (policy[at] == self.row_slot).astype(np.float64) if slots else policy[(*at, self.row_slot)]
        total = self.sums(weights)
        if weights.min() < 0 or not np.allclose(total, 1, rtol=0, atol=1e-9):
            worst = self.where(int(np.argmax(np.abs(total - 1))))
            raise ValueError(f"policy: probabilities of the children that may be invoked do not sum to one: {worst}")
        return weights

    def uniform(self) -> np.ndarray:
        """Probabilities of rows ``[R]``: every child that may be invoked is equally likely."""
        return (1 / self.sums(np.ones(len(self.row_node))))[self.row_node]

    def sums(self, rows: np.ndarray) -> np.ndarray:
        """``[N]``: sums of rows over the children of each node."""
        return np.add.reduceat(rows, self.first_row)

    def maxima(self, rows: np.ndarray) -> np.ndarray:
        """``[N]``: greatest of the rows of each node."""
        return np.maximum.reduceat(rows, self.first_row)

    def chain(self, weights: np.ndarray) -> "sparse.csr_array":
        """``[N, N]``: discounted probabilities from node to node under probabilities of rows."""
        from scipy import sparse

        rows = np.arange(len(self.row_node))
        choice = sparse.csr_array((weights, (self.row_node, rows)), shape=(self.num_nodes, len(rows)))
        return sparse.csr_array(choice @ self.follows)

    def require_an_end(self, weights: np.ndarray) -> None:
        """Without discounting, checks that every node can reach an end (of the episode or the top).

        Raises:
            NoBestPolicyError: one cannot; the message names the subtask and the state.
        """
        if self.discount < 1:
            return
        chain = self.chain(weights)
        reaches = self.sums(weights * self.ends) > 0
        while True:
            further = reaches | (chain @ reaches.astype(np.float64) > 0)
            if further.all():
                return
            if np.array_equal(further, reaches):
                stuck = self.where(int(np.flatnonzero(~reaches)[0]))
                raise NoBestPolicyError(f"with discount 1 the episode must be able to end: it cannot from {stuck}")
            reaches = further


class Totals:
    """Expected totals of a Markov chain until it leaves a set of nodes."""

    def __init__(self, chain: "sparse.csr_array", inside: np.ndarray):
        """
        Raises:
            NoBestPolicyError: the chain never leaves it.
        """
        from scipy import sparse
        from scipy.sparse.linalg import splu

        self.inside = np.flatnonzero(inside)
        self.outside = np.flatnonzero(~inside)
        rows = chain[self.inside]
        self._to_outside = rows[:, self.outside]
        try:
            self._solver = splu(sparse.csc_array(sparse.eye_array(len(self.inside)) - rows[:, self.inside]))
        except RuntimeError as error:  # the matrix is singular
            raise NoBestPolicyError("a policy that never ends earns more than any that does") from error

    def of(self, gains: np.ndarray) -> np.ndarray:
        """``[N]``: total of what each visited node inside gives; 0 outside."""
        totals = np.zeros(len(gains))
        totals[self.inside] = self._solver.solve(gains[self.inside])
        return totals

    def on_leaving(self, payoff: np.ndarray) -> np.ndarray:
        """``[N]``: discounted payoff of the first node outside; 0 for nodes outside."""
        gains = np.zeros(len(payoff))
        gains[self.inside] = self._to_outside @ payoff[self.outside]
        return self.of(gains)


def joint_process(
    hierarchy: Hierarchy,
    active: np.ndarray,
    model: Model,
    *,
    discount: float = 1.0,
    goal: np.ndarray | None = None,
    top: str | None = None,
    termination: Termination = "immediate",
) -> JointProcess:
    """Joins a hierarchy and a model.

    Args:
        hierarchy: the task graph.
        active: ``[tasks, S]`` bool, subtasks in the hierarchy's order: where each goes on and can
            be invoked.
        model: the decision process.
        discount: in [0, 1], of every primitive step.
        goal: ``[tasks, S]`` factors of pseudo-rewards in terminal states; nowhere if None. Only the
            top's count.
        top: the subtask to start from, alone on the stack; the root if None. Where it terminates,
            the process ends.
        termination: ``"immediate"``: a subtask that enters a terminal state ends at once, with all
            that it has called (thesis 2.5.1; Dietterich 2000, Table 1). ``"on_return"``: a subtask's
            end is noticed when it has control again.

    Raises:
        TypeError: an argument is of the wrong kind.
        KeyError: there is no subtask `top`.
        ValueError: an argument does not fit, or a subtask that can have control has no child to
            invoke. The message names the subtask and the state.
    """
    from scipy import sparse

    active = _checked(hierarchy, active, model)
    discount = checks.number("discount", discount, checks.SHARE)
    checks.choice("termination", termination, Termination)
    if goal is not None:
        goal = checks.as_array("goal", goal, np.floating, active.shape, "numbers")
    stacks = contexts(hierarchy, top)
    live, resumed = control(stacks, active, termination)
    for task in stacks.task:
        if not active[task].any():
            raise ValueError(f"subtask {hierarchy.subtasks[task].name!r} is terminated in every state")
    node = np.where(live, np.cumsum(live).reshape(live.shape) - 1, -1)
    top_task = stacks.task[0]
    paid = np.zeros(model.num_states) if goal is None else np.where(active[top_task], 0.0, np.asarray(goal)[top_task])

    blocks: list[_Rows] = []
    for number, task in enumerate(stacks.task):
        for slot, child in enumerate(hierarchy.subtasks[task].children):
            called = int(stacks.called[number, slot])
            if called >= 0:
                states = np.flatnonzero(live[number] & live[called])
                blocks.append(_invoking(node[number, states], slot, node[called, states]))
            else:
                states, action = np.flatnonzero(live[number]), hierarchy.actions.index(child)
                outcomes = Model(*(table[states, action] for table in model))
                blocks.append(_stepping(node[number, states], slot, outcomes, resumed[number], node, paid, discount))
    offsets = np.cumsum([0, *(len(block.node) for block in blocks)])
    origin = np.concatenate([block.origin + offset for block, offset in zip(blocks, offsets, strict=False)])
    joined = _Rows(*map(np.concatenate, zip(*blocks, strict=True)))
    order = np.lexsort((joined.slot, joined.node))
    rank = np.argsort(order)
    context, state = np.nonzero(live)
    process = JointProcess(
        hierarchy=hierarchy,
        contexts=stacks,
        node=node,
        context=context,
        state=state,
        row_node=joined.node[order],
        row_slot=joined.slot[order],
        reward=joined.reward[order],
        goal=joined.goal[order],
        ends=joined.ends[order],
        leaves=joined.leaves[order],
        follows=sparse.csr_array((joined.weight, (rank[origin], joined.follows)), shape=(len(order), len(state))),
        discount=float(discount),
    )
    childless = np.bincount(process.row_node, minlength=len(state)) == 0
    if childless.any():
        raise ValueError(f"{process.where(int(np.argmax(childless)))} has no child to invoke")
    return process


def _checked(hierarchy: Hierarchy, active: np.ndarray, model: Model) -> np.ndarray:
    """`active`, after checking that it is over the subtasks and the states, and the model over the actions."""
    checks.instance("hierarchy", hierarchy, Hierarchy, "a Hierarchy such as env.hierarchy()")
    check_model(model)
    shape = len(hierarchy.subtasks), model.num_states
    active = checks.as_array("active", active, np.bool_, shape, "bools")
    if model.num_actions != len(hierarchy.actions):
        raise ValueError(f"the hierarchy is over {len(hierarchy.actions)} actions, the model has {model.num_actions}")
    return active


class _Rows(NamedTuple):
    """Rows of one child in one context, in the fields of `JointProcess`, and the entries of `follows`."""

    node: np.ndarray
    slot: np.ndarray
    reward: np.ndarray
    goal: np.ndarray
    ends: np.ndarray
    leaves: np.ndarray
    origin: np.ndarray  # [entries] which of these rows
    follows: np.ndarray  # [entries]
    weight: np.ndarray  # [entries]


def _invoking(node: np.ndarray, slot: int, follows: np.ndarray) -> _Rows:
    zeros = np.zeros(len(node))
    slots = np.full(len(node), slot)
    return _Rows(node, slots, zeros, zeros, zeros, zeros, np.arange(len(node)), follows, zeros + 1)


def _stepping(
    node: np.ndarray,
    slot: int,
    outcomes: Model,  # [n, K] each
    resumed: np.ndarray,
    nodes: np.ndarray,
    paid: np.ndarray,
    discount: float,
) -> _Rows:
    after, chance = outcomes.next_state, outcomes.probability
    control, goes_on = resumed[after], ~outcomes.terminated
    ended = np.where(goes_on & (control >= 0), 0.0, chance)
    followed = origin, _ = np.nonzero(goes_on & (control >= 0) & (chance > 0))
    return _Rows(
        node=node,
        slot=np.full(len(node), slot),
        reward=(chance * outcomes.reward).sum(-1),
        goal=(ended * paid[after]).sum(-1),
        ends=ended.sum(-1),
        leaves=np.where(goes_on & (control < 0), chance, 0.0).sum(-1),
        origin=origin,
        follows=nodes[control[followed], after[followed]],
        weight=discount * chance[followed],
    )
