"""What a training loop asks of a learner."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Generic, NamedTuple, TypeAlias, TypeVar

import chex
import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core.environment import Words
from hrljax.core.lockstep import any_run, once_if
from hrljax.core.numerics import exact_product
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.learners.hyperparameters import Settings

Prepared = TypeVar("Prepared")
"""Type of what a learner's `prepare` makes."""
Tables = TypeVar("Tables")
"""Type of what a learner learns: a pytree of arrays."""
Control = TypeVar("Control")
"""Type of what a learner is doing: a pytree of a few scalars."""
T = TypeVar("T", bound=chex.ArrayTree)

Discounted: TypeAlias = Callable[[Array], Array]
"""``x -> g * x`` for a discount g; see `Context.discounted`."""


class Context(NamedTuple):
    """When in a run a learner is called, whether it counts, and the arithmetic that every mapping shares."""

    episode: Array  # int32 scalar, from 0
    learns: Array  # bool: False where nothing may change; a Python constant unless runs are mapped by vmap
    zero: Array  # uint32: `hrljax.core.numerics.opaque_zero`
    vmapped: bool = False
    """Static: runs take their steps together, so that a branch costs as much as both its sides."""

    def product(self, a: Array | np.float32, b: Array) -> Array:
        """``a * b``, rounded by itself; see `hrljax.core.numerics.exact_product`."""
        return exact_product(a, b, self.zero)

    def discounted(self, discount: Array | np.float32) -> Discounted:
        """``x -> discount * x``, rounded by itself."""
        return lambda value: exact_product(discount, value, self.zero)

    def any_run(self, flag: Array) -> Array:
        """A flag as the condition of a loop: under vmap whether it holds for any run of the batch.

        There the loop's body has to leave alone what belongs to a run whose own flag does not hold.
        """
        return any_run(flag) if self.vmapped else flag

    def when(self, condition: Array, update: "Callable[[T, Context], T]", tables: T) -> T:
        """``update(tables, context)`` where `condition` holds, else `tables`.

        Under vmap `update` always runs, and has to leave the tables alone where the context that it
        is given does not learn.
        """
        if self.vmapped:
            return update(tables, self._replace(learns=self.learns & condition))
        return once_if(condition, lambda tables: update(tables, self), tables)


def outside_of_training(zero: Array, episode: Array | int) -> Context:
    """The context in which a learner that has learned from so many episodes is asked what it would do."""
    return Context(jnp.asarray(episode, jnp.int32), jnp.bool_(False), zero)


class Transition(NamedTuple):
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


class Reported(NamedTuple):
    """What `learn` returns where a learner reports of every step."""

    state: LearnerState
    report: tuple[Array, ...]  # float32 scalars, see `Learner.reports`


class Learner(Settings, ABC, Generic[Prepared, Tables, Control]):
    """A learner, written for one run of one seed: every method is a pure function.

    The training loop calls `begin` at the first state of every episode, and for every step `action`
    and then `learn`. A tabular learner is given the numbers of states, another one the states.
    """

    name: ClassVar[str]
    is_tabular: ClassVar[bool] = True
    """Whether it needs a tabular environment."""
    has_loops: ClassVar[bool] = False
    """Whether `learn` or `plan` hold loops that change arrays several times; decides how native loops are compiled."""
    num_words: ClassVar[int]
    """Random words that one `learn` uses."""
    num_begin_words: ClassVar[int]
    """Random words that one `begin` uses."""

    @property
    def reports(self) -> tuple[str, ...]:
        """Names of what `learn` reports of every step, as `Reported`; their means per step are columns of results."""
        return ()

    @property
    def reports_per_episode(self) -> tuple[str, ...]:
        """Of `reports`, those of which columns of results are sums per episode instead of means per step."""
        return ()

    @property
    def planning_interval(self) -> int:
        """Episodes between two calls of `plan`; 0 if the learner does not plan."""
        return 0

    @abstractmethod
    def prepare(self, env: Any) -> Prepared:
        """Tables that the learner needs of the environment, made once on the host."""

    @abstractmethod
    def init(self, env: Any, prepared: Prepared) -> LearnerState:
        """The learner's state before the first episode."""

    @abstractmethod
    def begin(self, prepared: Prepared, tables: Tables, first: Any, words: Words, context: Context) -> Control:
        """Starts an episode at a state: the new `control`."""

    @abstractmethod
    def action(self, control: Control) -> Array:
        """The primitive action (int32) to take now."""

    @abstractmethod
    def learn(
        self, prepared: Prepared, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState | Reported:
        """Learns from one step and chooses the next action.

        The tables and the control that it returns have the shapes and dtypes of those that it was given.
        """

    def plan(self, prepared: Prepared, tables: Tables, context: Context) -> Tables:
        """Plans between two episodes, before every `planning_interval`-th one: the new `tables`."""
        return tables

    def greedy_policy(self, env: Any, prepared: Prepared, tables: Tables, context: Context) -> HierarchicalPolicy:
        """What the learner would do if it were greedy from now on."""
        raise NotImplementedError(f"{self.name} does not tell its greedy policy over the numbers of states")


AnyLearner: TypeAlias = Learner[Any, Any, Any]
