"""Task hierarchies: subtasks, what they may invoke and where they end.

The formalism is MAXQ's (Dietterich 2000; thesis 2.5.1): a subtask is a termination predicate over
states, a set of children (primitive actions or other subtasks) and a pseudo-reward on its terminal
states. No subtask may invoke itself, directly or through others.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from jax import Array

from hrljax.core import checks

Predicate = Callable[[Any], Array]


class Abstraction(NamedTuple):
    """Which part of the state a model-based subtask plans over, the rest held fixed (thesis 4.1.1).

    Each function gives the number (int32) of a state's part, ``state == (planning, environment)``.
    """

    planning: Callable[[Any], Array]
    environment: Callable[[Any], Array]


@dataclass(frozen=True)
class Subtask:
    """One composite task.

    Attributes:
        name: unique among subtasks and actions.
        children: names of primitive actions and of subtasks, in the order of their slots. Ties
            between children go to the first.
        termination: true in the subtask's terminal states (one unbatched state in, bool out). The
            subtask can be invoked exactly where it is false.
        goal: where the pseudo-reward is paid when the subtask terminates, as a factor (bool or
            float32) of the learner's `pseudo_reward`; None pays nowhere.
        abstraction: the parts of the state that a model-based policy of this subtask separates.

    Raises:
        TypeError: an attribute is of the wrong kind. What functions return is checked when a learner or a
            solver asks them for every state.
    """

    name: str
    children: tuple[str, ...]
    termination: Predicate
    goal: Predicate | None = None
    abstraction: Abstraction | None = None

    def __post_init__(self) -> None:
        checks.text("name", self.name, "'Root'")
        owner = f"subtask {self.name!r}"
        object.__setattr__(self, "children", checks.names(f"{owner}: children", self.children))
        checks.function(f"{owner}: termination", self.termination, "of a state")
        if self.goal is not None:
            checks.function(f"{owner}: goal", self.goal, "of a state, or None")
        if self.abstraction is not None:
            checks.instance(f"{owner}: abstraction", self.abstraction, Abstraction, "an Abstraction or None")
            for part, function in self.abstraction._asdict().items():
                checks.function(f"{owner}: abstraction.{part}", function, "of a state")


class Hierarchy:
    """A task graph over the primitive actions of an environment.

    Args:
        actions: names of the primitive actions, in the environment's order.
        subtasks: the composite tasks; the first is the root.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: a name is used twice or unknown, a subtask has no children or none of the
            parents leads to it, or a subtask can invoke itself. The message names the subtask.
    """

    def __init__(self, actions: Iterable[str], subtasks: Iterable[Subtask]):
        self.actions = checks.names("actions", actions)
        self.subtasks = checks.sequence_of("subtasks", subtasks, Subtask, "hrljax.Subtask")
        self._by_name = {task.name: task for task in self.subtasks}
        self._validate()

    @property
    def root(self) -> Subtask:
        return self.subtasks[0]

    def __getitem__(self, name: str) -> Subtask:
        """The subtask of a name.

        Raises:
            KeyError: there is none; the message lists those that there are.
        """
        if name not in self._by_name:
            raise KeyError(f"there is no subtask {name!r}; subtasks are {', '.join(self._by_name)}")
        return self._by_name[name]

    def __repr__(self) -> str:
        graph = "; ".join(f"{t.name} -> {', '.join(t.children)}" for t in self.subtasks)
        return f"Hierarchy({graph})"

    def index(self, name: str) -> int:
        """Position of a subtask, 0 for the root."""
        return self.subtasks.index(self[name])

    def is_primitive(self, name: str) -> bool:
        return name in self.actions

    @property
    def depth(self) -> int:
        """Number of subtasks on the longest path from the root to a primitive action."""
        return self.height(self.root.name)

    def height(self, name: str) -> int:
        """Number of subtasks on the longest path from a subtask, itself included, to a primitive action."""
        return 0 if self.is_primitive(name) else 1 + max(self.height(c) for c in self[name].children)

    def leaf_cover(self) -> tuple[str, ...]:
        """The smallest leaf cover C(H): the subtasks with access to a primitive action (Definition 8)."""
        return tuple(t.name for t in self.subtasks if any(map(self.is_primitive, t.children)))

    def reachable_actions(self, name: str) -> frozenset[str]:
        """Primitive actions that a subtask can execute, itself or through its children."""
        actions: set[str] = set()
        for child in self[name].children:
            actions |= {child} if self.is_primitive(child) else self.reachable_actions(child)
        return frozenset(actions)

    def is_total_leaf_cover(self, cover: Iterable[str] | None = None) -> bool:
        """Whether every subtask of a leaf cover can execute every primitive action (Definition 8).

        Args:
            cover: names of subtasks; the smallest leaf cover if None.
        """
        names = set(self.leaf_cover() if cover is None else checks.names("cover", cover))
        return names >= set(self.leaf_cover()) and all(self.reachable_actions(n) == set(self.actions) for n in names)

    def _validate(self) -> None:
        if not self.subtasks:
            raise ValueError("a hierarchy needs at least one subtask, its root")
        names = [*self.actions, *(t.name for t in self.subtasks)]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"the name {name!r} is used {names.count(name)} times; names are unique")
        for task in self.subtasks:
            if not task.children:
                raise ValueError(f"subtask {task.name!r} has no children")
            for child in task.children:
                if child not in names:
                    raise ValueError(
                        f"subtask {task.name!r} has an unknown child {child!r}; known are {', '.join(names)}"
                    )
                if task.children.count(child) > 1:
                    raise ValueError(f"subtask {task.name!r} names its child {child!r} twice")
        reached = self._reach(self.root.name, ())
        for task in self.subtasks:
            if task.name not in reached:
                raise ValueError(f"subtask {task.name!r} cannot be reached from the root {self.root.name!r}")

    def _reach(self, name: str, path: tuple[str, ...]) -> set[str]:
        if name in path:
            raise ValueError(f"subtask {name!r} can invoke itself: {' -> '.join((*path, name))}")
        reached = {name}
        for child in self._by_name[name].children:
            if not self.is_primitive(child):
                reached |= self._reach(child, (*path, name))
        return reached
