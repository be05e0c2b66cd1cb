"""Policies of the root, the subtask that is not in the leaf cover: random, or planned on a model."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from jax import Array

from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.learners.base import Moment
from hrljax.learners.hyperparameters import Settings

ChildValue = Callable[[Array, Array], Array]
"""Value of a subtask (int32, counted without the root) from a state (int32) until it ends."""


class Decision(NamedTuple):
    """A choice of the root; int32 scalars."""

    task: Array  # the subtask, counted without the root
    point: Array  # number of the decision point, of a root that plans
    slot: Array  # position of the subtask among those that can be invoked


class Root(Settings):
    """How the root chooses among the subtasks that can be invoked; scalar, as `Learner`."""

    name: str
    learns = False
    """Whether `observe`, `record` and `plan` do anything."""

    @property
    def planning_interval(self) -> int:
        """Episodes between two calls of `plan`; 0 if this root does not plan."""
        return 0

    @abstractmethod
    def prepare(self, hierarchy: Hierarchy, env: AnyTabularEnvironment) -> Any:
        """Tables that the root needs, made once on the host."""

    def init(self, prepared: Any) -> Any:
        """What the root has learned before the first episode."""
        return ()

    @abstractmethod
    def choose(
        self, prepared: Any, tables: Any, child_value: ChildValue, state: Array, word: Array, epsilon: Any, zero: Array
    ) -> tuple[Decision, Any]:
        """A choice in a state, and what was found out on the way, for `record`."""

    @abstractmethod
    def probabilities(self, prepared: Any, tables: Any, child_value: ChildValue, state: Array, zero: Array) -> Array:
        """How likely each subtask is to be invoked without exploration, ``[tasks]`` float32."""

    def observe(
        self,
        prepared: Any,
        tables: Any,
        decision: Decision,
        after: Array,
        terminated: Array,
        discount: Array,
        moment: Moment,
    ) -> Any:
        """Learns that the chosen subtask ended in state `after`, the episode possibly with it.

        `discount` is the discount factor to the power of the subtask's steps.
        """
        return tables

    def kept(self, prepared: Any, tables: Any, decision: Decision) -> Any:
        """What `record` has kept where `decision` was taken."""
        return ()

    def record(self, prepared: Any, tables: Any, decision: Decision, found: Any) -> Any:
        """Keeps what `choose` found out."""
        return tables

    def plan(self, prepared: Any, tables: Any, moment: Moment) -> Any:
        """Plans between two episodes."""
        return tables
