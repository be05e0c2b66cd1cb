"""Leaf covers: making them total, and what Theorem 2 of the thesis needs of them in every state."""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hrljax.core import checks
from hrljax.hierarchy.definition import Hierarchy


class TotalLeafCover(NamedTuple):
    """A hierarchy with a total leaf cover, and what that took."""

    hierarchy: Hierarchy
    cover: tuple[str, ...]  # the subtasks of the cover
    added: dict[str, tuple[str, ...]]  # by subtask, the primitive actions that it did not have


class Inaccessible(NamedTuple):
    """A primitive action that a subtask cannot execute in some of its active states."""

    subtask: str
    action: str
    state: int  # an example
    num_states: int  # in how many active states

    def __str__(self) -> str:
        return (
            f"subtask {self.subtask!r} cannot execute {self.action!r} in {self.num_states} of its active states, "
            f"for example in state {self.state}"
        )


def total_leaf_cover(
    hierarchy: Hierarchy,
    cover: Iterable[str] | None = None,
    *,
    active: np.ndarray | None = None,
    direct: bool = False,
) -> TotalLeafCover:
    """Adds the primitive actions that subtasks of a leaf cover miss (thesis 3.1, Definition 8).

    Subtasks are completed from the bottom of the task graph, so that an action is not added where a
    completed child gives access to it. Added actions come after the other children, in the
    environment's order: ties between children stay as they were.

    Args:
        hierarchy: the task graph.
        cover: names of subtasks; the smallest leaf cover if None.
        active: ``[tasks, S]`` bool, where each subtask is active. If given, an action is also added
            where children give access to it only in part of the subtask's active states, which is
            what Theorem 2 needs (`inaccessible` then finds nothing).
        direct: adds every action to every subtask of the cover as its own child, as Theorem 3 asks.

    Raises:
        ValueError: a name is no subtask, or the cover leaves out a subtask that has a primitive
            child. The message names it.
    """
    names = _checked(hierarchy, cover)
    added: dict[str, tuple[str, ...]] = {}
    completed = hierarchy
    for name in sorted(names, key=lambda name: (hierarchy.height(name), hierarchy.index(name))):
        has: frozenset[str] = frozenset(completed[name].children) if direct else completed.reachable_actions(name)
        partly: set[str] = set()
        if active is not None:
            partly = {gap.action for gap in inaccessible(completed, active, names) if gap.subtask == name}
        missing = tuple(action for action in hierarchy.actions if action not in has or action in partly)
        if missing:
            added[name] = missing
            completed = _with_children(completed, name, missing)
    return TotalLeafCover(completed, names, {name: added[name] for name in names if name in added})


def accessible(hierarchy: Hierarchy, active: np.ndarray) -> np.ndarray:
    """Where each subtask can execute each primitive action, ``[tasks, S, A]`` bool.

    An action is accessible where the subtask is active and the action is its child or accessible to
    a child that can be invoked there. False where the subtask is not active.

    Args:
        hierarchy: the task graph.
        active: ``[tasks, S]`` bool, subtasks in the hierarchy's order.

    Raises:
        ValueError: the shape does not fit.
    """
    active = checks.as_array("active", active, np.bool_, (len(hierarchy.subtasks), None), "bools")
    accessible = np.zeros((*active.shape, len(hierarchy.actions)), np.bool_)
    for task in sorted(hierarchy.subtasks, key=lambda task: hierarchy.height(task.name)):
        of_task = accessible[hierarchy.index(task.name)]
        for child in task.children:
            if hierarchy.is_primitive(child):
                of_task[:, hierarchy.actions.index(child)] = True
            else:
                of_task |= accessible[hierarchy.index(child)]
        of_task &= active[hierarchy.index(task.name)][:, None]
    return accessible


def inaccessible(
    hierarchy: Hierarchy, active: np.ndarray, cover: Iterable[str] | None = None
) -> tuple[Inaccessible, ...]:
    """What Theorem 2 lacks: it holds where this is empty.

    The theorem's proof lets every subtask of a total leaf cover imitate any policy over primitive
    actions. So every primitive action must be accessible in every state in which such a subtask is
    active; one that is accessible only through a child that is inactive there is not.

    Args:
        hierarchy: the task graph.
        active: ``[tasks, S]`` bool, for example ``tabulate(hierarchy, env).active``.
        cover: names of subtasks; the smallest leaf cover if None.

    Returns:
        One entry for every subtask of the cover and action that it lacks somewhere.

    Raises:
        ValueError: as `total_leaf_cover` and `accessible`.
    """
    names = _checked(hierarchy, cover)
    can_execute = accessible(hierarchy, active)
    gaps = []
    for name in names:
        lacks = np.asarray(active, np.bool_)[hierarchy.index(name)][:, None] & ~can_execute[hierarchy.index(name)]
        for number, action in enumerate(hierarchy.actions):
            states = np.flatnonzero(lacks[:, number])
            if len(states):
                gaps.append(Inaccessible(name, action, int(states[0]), len(states)))
    return tuple(gaps)


def _checked(hierarchy: Hierarchy, cover: Iterable[str] | None) -> tuple[str, ...]:
    """The cover's subtasks in the hierarchy's order."""
    checks.instance("hierarchy", hierarchy, Hierarchy, "a Hierarchy such as env.hierarchy()")
    least = hierarchy.leaf_cover()
    names = set(least if cover is None else checks.names("cover", cover))
    known = [task.name for task in hierarchy.subtasks]
    for name in sorted(names - set(known)):
        raise ValueError(f"cover names {name!r}, which is no subtask; subtasks are {', '.join(known)}")
    for name in least:
        if name not in names:
            raise ValueError(f"a leaf cover holds every subtask with a primitive child: {name!r} is missing")
    return tuple(name for name in known if name in names)


def _with_children(hierarchy: Hierarchy, name: str, more: tuple[str, ...]) -> Hierarchy:
    tasks = (replace(t, children=t.children + more) if t.name == name else t for t in hierarchy.subtasks)
    return Hierarchy(hierarchy.actions, tasks)
