"""Whether an environment is what the library takes it for, all at once."""

from collections.abc import Callable
from functools import partial

import gymnasium
import jax
import numpy as np
from jax import Array

from hrljax.core import checks
from hrljax.core.environment import Params, State
from hrljax.envs.base import AnyEnvironment, Environment, TabularEnvironment, numbers_of
from hrljax.envs.checks import check_declarations, check_types, check_values
from hrljax.envs.tabular_checks import check_model, check_words

_STEPS, _REPEATED = 24, 2
"""Steps that are taken from `reset` on; how many of them are repeated, without compilation too."""


def check(env: Environment[State, Params], params: Params | None = None) -> None:
    """Checks an environment of one's own, as Gymnasium's ``check_env`` does. Takes some seconds.

    Training and exact models refuse what would give them senseless numbers; this looks closer:

    - attributes, and what every method returns: shapes, dtypes, events, numbers of random words;
    - rewards, events and the numbers of states, of every outcome where they are few, else of random episodes;
    - `step` against `reset`: states and observations of the same types, observations in
      `observation_space`, a `time` that counts steps;
    - the same step twice, and compiled or not, leads to the same;
    - of a tabular environment: `encode`, `decode` and `time`; random words between the cuts; `model` and
      `initial_distribution` against what happens;
    - `variables`, if it says what they are;
    - pictures, if it has a renderer.

    Args:
        env: the environment.
        params: its numbers, `env.default_params` if None.

    Raises:
        TypeError, ValueError: what is wrong first; the message names the method, the value, and where it
            can the state and the action.
    """
    checks.instance("env", env, Environment, "an environment such as hrljax.make('Bus')")
    check_declarations(env)
    numbers = _checked_numbers(env, params)
    try:
        hash(env)
    except TypeError as error:
        advice = "make it a dataclass(frozen=True) whose fields are numbers, strings and tuples"
        raise TypeError(f"{env.name}: an environment must have a hash, to be swept; {advice} ({error})") from None
    check_types(env, numbers)
    check_values(env, (numbers,), True)
    state = _check_steps(env, numbers)
    if isinstance(env, TabularEnvironment):
        check_words(env, numbers)
        check_model(env, numbers)
        if type(env).variables is not TabularEnvironment.variables:
            env.factored()
    _check_pictures(env, state)


def _checked_numbers(env: Environment[State, Params], params: Params | None) -> Params:
    default = env.default_params
    if not isinstance(default, tuple) or "max_steps" not in getattr(default, "_fields", ()):
        raise TypeError(f"{env.name}: default_params must be a NamedTuple with a field max_steps, got {default!r}")
    return numbers_of(env, params)


def _check_steps(env: Environment[State, Params], params: Params) -> State:
    """Checks `reset` and `step`; returns a state."""
    reset, step = jax.jit(partial(env.reset, params=params)), jax.jit(partial(env.step, params=params))
    keys = jax.random.split(jax.random.key(0), _STEPS + 1)
    observation, state = begun = reset(keys[-1])
    _check_same(env, "reset", begun, partial(env.reset, params=params), keys[-1])
    types = _types(begun)
    _check_observation(env, observation)
    if state.time != 0:
        raise ValueError(f"{env.name}: initial must return a state of time 0, got {state.time}")
    for number, key in enumerate(keys[:_STEPS]):
        action = np.int32(number % env.num_actions)
        stepped = step(key, state, action)
        if number < _REPEATED:
            _check_same(env, "step", stepped, partial(env.step, params=params), key, state, action)
        observation, after, _, terminated, truncated, _ = stepped
        if _types((observation, after)) != types:
            raise TypeError(f"{env.name}: observations and states must be of the same types in every step")
        if after.time != state.time + 1:
            raise ValueError(f"{env.name}: transition must return a state of time {state.time + 1}, got {after.time}")
        _check_observation(env, observation)
        state = reset(key)[1] if terminated or truncated else after
    return state


def _types(values: object) -> object:
    return [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(values)], jax.tree.structure(values)


def _check_same(
    env: AnyEnvironment, name: str, expected: object, method: Callable[..., object], *arguments: object
) -> None:
    """Raises unless a method, called twice without compilation, returns what it returned compiled (`expected`)."""
    for _ in range(2):
        one, other = (jax.tree_util.tree_flatten_with_path(values)[0] for values in (expected, method(*arguments)))
        for (path, value), (_, repeated) in zip(one, other, strict=True):
            if not np.allclose(value, repeated, rtol=1e-5, atol=1e-6, equal_nan=True):
                part = jax.tree_util.keystr(path)
                raise ValueError(
                    f"{env.name}: {name} must depend on nothing but its arguments: with the same ones, part {part} of "
                    f"what it returned was {np.asarray(value)} compiled and {np.asarray(repeated)} uncompiled"
                )


def _check_observation(env: AnyEnvironment, observation: Array) -> None:
    from hrljax.envs.numpy_values import as_element  # adapters are loaded with their first use

    space = env.observation_space
    if not isinstance(space, gymnasium.Space):
        raise TypeError(f"{env.name}: observation_space must be a space of Gymnasium, got {space!r}")
    try:
        element = as_element(space, jax.tree.map(np.asarray, observation))
        fits = space.contains(element)
    except (TypeError, ValueError, KeyError, AttributeError):
        element, fits = np.nan, False
    # The space's type must lose nothing of a number or an array; what a Dict or a Tuple holds is not compared.
    is_exact = isinstance(space, gymnasium.spaces.Dict | gymnasium.spaces.Tuple) or np.array_equal(element, observation)
    if not (fits and is_exact):
        raise ValueError(f"{env.name}: observation must return an element of {space}, got {observation}")


def _check_pictures(env: Environment[State, Params], state: State) -> None:
    for mode in env.render_modes:
        try:
            picture = env.render(state, mode)
        except (ImportError, AttributeError) as error:
            raise ValueError(
                f"{env.name}: renderer must be a module with functions text(env, state) and rgb_array(env, state), "
                f"got {env.renderer!r}: {error}"
            ) from error
        if mode == "ansi" and not isinstance(picture, str):
            raise TypeError(f"{env.name}: render must return a str for 'ansi', got {checks.type_in_words(picture)}")
        if mode == "rgb_array":
            shape, dtype = np.shape(picture), getattr(picture, "dtype", None)
            if dtype != np.uint8 or len(shape) != 3 or shape[-1] != 3:
                got = checks.type_in_words(picture)
                raise TypeError(f"{env.name}: render must return uint8 of shape [H, W, 3] for 'rgb_array', got {got}")
