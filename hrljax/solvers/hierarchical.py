"""The hierarchical Bellman equations, solved: values of a given hierarchical policy, and the best ones.

Everything runs in float64 NumPy on the host, on a `JointProcess`: values belong to calling stacks,
so that a subtask with several callers has one value for each. All three criteria are one problem in
which some subtasks are free to choose and the others are fixed.
"""

from typing import Literal, NamedTuple, Protocol

import numpy as np

from hrljax.hierarchy import Hierarchy, Subtask
from hrljax.solvers.joint import JointProcess, Termination, Totals, joint_process
from hrljax.solvers.model import Model

Method = Literal["policy_iteration", "value_iteration"]
Ties = Literal["first", "last"]
_MARGIN = 1e-9
"""Values that differ by less, relative to one plus their size, are a tie."""


class TaskArrays(Protocol):
    """A hierarchy's predicates at every state, as `hrljax.learners.task_tables.tabulate` gives them."""

    @property
    def active(self) -> np.ndarray: ...  # [tasks, S] bool

    @property
    def goal(self) -> np.ndarray: ...  # [tasks, S] factor of the pseudo-reward


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


class Optimum(NamedTuple):
    """What `optimise` found, by rows and nodes of its process."""

    q: np.ndarray  # [R]
    value: np.ndarray  # [N]
    weights: np.ndarray  # [R] probabilities of rows under the policy that was found
    sweeps: int  # sweeps (value iteration) or improvements (policy iteration)


class Criterion(NamedTuple):
    """One criterion's values and policy."""

    value: np.ndarray  # [S] expected return where the root decides; NaN where it cannot
    mean: float  # over the start distribution
    policy: np.ndarray  # [C, S] int slots of children by context; -1 where the context cannot have control


class Optima(NamedTuple):
    """The best policies of a problem: of all, of the hierarchy's, and of subtasks that look no further."""

    optimal: Criterion
    hierarchical: Criterion
    recursive: Criterion


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
        ValueError: with discount 1, the policy cannot end the episode from some node.
    """
    process.require_an_end(weights)
    chain, gains = process.chain(weights), process.sums(weights * process.reward)
    below = [process.contexts.under(c)[process.context] for c in range(process.contexts.count)]
    totals = [Totals(chain, inside) for inside in below]
    whole = totals[0].of(gains)
    until_end = [total.of(gains) for total in totals]  # by context: reward until its subtask ends

    reward, completion, exit = np.zeros((3, len(process.row_node)))
    for number, own in enumerate(_rows_of(process)):
        here = process.context == number
        caller_goes_on = np.where(here, until_end[number], 0.0)
        after_exit = np.where(below[number], 0.0, whole)
        later = np.where(here, totals[number].on_leaving(after_exit), after_exit)
        composite = process.contexts.called[number][process.row_slot[own]]
        for child in np.unique(composite):
            rows = own[composite == child]
            if child < 0:
                reward[rows] = process.reward[rows]
                completion[rows] = process.follows[rows] @ caller_goes_on
                exit[rows] = process.follows[rows] @ later
            else:
                at = process.node[child, process.state[process.row_node[rows]]]
                reward[rows] = until_end[child][at]
                completion[rows] = totals[child].on_leaving(caller_goes_on)[at]
                exit[rows] = totals[child].on_leaving(later)[at]
    return Decomposed(*map(process.spread, (reward, completion, exit)), process.spread_nodes(whole))


def optimise(
    process: JointProcess,
    weights: np.ndarray | None = None,
    free: np.ndarray | None = None,
    *,
    reward: np.ndarray | None = None,
    method: Method = "policy_iteration",
    tolerance: float = 1e-12,
    max_sweeps: int = 1_000_000,
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
        max_sweeps: most sweeps or improvements.

    Raises:
        ValueError: an argument does not fit, or with discount 1 some node cannot reach an end.
        RuntimeError: `max_sweeps` were not enough; the message names a subtask and a state.
    """
    if method not in ("policy_iteration", "value_iteration"):
        raise ValueError(f"method must be 'policy_iteration' or 'value_iteration', got {method!r}")
    chooses = np.ones(process.num_nodes, np.bool_) if free is None else np.asarray(free, np.bool_)[process.context]
    if weights is None and not chooses.all():
        raise ValueError("weights are needed for the contexts that are not free")
    gains = process.reward if reward is None else reward
    uniform = process.uniform()
    start = uniform if weights is None else np.where(chooses[process.row_node], uniform, weights)
    process.require_an_end(start)

    def backup(value: np.ndarray) -> np.ndarray:
        return gains + process.follows @ value

    if method == "value_iteration":
        value = np.zeros(process.num_nodes)
        for sweep in range(1, max_sweeps + 1):
            q = backup(value)
            updated = np.where(chooses, process.maxima(q), process.sums(start * q))
            change = np.abs(updated - value)
            value = updated
            if change.max() <= tolerance * (1 + np.abs(value).max()):
                q = backup(value)
                found = np.where(chooses[process.row_node], _shared(process, _ties(process, q)), start)
                return Optimum(q, value, found, sweep)
        raise RuntimeError(f"{max_sweeps} sweeps were not enough: {process.where(int(np.argmax(change)))} still changes")

    everywhere = np.ones(process.num_nodes, np.bool_)
    for improvement in range(1, max_sweeps + 1):
        value = Totals(process.chain(start), everywhere).of(process.sums(start * gains))
        q = backup(value)
        margin = _MARGIN * (1 + np.abs(value))
        mixed = process.maxima(start) < 1
        renewed = chooses & ((process.maxima(q) > value + margin) | mixed)
        updated = np.where(renewed[process.row_node], _shared(process, _ties(process, q)), start)
        if np.array_equal(updated, start):
            return Optimum(q, value, start, improvement)
        start = updated
    raise RuntimeError(f"{max_sweeps} improvements were not enough; last at {process.where(int(np.argmax(renewed)))}")


def greedy(
    process: JointProcess, best: Optimum, ties: Ties = "first", free: np.ndarray | None = None
) -> np.ndarray:
    """One best child at every node, ``[C, S]`` int slots; -1 where a context cannot have control.

    Args:
        process: the hierarchy on its model.
        best: what `optimise` found.
        ties: children that tie are taken in the order of their slots, or from the last. Without
            discounting, a tie may be between staying away from the end for ever and not: there the
            first child is taken that can lead nearer to the end.
        free: ``[C]`` bool; contexts that are not take a child that their policy can take. All if None.
    """
    if ties not in ("first", "last"):
        raise ValueError(f"ties must be 'first' or 'last', got {ties!r}")
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


def recursively_optimal(
    hierarchy: Hierarchy,
    tasks: TaskArrays,
    model: Model,
    *,
    discount: float = 1.0,
    pseudo_reward: float = 0.0,
    ties: Ties = "first",
    method: Method = "policy_iteration",
    termination: Termination = "immediate",
) -> np.ndarray:
    """A recursively optimal policy, ``[tasks, S]`` int slots; -1 where a subtask is terminated.

    From the bottom of the task graph, every subtask takes the policy that earns it most until it
    ends, its own pseudo-reward included, with the policies of its children fixed and their
    pseudo-rewards left out (Definition 6; Dietterich 2000, C~ for the choice and C for the callers).
    The pseudo-reward counts as reward of the step on which the subtask ends.
    """
    order = sorted(hierarchy.subtasks, key=lambda task: hierarchy.height(task.name))
    policy = np.full(np.shape(tasks.active), -1)
    for task in order:
        process = joint_process(
            hierarchy,
            tasks.active,
            model,
            discount=discount,
            goal=tasks.goal,
            top=task.name,
            termination=termination,
        )
        free = np.arange(process.contexts.count) == 0
        owner = process.contexts.task[process.context]
        fixed = (policy[owner, process.state][process.row_node] == process.row_slot).astype(np.float64)
        gains = process.reward + pseudo_reward * process.goal
        best = optimise(process, fixed, free, reward=gains, method=method)
        policy[hierarchy.index(task.name)] = greedy(process, best, ties, free)[0]
    return policy


def solve_hierarchy(
    hierarchy: Hierarchy,
    tasks: TaskArrays,
    model: Model,
    initial: np.ndarray,
    *,
    discount: float = 1.0,
    pseudo_reward: float = 0.0,
    ties: Ties = "first",
    method: Method = "policy_iteration",
    termination: Termination = "immediate",
) -> Optima:
    """Optimal, hierarchically optimal and recursively optimal values side by side.

    A hierarchically optimal policy may choose by the whole calling stack. Where every subtask has
    one caller, that is Definition 7; with several, policies that do not know their caller
    (Definition 4) can be worse.

    Args:
        hierarchy: the task graph.
        tasks: its predicates at every state, for example `tabulate(hierarchy, env)`.
        model: the decision process, for example `env.model()`.
        initial: ``[S]`` probabilities of the first state, for example `env.initial_distribution()`.
        discount: in [0, 1].
        pseudo_reward: factor of the goals, for the recursively optimal policy; its values leave it out.
        ties: which of equally good children is taken.
        method: of both kinds of optimality.
        termination: see `joint_process`.

    Raises:
        ValueError: the root terminates before the episode, or a policy cannot end it without
            discounting; the message names the subtask and the state.
    """
    process = joint_process(hierarchy, tasks.active, model, discount=discount, termination=termination)
    flat = Hierarchy(hierarchy.actions, [Subtask("flat", hierarchy.actions, hierarchy.root.termination)])
    single = joint_process(flat, tasks.active[:1], model, discount=discount)
    for each in (process, single):
        if (each.leaves > 0).any():
            where = each.where(int(each.row_node[np.argmax(each.leaves > 0)]))
            raise ValueError(f"the root {hierarchy.root.name!r} can terminate before the episode, after a step of {where}")
    slots = recursively_optimal(
        hierarchy,
        tasks,
        model,
        discount=discount,
        pseudo_reward=pseudo_reward,
        ties=ties,
        method=method,
        termination=termination,
    )
    owned = np.where(process.node >= 0, slots[process.contexts.task], -1)
    followed = optimise(process, process.weights(owned), np.zeros(process.contexts.count, np.bool_))

    def criterion(of: JointProcess, best: Optimum, policy: np.ndarray | None = None) -> Criterion:
        value = of.spread_nodes(best.value)[0]
        mean = float(np.asarray(initial)[initial > 0] @ value[initial > 0])
        return Criterion(value, mean, greedy(of, best, ties) if policy is None else policy)

    return Optima(
        optimal=criterion(single, optimise(single, method=method)),
        hierarchical=criterion(process, optimise(process, method=method)),
        recursive=criterion(process, followed, owned),
    )


def _rows_of(process: JointProcess) -> list[np.ndarray]:
    """The rows of each context."""
    context = process.context[process.row_node]
    return [np.flatnonzero(context == number) for number in range(process.contexts.count)]


def _ties(process: JointProcess, q: np.ndarray) -> np.ndarray:
    """``[R]`` bool: rows as good as the best of their node."""
    best = process.maxima(q)
    return q >= (best - _MARGIN * (1 + np.abs(best)))[process.row_node]


def _shared(process: JointProcess, rows: np.ndarray) -> np.ndarray:
    return rows / process.sums(rows.astype(np.float64))[process.row_node]


def _made_to_end(process: JointProcess, rows: np.ndarray, allowed: np.ndarray, chosen_among) -> np.ndarray:
    """Replaces choices from which no end can be reached by allowed ones that lead nearer to one."""
    positive = process.follows.copy()
    positive.data = (positive.data > 0).astype(np.float64)
    reaches = np.zeros(process.num_nodes, np.bool_)
    while True:
        leads = (process.ends > 0) | (positive @ reaches.astype(np.float64) > 0)
        further = reaches | leads[rows]
        if np.array_equal(further, reaches):  # nothing more ends by itself
            could = process.maxima((leads & allowed).astype(np.float64)) > 0
            helped = could & ~reaches
            if not helped.any():
                return rows
            rows = np.where(helped, chosen_among(leads & allowed), rows)
            further = reaches | helped
        reaches = further
