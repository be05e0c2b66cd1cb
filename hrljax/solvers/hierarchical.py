"""Optimal, hierarchically optimal and recursively optimal policies of a task hierarchy on a known model.

Everything runs in float64 NumPy on the host. All three criteria are one problem (`optimise`) in which
some subtasks are free to choose and the others are fixed: all are free, a single one that never ends
is, or one after the other is, from the bottom of the task graph.
"""

import warnings
from typing import NamedTuple, Protocol

import numpy as np

from hrljax.core import checks
from hrljax.hierarchy.definition import Hierarchy, Subtask
from hrljax.solvers.joint import JointProcess, NoBestPolicyError, Termination, joint_process
from hrljax.solvers.joint_optima import Method, Optimum, Ties, greedy, optimise
from hrljax.solvers.model import Model


class TaskArrays(Protocol):
    """A hierarchy's predicates at every state, as `hrljax.hierarchy.tables.tabulate` gives them."""

    @property
    def active(self) -> np.ndarray: ...  # [tasks, S] bool

    @property
    def goal(self) -> np.ndarray: ...  # [tasks, S] factor of the pseudo-reward


class Criterion(NamedTuple):
    """One criterion's values and policy; NaN and -1 throughout if there is no such policy."""

    value: np.ndarray  # [S] expected return where the root decides; NaN where it cannot
    mean: float  # over the start distribution
    policy: np.ndarray  # [C, S] int slots of children by context; -1 where the context cannot have control
    action: np.ndarray  # [S] int: the primitive action taken when the root decides; -1 where it cannot
    why_missing: str | None = None  # why there is no such policy; None if there is one


class Optima(NamedTuple):
    """The best policies of a problem: without a hierarchy, within it, and with each subtask optimal for itself."""

    optimal: Criterion
    hierarchical: Criterion
    recursive: Criterion


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

    Raises:
        NoBestPolicyError: there is none; the message says in which subtask and state.
        TypeError, ValueError: a bad argument.
    """
    _check_tasks(tasks)
    pseudo_reward = checks.number("pseudo_reward", pseudo_reward)
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
        free = np.arange(process.contexts.size) == 0
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

    There can be a best policy and no recursively optimal one: subtasks that only look to their own end may
    lead into each other for ever. Then `recursive` is NaN, says why, and a warning does so too.

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
        TypeError: an argument is of the wrong kind.
        ValueError: a number is out of range, the root terminates before the episode, or no policy of the
            hierarchy can end it without discounting; the message names the subtask and the state.
    """
    _check_tasks(tasks)
    pseudo_reward = checks.number("pseudo_reward", pseudo_reward)
    checks.choice("ties", ties, Ties)
    process = joint_process(hierarchy, tasks.active, model, discount=discount, termination=termination)
    flat = Hierarchy(hierarchy.actions, [Subtask("flat", hierarchy.actions, hierarchy.root.termination)])
    single = joint_process(flat, tasks.active[:1], model, discount=discount)
    for each in (process, single):
        if (each.leaves > 0).any():
            where = each.where(int(each.row_node[np.argmax(each.leaves > 0)]))
            raise ValueError(
                f"the root {hierarchy.root.name!r} can terminate before the episode, after a step of {where}"
            )
    initial = checks.probabilities("initial", initial, model.num_states)

    def criterion(of: JointProcess, best: Optimum, free: bool = True) -> Criterion:
        value = of.spread_nodes(best.value)[0]
        mean = float(initial[initial > 0] @ value[initial > 0])
        policy = greedy(of, best, ties, np.full(of.contexts.size, free))
        return Criterion(value, mean, policy, of.actions(policy)[0])

    optimal = criterion(single, optimise(single, method=method))
    hierarchical = criterion(process, optimise(process, method=method))
    try:
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
        followed = optimise(process, process.weights(slots), np.zeros(process.contexts.size, np.bool_))
        recursive = criterion(process, followed, free=False)
    except NoBestPolicyError as error:
        recursive = _missing(process, str(error))
        message = f"there is no recursively optimal policy with a pseudo-reward of {pseudo_reward:g}: {error}"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
    return Optima(optimal, hierarchical, recursive)


def _missing(process: JointProcess, why: str) -> Criterion:
    """A criterion that no policy meets."""
    num_contexts, num_states, _ = process.shape
    nowhere = np.full((num_contexts, num_states), -1)
    return Criterion(np.full(num_states, np.nan), np.nan, nowhere, nowhere[0], why)


def _check_tasks(tasks: object) -> None:
    if not (hasattr(tasks, "active") and hasattr(tasks, "goal")):
        raise TypeError(
            "tasks must be a hierarchy's predicates at every state, hrljax.hierarchy.tables.tabulate(hierarchy, "
            f"env), got {checks.described(tasks)}"
        )
