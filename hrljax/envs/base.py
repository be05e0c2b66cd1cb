"""The environment contract.

An environment describes one episode for one agent, in scalars. `reset` and `step` take keys, as in
gymnax 1.0, and never reset by themselves. Under them lie `initial` and `transition`, which are
deterministic in explicit random words (`hrljax.core.random`): a training loop feeds them random words,
an exact model feeds them one word of every kind, so that the simulator and the model cannot disagree.
"""

from abc import abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar, Protocol, TypeAlias, cast

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from hrljax.core import checks, contract, random
from hrljax.core.environment import Dynamics, Events, Params, State, TabularDynamics
from hrljax.envs.checks import check_types
from hrljax.envs.factored import FactoredStates, factored_states
from hrljax.envs.outcomes import WordKinds, enumerate_outcomes, first_numbers
from hrljax.hierarchy.definition import Hierarchy
from hrljax.solvers.model import Model

_RESET_STREAM = 1


def concrete_params(params: Params) -> Params:
    """The numbers of an environment as float32 and int constants, where they are not traced.

    Arithmetic on them then gives the bits that it gives on traced arrays.

    Raises:
        TypeError: a field is no number, or ``max_steps`` no integer.
        ValueError: a number is not finite, a field ``*_probability`` is outside [0, 1], or
            ``max_steps`` is not from 1 to 2**31 - 1.
    """
    return params._replace(**{field: concrete_number(field, value) for field, value in params._asdict().items()})


def concrete_number(field: str, value: float | Array) -> int | np.float32 | Array:
    """One of the numbers of an environment, as `concrete_params` gives it."""
    if field == "max_steps":
        return checks.integer(f"env.{field}", value, 1, may_be_traced=True)
    interval = checks.SHARE if field.endswith("probability") else checks.ANY_NUMBER
    value = checks.number(f"env.{field}", value, interval, may_be_traced=True)
    return value if isinstance(value, Tracer) else np.float32(value)


def numbers_of(env: "Environment[State, Params]", params: Params | None) -> Params:
    """The numbers of an environment, its default ones if None, as `concrete_params` gives them.

    Raises:
        TypeError, ValueError: `params` are not those of the environment; as `concrete_params`.
    """
    default = env.default_params
    if params is None:
        return concrete_params(default)
    if not isinstance(params, tuple) or getattr(params, "_fields", None) != tuple(default._asdict()):
        raise TypeError(
            f"params must be a {type(default).__name__}, the numbers of {env.name}, such as "
            f"env.default_params._replace(max_steps=5), got {checks.described(params)}"
        )
    return concrete_params(params)


def check_options(env: object, options: Mapping[str, tuple[object, ...]]) -> None:
    """Raises ValueError unless each attribute of `env` that `options` names has one of its values."""
    for option, allowed in options.items():
        checks.choice(option, getattr(env, option), allowed)


def check_render_mode(env: "AnyEnvironment", mode: object) -> None:
    """Raises ValueError unless `env` can draw in `mode`."""
    if not env.render_modes:
        raise ValueError(f"{env.name} has no pictures, for it has no renderer; got the render mode {mode!r}")
    if mode not in env.render_modes:
        raise ValueError(f"render mode must be one of {', '.join(map(repr, env.render_modes))}; got {mode!r}")


class Renderer(Protocol):
    """A module that draws the states of an environment."""

    def text(self, env: object, state: object, /) -> str: ...
    def rgb_array(self, env: object, state: object, /) -> np.ndarray: ...  # [H, W, 3] uint8


class Environment(Dynamics[State, Params]):
    """An episodic environment with a finite set of actions.

    What an author writes is `default_params`, `observation`, `observation_space`, and the attributes and methods of
    `hrljax.core.environment.Dynamics`: `name`, `action_names`, `initial`, `transition` and so on.
    """

    renderer: ClassVar[str | None] = None
    """The name of a module that is a `Renderer`; loaded with the first picture."""

    @property
    @abstractmethod
    def default_params(self) -> Params:
        """The numbers of the environment as a NamedTuple of floats, with a field `max_steps` (int)."""

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
        module = cast(Renderer, import_module(str(self.renderer)))
        return module.text(self, state) if mode == "ansi" else module.rgb_array(self, state)

    def reset(self, key: Array, params: Params | None = None) -> tuple[Array, State]:
        """Starts an episode: ``obs, state``. Consumes `key`."""
        drawn = random.words(random.key_words(key), jnp.uint32(0), self.num_initial_words, _RESET_STREAM)
        state = contract.initial(self, drawn, numbers_of(self, params))
        return self.observation(state), state

    def step(
        self, key: Array, state: State, action: Array | int, params: Params | None = None
    ) -> tuple[Array, State, Array, Array, Array, Events]:
        """Takes one step: ``obs, state, reward, terminated, truncated, info``. Consumes `key`.

        `truncated` holds when ``params.max_steps`` steps were taken without termination. The
        episode is over when either holds; the caller then calls `reset`.
        """
        numbers, action = numbers_of(self, params), self._checked_action(action)
        drawn = random.words(random.key_words(key), jnp.uint32(0), self.num_words)
        state, reward, terminated, info = contract.transition(self, state, action, drawn, numbers)
        truncated = (state.time >= numbers.max_steps) & ~terminated
        return self.observation(state), state, reward, terminated, truncated, info

    def _checked_action(self, action: object) -> Array:
        """An action as int32, if it is the number of one."""
        return jnp.asarray(checks.integer("action", action, 0, self.num_actions - 1, may_be_traced=True), jnp.int32)


class TabularEnvironment(Environment[State, Params], TabularDynamics[State, Params]):
    """An environment whose states have numbers.

    An author writes `num_states`, `encode`, `decode`, `word_cuts` and `initial_word_cuts` too, as
    `hrljax.core.environment.TabularDynamics` says, and no `observation`.
    """

    def hierarchy(self) -> Hierarchy:
        """The standard task hierarchy of this environment."""
        raise NotImplementedError(f"{self.name} has no standard hierarchy")

    def variables(self, state: State) -> Mapping[str, Array]:
        """The variables of a state by name: integers from 0, which together tell all states apart.

        By default the fields of the state but `time`. An environment says otherwise where other ones mean more, such as
        the row and the column of a cell.
        """
        fields = jax.tree_util.tree_flatten_with_path(state)[0]
        by_name = {jax.tree_util.keystr(path, simple=True, separator="."): value for path, value in fields}
        return {name: value for name, value in by_name.items() if name != "time"}

    def factored(self) -> FactoredStates:
        """The values of `variables` in every state: what learners of factored models go by.

        Raises:
            TypeError, ValueError: the variables are not such; the message names one.
        """
        return factored_states(self, self.variables)

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

    def _fixed_numbers(self, params: Params | None) -> Params:
        numbers = numbers_of(self, params)
        if any(isinstance(number, Tracer) for number in numbers):
            raise TypeError(
                f"params must be fixed numbers where the exact model of {self.name} is made, got "
                f"{checks.described(numbers)}"
            )
        return numbers


AnyEnvironment: TypeAlias = Environment[Any, Any]
AnyTabularEnvironment: TypeAlias = TabularEnvironment[Any, Any]
