"""An environment's own methods, with what they return made what `hrljax.envs.base` says, or an error that names them.

Whatever runs an environment calls it through these functions: `step`, training, exact models, checks. Numbers
of any dtype become the ones that they mean, and what already has the right dtype stays as it is, so that the
compiled program is the same.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core import checks
from hrljax.core.environment import (
    AnyDynamics,
    AnyTabularDynamics,
    Cuts,
    Dynamics,
    NumberedStates,
    Numbers,
    Params,
    State,
    TabularDynamics,
    Words,
)
from hrljax.core.tracing_errors import explain_tracing

T = TypeVar("T")

_INTEGERS = (jnp.bool_, jnp.integer)
_NUMBERS = (*_INTEGERS, jnp.floating)
_SEQUENCES = (tuple, list, np.ndarray)
_MORE_WORDS = 16
"""How many words more than declared an error message looks for."""


def initial(env: Dynamics[State, Params], words: Words, params: Params) -> State:
    """The first state of an episode."""
    where = f"{env.name}: initial"
    return _state(where, _given_words(where, "num_initial_words", lambda drawn: env.initial(drawn, params), words))


def transition(
    env: Dynamics[State, Params], state: State, action: Array, words: Words, params: Params
) -> tuple[State, Array, Array, dict[str, Array]]:
    """Next state; reward (float32); terminated (bool); info: each event of `env.metrics`, and whatever else it has.

    An event is a bool; of an environment that is not tabular it may also be a float32.
    """
    where = f"{env.name}: transition"
    returned = _given_words(where, "num_words", lambda drawn: env.transition(state, action, drawn, params), words)
    if not isinstance(returned, tuple | list) or len(returned) != 4:
        got = f"{len(returned)} values" if isinstance(returned, tuple | list) else checks.type_in_words(returned)
        raise TypeError(f"{where} must return next state, reward, terminated and info, got {got}")
    after, reward, terminated, info = returned
    return (
        _state(where, after),
        _scalar(f"{where} must return a number as reward", reward, _NUMBERS, jnp.float32),
        _scalar(f"{where} must return a bool as terminated", terminated, (jnp.bool_,), jnp.bool_),
        _events(env, f"{where} must return", info),
    )


def encode(env: TabularDynamics[State, Params], state: State) -> Array:
    """The number of a state of a tabular environment, int32."""
    with explain_tracing(f"{env.name}: encode"):
        number = env.encode(state)
    return _scalar(f"{env.name}: encode must return an integer", number, _INTEGERS, jnp.int32)


def decode(env: NumberedStates[State], index: Array) -> State:
    """The state of a number."""
    with explain_tracing(f"{env.name}: decode"):
        state = env.decode(index)
    return _state(f"{env.name}: decode", state)


def word_cuts(env: TabularDynamics[State, Params], params: Params) -> Cuts:
    """The cuts of a tabular environment's words, one tuple for each word; `params` are not traced."""
    return _cuts(env, "word_cuts", "num_words", params)


def initial_word_cuts(env: TabularDynamics[State, Params], params: Params) -> Cuts:
    """The same for the words of `initial`."""
    return _cuts(env, "initial_word_cuts", "num_initial_words", params)


def _given_words(where: str, option: str, method: Callable[[Words], T], words: Words) -> T:
    """``method(words)``; an error that names `option` where it takes another number of words."""
    try:
        with explain_tracing(where):
            return method(words)
    except (IndexError, ValueError):
        declared = len(words)
        others = [*range(declared + 1, declared + _MORE_WORDS), *range(declared)]
        taken = next((count for count in others if _works(method, count)), None)
        if taken is None:
            raise
    raise ValueError(f"{where} takes {taken} random words, but {option} is {declared}")


def _works(method: Callable[[Words], object], count: int) -> bool:
    try:
        method((jnp.uint32(0),) * count)
    except Exception:  # of the environment's own code: any
        return False
    return True


def _state(where: str, state: State) -> State:
    def converted(path: tuple[Any, ...], leaf: object) -> Array:
        if isinstance(leaf, jax.Array) and not leaf.weak_type:
            return leaf
        field = jax.tree_util.keystr(path).lstrip(".")
        dtype = checks.dtype_of(leaf)
        if dtype is None:
            raise TypeError(
                f"{where} must return a state of numbers and arrays, got {checks.type_in_words(leaf)} as {field}"
            )
        narrow = jax.dtypes.canonicalize_dtype(dtype)  # what JAX has in place of a type of NumPy
        return _array(f"{where} must return a state of int32, float32 and bool", leaf, narrow, f" as {field}")

    return jax.tree_util.tree_map_with_path(converted, state)


def _events(env: AnyDynamics, where: str, info: object) -> dict[str, Array]:
    if not isinstance(info, Mapping):
        raise TypeError(f"{where} a mapping from names of events as info, got {checks.type_in_words(info)}")
    if missing := [name for name in env.metrics if name not in info]:
        has = ", ".join(map(repr, info)) or "no event"
        raise ValueError(f"{where} each event that metrics names in its info: {missing[0]!r} is missing, it has {has}")
    return {**info, **{name: _event(env, where, name, info[name]) for name in env.metrics}}


def _event(env: AnyDynamics, where: str, name: str, value: object) -> Array:
    if env.is_tabular or checks.dtype_of(value) == np.bool_:
        return _scalar(f"{where} a bool as event {name!r}", value, (jnp.bool_,), jnp.bool_)
    return _scalar(f"{where} a bool or a number as event {name!r}", value, _NUMBERS, jnp.float32)


def _scalar(rule: str, value: Any, kinds: tuple[Any, ...], dtype: Any) -> Array:
    """`value` as an array scalar of `dtype`; raises with `rule`, which says what it must be."""
    actual = checks.dtype_of(value)
    if actual is None or not any(jnp.issubdtype(actual, kind) for kind in kinds):
        raise TypeError(f"{rule}, got {checks.type_in_words(value)}")
    if np.shape(value):
        raise ValueError(f"{rule}, and only one, got {checks.type_in_words(value)}")
    return _array(rule, value, dtype)


def _array(rule: str, value: Any, dtype: Any, place: str = "") -> Array:
    """`value` as an array of exactly `dtype`."""
    if isinstance(value, jax.Array):
        return value if value.dtype == dtype and not value.weak_type else jnp.asarray(value, dtype)
    try:
        with np.errstate(over="ignore"):
            array = np.asarray(value).astype(dtype)
    except OverflowError:
        array = None
    if array is None or (jnp.issubdtype(dtype, jnp.integer) and not np.array_equal(array, value)):
        raise ValueError(f"{rule}, got {value!r}{place}, which {np.dtype(dtype).name} cannot hold")
    return jnp.asarray(array)


def _cuts(env: AnyTabularDynamics, method: str, option: str, params: Numbers) -> Cuts:
    where = f"{env.name}: {method}"
    with jax.ensure_compile_time_eval(), explain_tracing(where):
        cuts = getattr(env, method)(params)
        if not isinstance(cuts, _SEQUENCES) or not all(isinstance(of_word, _SEQUENCES) for of_word in cuts):
            raise TypeError(
                f"{where} must return a tuple that has a tuple of probabilities for each word, got {cuts!r}"
            )
        words = getattr(env, option)
        if len(cuts) != words:
            raise ValueError(f"{where} must return a tuple for each of the {words} words of {option}, got {len(cuts)}")
        for number, of_word in enumerate(cuts):
            for cut in map(float, of_word):
                if not cut >= 0:
                    raise ValueError(f"{where} must return probabilities, got {cut:g} for word {number}")
    return tuple(map(tuple, cuts))
