"""The environment contract.

An environment describes one episode for one agent, in scalars. `reset` and `step` take keys, as in
gymnax 1.0, and never reset by themselves. Under them lie `initial` and `transition`, which are
deterministic in explicit random words (`hrljax.core.random`): a training loop feeds them random words,
`exact_model` feeds them one word of every kind, so that the simulator and the model cannot disagree.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar, Generic, TypeAlias, TypeVar

import gymnasium
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from hrljax.core import checks, contract, random
from hrljax.envs.checks import check_types
from hrljax.envs.outcomes import WordKinds, enumerate_outcomes, first_numbers
from hrljax.hierarchy.definition import Hierarchy
from hrljax.solvers.model import Model

State = TypeVar("State", bound=Any)
Params = TypeVar("Params", bound=Any)

_RESET_STREAM = 1


def concrete_params(params: Any) -> Any:
    """The numbers of an environment as float32 and int constants, where they are not traced.

    Arithmetic on them then gives the bits that it gives on traced arrays.

    Raises:
        TypeError: a field is no number, or ``max_steps`` no integer.
        ValueError: a number is not finite, a field ``*_probability`` is outside [0, 1], or
            ``max_steps`` is not from 1 to 2**31 - 1.
    """
    return params._replace(**{field: concrete_number(field, value) for field, value in params._asdict().items()})


def concrete_number(field: str, value: Any) -> Any:
    """One of the numbers of an environment, as `concrete_params` gives it."""
    if field == "max_steps":
        return checks.integer(f"env.{field}", value, 1, may_be_traced=True)
    interval = checks.SHARE if field.endswith("probability") else checks.ANY_NUMBER
    value = checks.number(f"env.{field}", value, interval, may_be_traced=True)
    return value if isinstance(value, Tracer) else np.float32(value)


def numbers_of(env: "AnyEnvironment", params: Any) -> Any:
    """The numbers of an environment, its default ones if None, as `concrete_params` gives them.

    Raises:
        TypeError, ValueError: `params` are not those of the environment; as `concrete_params`.
    """
    default = env.default_params
    if params is None:
        return concrete_params(default)
    if not isinstance(params, tuple) or getattr(params, "_fields", None) != default._fields:
        raise TypeError(
            f"params must be a {type(default).__name__}, the numbers of {env.name}, such as "
            f"env.default_params._replace(max_steps=5), got {checks.described(params)}"
        )
    return concrete_params(params)


def check_options(env: object, options: Mapping[str, tuple[Any, ...]]) -> None:
    """Raises ValueError unless each attribute of `env` that `options` names has one of its values."""
    for option, allowed in options.items():
        checks.choice(option, getattr(env, option), allowed)


def check_render_mode(env: "AnyEnvironment", mode: object) -> None:
    """Raises ValueError unless `env` can draw in `mode`."""
    if mode not in env.render_modes:
        allowed = ", ".join(map(repr, env.render_modes)) or f"nothing, for {env.name} has no pictures"
        raise ValueError(f"render mode must be one of {allowed}; got {mode!r}")


class Environment(ABC, Generic[State, Params]):
    """An episodic environment with a finite set of actions.

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
    """Whether it is a `TabularEnvironment`, whose states have numbers."""
    renderer: ClassVar[str | None] = None
    """A module with ``text(env, state)`` and ``rgb_array(env, state)``; loaded with the first picture."""

    @property
    def num_actions(self) -> int:
        return len(self.action_names)

    @property
    @abstractmethod
    def default_params(self) -> Params:
        """The numbers of the environment as a NamedTuple of floats, with a field `max_steps` (int)."""

    @abstractmethod
    def initial(self, words: tuple[Array, ...], params: Params) -> State:
        """The first state of an episode, deterministic in `num_initial_words` words."""

    @abstractmethod
    def transition(
        self, state: State, action: Array, words: tuple[Array, ...], params: Params
    ) -> tuple[State, Array, Array, dict[str, Array]]:
        """One step, deterministic in `num_words` words.

        Returns:
            next state; reward (float32, or whatever number, which is taken as one); terminated (bool):
            the episode ended in the environment itself, not by a limit of steps; info: whether each
            event in `metrics` happened (bool; or, unless the environment is tabular, how much of it,
            float32).
        """

    @abstractmethod
    def observation(self, state: State) -> Array:
        """What an agent sees of `state`."""

    @property
    @abstractmethod
    def observation_space(self) -> gymnasium.Space[Any]:
        """The Gymnasium space of `observation`."""

    @property
    def action_space(self) -> gymnasium.spaces.Discrete:
        """The Gymnasium space of actions."""
        return gymnasium.spaces.Discrete(self.num_actions)

    @property
    def render_modes(self) -> tuple[str, ...]:
        """What `render` can do."""
        return () if self.renderer is None else ("ansi", "rgb_array")

    def render(self, state: State, mode: str = "ansi") -> str | np.ndarray:
        """A picture of a state: a text for ``"ansi"``, ``[H, W, 3]`` uint8 for ``"rgb_array"``.

        Raises:
            ValueError: `mode` is none of `render_modes`.
        """
        check_render_mode(self, mode)
        module = import_module(str(self.renderer))
        return module.text(self, state) if mode == "ansi" else module.rgb_array(self, state)

    def reset(self, key: Array, params: Params | None = None) -> tuple[Array, State]:
        """Starts an episode: ``obs, state``. Consumes `key`."""
        drawn = random.words(random.key_words(key), jnp.uint32(0), self.num_initial_words, _RESET_STREAM)
        state = contract.initial(self, drawn, numbers_of(self, params))
        return self.observation(state), state

    def step(
        self, key: Array, state: State, action: Array | int, params: Params | None = None
    ) -> tuple[Array, State, Array, Array, Array, dict[str, Array]]:
        """Takes one step: ``obs, state, reward, terminated, truncated, info``. Consumes `key`.

        `truncated` holds when ``params.max_steps`` steps were taken without termination. The
        episode is over when either holds; the caller then calls `reset`.
        """
        numbers, action = numbers_of(self, params), self._checked_action(action)
        drawn = random.words(random.key_words(key), jnp.uint32(0), self.num_words)
        state, reward, terminated, info = contract.transition(self, state, action, drawn, numbers)
        truncated = (state.time >= numbers.max_steps) & ~terminated
        return self.observation(state), state, reward, terminated, truncated, info

    def _checked_action(self, action: Any) -> Array:
        """An action as int32, if it is the number of one."""
        return jnp.asarray(checks.integer("action", action, 0, self.num_actions - 1, may_be_traced=True), jnp.int32)


class TabularEnvironment(Environment[State, Params]):
    """An environment whose states have numbers: ``encode`` and ``decode`` convert, time excluded."""

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
    def word_cuts(self, params: Params) -> tuple[tuple[Any, ...], ...]:
        """For each word of `transition`: the probabilities at which its meaning changes.

        With cuts c1, c2, ... in (0, 1), two words on the same side of every cut (as fractions of
        their range) must give the same outcome in every state. Cuts of 0 or 1 and repeated cuts
        are allowed. The exact model rests on it, and so does training: with few kinds of words its
        steps are looked up. Both check the first and the last word of every kind.
        """

    @abstractmethod
    def initial_word_cuts(self, params: Params) -> tuple[tuple[Any, ...], ...]:
        """The same for the words of `initial`."""

    def hierarchy(self) -> Hierarchy:
        """The standard task hierarchy of this environment."""
        raise NotImplementedError(f"{self.name} has no standard hierarchy")

    def observation(self, state: State) -> Array:
        """The number of the state (int32 scalar)."""
        return contract.encode(self, state)

    @property
    def observation_space(self) -> gymnasium.spaces.Discrete:
        return gymnasium.spaces.Discrete(self.num_states)

    def model(self, params: Params | None = None) -> Model:
        """The exact model, by running `transition` on one word of every kind from every state.

        Numbers that belong to no state that occurs may have outcomes that make no sense (a reward that
        is not finite, a next state without a number); then the episode ends there, with reward 0.

        Raises:
            TypeError, ValueError: a method returns what it must not; the message names it, and the
                state and the action where it did. `word_cuts` may lack a cut.
        """
        numbers = self._fixed_numbers(params)
        check_types(self, numbers)
        kinds, outcomes, _ = enumerate_outcomes(self, numbers)
        return Model.merged(outcomes.next_state, outcomes.reward, (outcomes.flags & 1) == 1, kinds.weights())

    def initial_distribution(self, params: Params | None = None) -> np.ndarray:
        """Probability of each state number at the start of an episode, float64 ``[S]``.

        Raises:
            TypeError, ValueError: as `model`, of `initial` and `initial_word_cuts`.
        """
        numbers = self._fixed_numbers(params)
        check_types(self, numbers)
        kinds = WordKinds(contract.initial_word_cuts(self, numbers))
        return np.bincount(first_numbers(self, numbers, kinds), weights=kinds.weights(), minlength=self.num_states)

    def _fixed_numbers(self, params: Params | None) -> Any:
        numbers = numbers_of(self, params)
        if any(isinstance(number, Tracer) for number in numbers):
            raise TypeError(
                f"params must be fixed numbers where the exact model of {self.name} is made, got "
                f"{checks.described(numbers)}"
            )
        return numbers


AnyEnvironment: TypeAlias = Environment[Any, Any]
AnyTabularEnvironment: TypeAlias = TabularEnvironment[Any, Any]
