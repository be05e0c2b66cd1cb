"""What a training loop asks of a learner."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

from jax import Array

from hrljax.core.numerics import once_if
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.learners.hyperparameters import Settings


class Moment(NamedTuple):
    """Where in a run a step is taken, and whether it counts."""

    episode: Array  # int32 scalar, from 0
    live: Array  # bool: False where nothing may change; a Python constant unless runs are in lockstep
    zero: Array  # uint32: `hrljax.core.numerics.opaque_zero`
    lockstep: bool = False
    """Static: many runs take their steps together, so that a branch costs as much as both its sides."""

    def when(self, condition: Array, update: Callable[[Any, "Moment"], Any], tables: Any) -> Any:
        """``update(tables, moment)`` where `condition` holds, else `tables`.

        In lockstep `update` always runs and has to leave the tables alone where the moment that it
        is given is not live.
        """
        if self.lockstep:
            return update(tables, self._replace(live=self.live & condition))
        return once_if(condition, lambda tables: update(tables, self), tables)


class Experience(NamedTuple):
    """One primitive step, as scalars."""

    state: Any  # int32 number of the state; of an environment that is not tabular, the state
    action: Array  # int32
    reward: Array  # float32
    next_state: Any  # as `state`
    terminated: Array  # bool: the next state has no value


class LearnerState(NamedTuple):
    """State of a learner."""

    tables: Any  # what it has learned; large
    control: Any  # what it is doing; a few scalars


class Learner(Settings, ABC):
    """A learner, written for one run of one seed: every method is a pure function.

    The training loop calls `begin` at the first state of every episode, and for every step `action`
    and then `learn`. A tabular learner is given the numbers of states, another one the states.
    """

    name: ClassVar[str]
    is_tabular: ClassVar[bool] = True
    """Whether it needs a tabular environment."""
    num_words: ClassVar[int]
    """Random words that one `learn` uses."""
    num_begin_words: ClassVar[int]
    """Random words that one `begin` uses."""

    @property
    def planning_interval(self) -> int:
        """Episodes between two calls of `plan`; 0 if the learner does not plan."""
        return 0

    def prepare(self, env: Any) -> Any:
        """Tables that the learner needs of the environment, made once on the host."""
        return None

    @abstractmethod
    def init(self, env: Any, prepared: Any) -> LearnerState:
        """The learner's state before the first episode."""

    @abstractmethod
    def begin(self, prepared: Any, tables: Any, first: Any, words: tuple[Array, ...], moment: Moment) -> Any:
        """Starts an episode at a state: the new `control`."""

    @abstractmethod
    def action(self, control: Any) -> Array:
        """The primitive action (int32) to take now."""

    @abstractmethod
    def learn(
        self, prepared: Any, state: LearnerState, step: Experience, words: tuple[Array, ...], moment: Moment
    ) -> LearnerState:
        """Learns from one step and chooses the next action."""

    def plan(self, prepared: Any, tables: Any, moment: Moment) -> Any:
        """Plans between two episodes, before every `planning_interval`-th one: the new `tables`.

        Leaves them alone where `moment` is not live.
        """
        return tables

    def greedy_policy(self, env: Any, prepared: Any, tables: Any, zero: Array) -> HierarchicalPolicy:
        """What the learner would do if it were greedy from now on."""
        raise NotImplementedError(f"{self.name} does not tell its greedy policy over the numbers of states")
