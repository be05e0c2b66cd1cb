"""How the episodes of an environment go: the methods that training loops, exact models and checks run.

`hrljax.envs.base` adds what users call. All methods are deterministic in random words (`hrljax.core.random`): a
training loop feeds them random words, an exact model one word of every kind.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar, Generic, Protocol, Self, TypeAlias, TypeGuard, TypeVar

from jax import Array

Words: TypeAlias = tuple[Array, ...]
"""Random words, uint32 arrays of one shape."""
Cuts: TypeAlias = tuple[tuple[Array | float, ...], ...]
"""For each random word, the probabilities at which its meaning changes."""
Events: TypeAlias = dict[str, Array]
"""By the names of events: whether they happened in a step (bool), or how much of them (float32)."""


class EpisodeState(Protocol):
    """A state of an episode: a pytree of arrays, one of which counts the steps taken."""

    @property
    def time(self) -> Array: ...  # int32


class Numbers(Protocol):
    """The numbers of an environment: a NamedTuple of floats and of `max_steps`."""

    @property
    def max_steps(self) -> int: ...
    def _asdict(self) -> dict[str, Any]: ...
    def _replace(self, **numbers: Any) -> Self: ...
    def __iter__(self) -> Iterator[Any]: ...


State = TypeVar("State", bound=EpisodeState)
Params = TypeVar("Params", bound=Numbers)
Decoded = TypeVar("Decoded", bound=EpisodeState, covariant=True)


class NumberedStates(Protocol[Decoded]):
    """Whatever has states with numbers."""

    name: ClassVar[str]

    def decode(self, index: Array) -> Decoded: ...


class Dynamics(ABC, Generic[State, Params]):
    """What happens in the episodes of an environment with a finite set of actions.

    Instances are immutable and compare by value, so that two equal ones share compiled code.
    Every state has an int32 field `time`, the number of steps taken in the episode.
    """

    name: ClassVar[str]
    action_names: ClassVar[tuple[str, ...]]
    metrics: ClassVar[tuple[str, ...]] = ()
    """Names of the events that `transition` counts in its `info`; results report them per episode."""
    has_loops: ClassVar[bool] = False
    """Whether `transition` holds loops that change arrays; decides how native loops are compiled."""
    num_words: ClassVar[int]
    """Random words that one `transition` uses."""
    num_initial_words: ClassVar[int]
    """Random words that one `initial` uses."""
    is_tabular: ClassVar[bool] = False
    """Whether states have numbers, as those of `TabularDynamics`."""

    @property
    def num_actions(self) -> int:
        return len(self.action_names)

    @abstractmethod
    def initial(self, words: Words, params: Params) -> State:
        """The first state of an episode, deterministic in `num_initial_words` words."""

    @abstractmethod
    def transition(
        self, state: State, action: Array, words: Words, params: Params
    ) -> tuple[State, Array, Array, Events]:
        """One step, deterministic in `num_words` words.

        Returns:
            next state; reward (float32, or whatever number, which is taken as one); terminated (bool):
            the episode ended in the environment itself, not by a limit of steps; info: whether each
            event in `metrics` happened (bool; or, unless the environment is tabular, how much of it,
            float32).
        """


class TabularDynamics(Dynamics[State, Params]):
    """Dynamics whose states have numbers: ``encode`` and ``decode`` convert, time excluded."""

    is_tabular = True

    @property
    @abstractmethod
    def num_states(self) -> int:
        """Size of the range of `encode`; some numbers may belong to no state that occurs."""

    @abstractmethod
    def encode(self, state: State) -> Array:
        """The number of a state, int32 in ``[0, num_states)``; does not depend on `time`."""

    @abstractmethod
    def decode(self, index: Array) -> State:
        """The state of a number, with `time` 0. Inverse of `encode`."""

    @abstractmethod
    def word_cuts(self, params: Params) -> Cuts:
        """For each word of `transition`: the probabilities at which its meaning changes.

        With cuts c1, c2, ... in (0, 1), two words on the same side of every cut (as fractions of
        their range) must give the same outcome in every state. Cuts of 0 or 1 and repeated cuts
        are allowed. The exact model rests on it, and so does training: with few kinds of words its
        steps are looked up. Both check the first and the last word of every kind.
        """

    @abstractmethod
    def initial_word_cuts(self, params: Params) -> Cuts:
        """The same for the words of `initial`."""


AnyDynamics: TypeAlias = Dynamics[Any, Any]
AnyTabularDynamics: TypeAlias = TabularDynamics[Any, Any]


def is_tabular(env: Dynamics[State, Params]) -> TypeGuard[TabularDynamics[State, Params]]:
    """Whether the states of an environment have numbers."""
    return env.is_tabular
