"""What is checked of an environment before anything is compiled for it."""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from hrljax.core import checks, contract
from hrljax.core.environment import AnyDynamics, EpisodeState, Numbers, Words, is_tabular
from hrljax.envs.once import once_per_environment
from hrljax.envs.outcomes import check_computed_outcomes, few_outcomes, outcome_table
from hrljax.envs.sampled import check_sampled_steps

_MOST_POINTS = 16
"""Combinations of swept numbers that are looked at."""
RESERVED = ("return", "length", "truncated", "steps", "greedy_return", "learned", "seed", "episode", "checkpoint")
"""Names of results that no event may have."""


def check_before_training(
    env: AnyDynamics, params: Numbers, swept: Sequence[Mapping[str, float]] = ({},), sample: bool = True
) -> None:
    """Raises for an environment of a user's own that cannot be trained in, or only with senseless results.

    Environments of the library are skipped: its tests check them, and some take long to trace.

    Args:
        env: the environment.
        params: its numbers, as from `concrete_params`; traced ones have no value to look at.
        swept: values by the names of numbers that differ from run to run, of every combination that is swept.
        sample: whether to try random episodes where outcomes are too many to look at each.

    Raises:
        TypeError, ValueError: as `hrljax.check`.
    """
    if type(env).__module__.partition(".")[0] == "hrljax":
        return
    check_types(env, params._replace(**{name: jax.ShapeDtypeStruct((), jnp.float32) for name in swept[0]}))
    if any(isinstance(number, Tracer) for number in params):
        return
    chosen = np.unique(np.linspace(0, len(swept) - 1, min(len(swept), _MOST_POINTS)).astype(int))
    points = ({name: np.float32(value) for name, value in swept[index].items()} for index in chosen)
    check_values(env, tuple(params._replace(**point) for point in points), sample)


@once_per_environment(64)
def check_values(env: AnyDynamics, points: tuple[Numbers, ...], sample: bool) -> None:
    """Raises for a state, a reward or an event that makes no sense, under any of several `params`.

    Looks at every outcome where they are few, else at random episodes (if `sample`).
    """
    if is_tabular(env):
        if len(points) == 1 and outcome_table(env, points[0]) is not None:
            return
        if all(few_outcomes(env, point) for point in points):
            check_computed_outcomes(env, points)
            return
    if sample:
        check_sampled_steps(env, points)


def check_declarations(env: AnyDynamics) -> None:
    """Raises unless the attributes of an environment are what `hrljax.envs.base` says."""
    owner = type(env).__name__
    if not isinstance(name := getattr(env, "name", None), str):
        raise TypeError(f"{owner}: name must be a str, got {name!r}")
    for option in ("action_names", "metrics"):
        names = getattr(env, option, None)
        if not isinstance(names, tuple | list) or not all(isinstance(name, str) for name in names):
            raise TypeError(f"{owner}: {option} must be a tuple of names, got {names!r}")
    if not env.action_names:
        raise ValueError(f"{owner}: action_names must name at least one action, got {env.action_names!r}")
    for name in env.metrics:
        if name in RESERVED or list(env.metrics).count(name) > 1:
            raise ValueError(f"{owner}: metrics must be different names, none of {', '.join(RESERVED)}; got {name!r}")
    for option, least in (
        ("num_words", 0),
        ("num_initial_words", 0),
        *([("num_states", 1)] if is_tabular(env) else []),
    ):
        count = getattr(env, option, None)
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < least:
            raise TypeError(f"{owner}: {option} must be an integer of at least {least}, got {count!r}")


def check_types(env: AnyDynamics, params: Numbers) -> None:
    """Raises unless an environment's methods run compiled and return what `hrljax.envs.base` says.

    Args:
        env: the environment.
        params: its numbers; traced ones and `jax.ShapeDtypeStruct`s have a type only.
    """
    unknown = {n: jax.ShapeDtypeStruct(v.shape, v.dtype) for n, v in params._asdict().items() if _is_unknown(v)}
    _check_types(env, params._replace(**unknown))


def _is_unknown(value: object) -> bool:
    return isinstance(value, Tracer | jax.ShapeDtypeStruct)


@once_per_environment(64)
def _check_types(env: AnyDynamics, params: Numbers) -> None:
    check_declarations(env)
    word, number = jax.ShapeDtypeStruct((), jnp.uint32), jax.ShapeDtypeStruct((), jnp.int32)

    def use(unknown: dict[str, Array], words: Words, initial_words: Words, action: Array, index: Array) -> None:
        numbers = params._replace(**unknown)
        first = contract.initial(env, initial_words, numbers)
        _check_time(env, first)
        if is_tabular(env):
            before = contract.decode(env, index)
            _check_alike(f"{env.name}: decode", first, before)
        else:
            before = first
        after, *_ = contract.transition(env, before, action, words, numbers)
        _check_alike(f"{env.name}: transition", first, after)
        if is_tabular(env):
            contract.encode(env, after)

    unknown = {name: value for name, value in params._asdict().items() if _is_unknown(value)}
    jax.eval_shape(use, unknown, (word,) * env.num_words, (word,) * env.num_initial_words, number, number)


def _check_time(env: AnyDynamics, state: EpisodeState) -> None:
    time = getattr(state, "time", None)
    if not isinstance(time, jax.Array) or time.shape or time.dtype != jnp.int32:
        got = checks.type_in_words(time)
        raise TypeError(f"{env.name}: every state must have a field time (int32, steps taken), got {got} from initial")


def _check_alike(where: str, first: EpisodeState, other: EpisodeState) -> None:
    """Raises unless two states have the same fields of the same types."""
    if jax.tree.structure(first) != jax.tree.structure(other):
        raise TypeError(f"{where} must return {_fields(first)}, as initial does, got {_fields(other)}")
    leaves = jax.tree_util.tree_flatten_with_path(first)[0]
    for (path, expected), got in zip(leaves, jax.tree.leaves(other), strict=True):
        if (expected.shape, expected.dtype) != (got.shape, got.dtype):
            field = jax.tree_util.keystr(path).lstrip(".")
            raise TypeError(
                f"{where} must return a state with {checks.type_in_words(expected)} as {field}, as initial does, "
                f"got {checks.type_in_words(got)}"
            )


def _fields(state: EpisodeState) -> str:
    paths = [jax.tree_util.keystr(path).lstrip(".") for path, _ in jax.tree_util.tree_flatten_with_path(state)[0]]
    return f"a {type(state).__name__} of {', '.join(paths) or 'nothing'}"
