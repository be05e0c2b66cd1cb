"""What a hierarchical learner asks of a root that has a policy of its own: the subtask outside of the leaf cover."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Generic, NamedTuple, TypeAlias, TypeVar

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core.flags import Flag
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.learners.base import Context, Transition
from hrljax.learners.hyperparameters import Settings

Prepared = TypeVar("Prepared")
Tables = TypeVar("Tables")
Memory = TypeVar("Memory")
Asked = TypeVar("Asked")
"""Type of what a root goes by when it decides."""
ChildValue: TypeAlias = Callable[[Array, Array], Array]
"""Value of a subtask (int32, counted without the root) from a state (int32) until it ends."""


class Decision(NamedTuple, Generic[Memory]):
    """A choice of the root, and what it remembers of it until the next one."""

    task: Array  # int32: the subtask, counted without the root
    memory: Memory  # a few scalars; () if it remembers nothing


class Root(Settings, ABC, Generic[Prepared, Tables, Memory, Asked]):
    """How a root chooses what its subtasks do; scalar and pure, as `hrljax.learners.base.Learner`."""

    name: ClassVar[str]
    has_loops: ClassVar[bool] = False
    """As of `hrljax.learners.base.Learner`."""

    @property
    def planning_interval(self) -> int:
        """Episodes between two calls of `plan`; 0 if this root does not plan."""
        return 0

    @abstractmethod
    def init(self, prepared: Prepared) -> Tables:
        """What the root has learned before the first episode."""

    @abstractmethod
    def begin(self, prepared: Prepared, tables: Tables, asked: Asked, context: Context) -> Decision[Memory]:
        """The first choice of an episode."""

    @abstractmethod
    def step(
        self,
        prepared: Prepared,
        tables: Tables,
        decision: Decision[Memory],
        transition: Transition,
        ended: Flag,
        discount: Array,
        asked: Asked,
        context: Context,
    ) -> tuple[Tables, Decision[Memory]]:
        """Sees every primitive step, and decides anew where the subtask has ended and the episode goes on.

        Args:
            prepared: what the root needs of the environment.
            tables: what it has learned.
            decision: what it chose last.
            transition: the step.
            ended: whether the subtask ended with it.
            discount: of this one step, float32.
            asked: what a new decision goes by.
            context: where it does not learn, tables stay as they are.
        """

    def plan(self, prepared: Prepared, tables: Tables, context: Context) -> Tables:
        """Plans between two episodes, before every `planning_interval`-th one: the new `tables`."""
        return tables


class Question(NamedTuple):
    """What a root over subtasks goes by when it decides."""

    state: Array  # int32: where it decides
    word: Array  # uint32: a random word
    epsilon: Array  # float32: the learner's probability of a random choice
    child_value: ChildValue


class SubtaskRoot(Root[Prepared, Tables, Memory, Question]):
    """Chooses among the subtasks of a hierarchy that can be invoked."""

    uses_child_values: ClassVar[bool] = False
    """Whether it asks what its subtasks are worth until they end."""

    @abstractmethod
    def prepare(self, hierarchy: Hierarchy, env: AnyTabularEnvironment) -> Prepared:
        """Tables that the root needs, made once on the host."""

    @abstractmethod
    def probabilities(
        self, prepared: Prepared, tables: Tables, child_value: ChildValue, state: Array, context: Context
    ) -> Array:
        """How likely each subtask is to be invoked without exploration, ``[tasks]`` float32."""


class MemorylessRoot(SubtaskRoot[Prepared, tuple[()], tuple[()]]):
    """Learns nothing and remembers nothing: `begin` says what it chooses in a state."""

    def init(self, prepared: Prepared) -> tuple[()]:
        return ()

    def step(
        self,
        prepared: Prepared,
        tables: tuple[()],
        decision: Decision[tuple[()]],
        transition: Transition,
        ended: Flag,
        discount: Array,
        asked: Question,
        context: Context,
    ) -> tuple[tuple[()], Decision[tuple[()]]]:
        decides = jnp.asarray(ended) & ~transition.terminated & context.learns
        return tables, lax.cond(decides, lambda: self.begin(prepared, tables, asked, context), lambda: decision)


AnySubtaskRoot: TypeAlias = SubtaskRoot[Any, Any, Any]
