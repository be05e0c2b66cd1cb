"""A tabular environment against its exact model: what random words lead to, and how often."""

from collections import Counter
from collections.abc import Hashable, Mapping
from functools import partial
from typing import Any, Literal, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core import contract
from hrljax.core.environment import EpisodeState, Numbers, State, Words
from hrljax.envs.base import AnyTabularEnvironment, TabularEnvironment
from hrljax.envs.occurring import Outcomes, reached
from hrljax.envs.outcomes import WordKinds, enumerate_outcomes, few_outcomes, first_numbers, flagged_step
from hrljax.solvers.model import Model

T = TypeVar("T", bound=Hashable)
Outcome: TypeAlias = tuple[int | Literal["any"], float, bool]
"""Next state ("any" where the episode ends), reward, and whether it ends."""

_LATER = 7
"""Steps by which a state is made older."""
_TRIED_STEPS, _TRIED_BEGINNINGS = 1 << 14, 1 << 14
_PAIRS, _STEPS_OF_PAIR = 16, 10_000


def check_words(env: AnyTabularEnvironment, params: Numbers) -> None:
    """Raises unless steps with random words are those of the model, whatever the time, and `decode` inverts `encode`.

    An environment with too many outcomes to enumerate is not checked.
    """
    if not few_outcomes(env, params):
        return
    generator = np.random.default_rng(0)
    _check_beginnings(env, params, generator)
    kinds, outcomes, occurs = enumerate_outcomes(env, params)
    states = generator.choice(np.flatnonzero(occurs).astype(np.int32), _TRIED_STEPS)
    actions = generator.integers(env.num_actions, size=_TRIED_STEPS, dtype=np.int32)
    kind, words = _words(generator, kinds, _TRIED_STEPS)
    looked_at = jax.jit(jax.vmap(partial(_look_at, env, params)))(states, actions, words)
    number, reward, flags, is_inverse, is_timeless = map(np.asarray, looked_at)
    expected = Outcomes(*(field[states, actions, kind] for field in outcomes))
    is_expected = (number == expected.next_state) & (flags == expected.flags)
    is_expected &= np.isclose(reward, expected.reward, rtol=1e-5, atol=1e-6)
    if (is_timeless & is_inverse & is_expected).all():
        return
    row = int(np.argmin(is_timeless & is_inverse & is_expected))
    step = f"a step from state {states[row]} by action {env.action_names[actions[row]]!r} leads"
    drawn = _row(words, row)
    if not is_timeless[row]:
        raise ValueError(
            f"{env.name}: encode and transition must not depend on time (which is 0 in training and in the model) but "
            f"for counting it: {step} elsewhere when time is {_LATER}"
        )
    if not is_inverse[row]:
        before = contract.decode(env, jnp.int32(states[row]))
        after, *_ = contract.transition(env, before, jnp.int32(actions[row]), tuple(map(jnp.uint32, drawn)), params)
        decoded = contract.decode(env, jnp.int32(number[row]))
        raise ValueError(
            f"{env.name}: decode(encode(state)) must be the state, but for its time: {step} to {_text(after)}, "
            f"whose number {number[row]} decodes to {_text(decoded)}"
        )
    raise ValueError(
        f"{env.name}: word_cuts lacks a probability at which the meaning of a word changes: {step} elsewhere with the "
        f"words {drawn} than with {_row(kinds.first_words(), kind[row])}"
    )


def _check_beginnings(env: AnyTabularEnvironment, params: Numbers, generator: np.random.Generator) -> None:
    """Raises unless random words of `initial` lead where those of their kind lead."""
    kinds = WordKinds(contract.initial_word_cuts(env, params))
    firsts = first_numbers(env, params, kinds)
    kind, words = _words(generator, kinds, _TRIED_BEGINNINGS)

    def begin(words: Words) -> Array:
        return contract.encode(env, contract.initial(env, words, params))

    begins = np.asarray(jax.jit(jax.vmap(begin, axis_size=_TRIED_BEGINNINGS))(words))
    if len(wrong := np.flatnonzero(begins != firsts[kind])):
        row = int(wrong[0])
        raise ValueError(
            f"{env.name}: initial_word_cuts lacks a probability at which the meaning of a word changes: initial leads "
            f"elsewhere with the words {_row(words, row)} than with {_row(kinds.first_words(), kind[row])}"
        )


def check_model(env: AnyTabularEnvironment, params: Numbers) -> None:
    """Raises unless `reset` and `step` happen as often as `initial_distribution` and `model` say."""
    if type(env).model is TabularEnvironment.model and not few_outcomes(env, params):
        return
    model, starts = env.model(params), env.initial_distribution(params)
    _check_distribution(env, "model", model.probability, (env.num_states, env.num_actions))
    _check_distribution(env, "initial_distribution", starts, ())
    keys = jax.random.split(jax.random.key(1), _TRIED_BEGINNINGS)
    begin = jax.jit(jax.vmap(lambda key: contract.encode(env, env.reset(key, params)[1])))
    begins = dict(Counter(np.asarray(begin(keys)).tolist()))
    _check_frequencies(f"{env.name}: initial_distribution", "state", begins, dict(enumerate(starts.tolist())))

    @jax.jit
    @partial(jax.vmap, in_axes=(0, None, None))
    def step(key: Array, number: Array, action: Array) -> tuple[Array, ...]:
        _, after, reward, terminated, *_ = env.step(key, contract.decode(env, number), action, params)
        return contract.encode(env, after), reward, terminated

    keys = jax.random.split(jax.random.key(2), _STEPS_OF_PAIR)
    for state, action in _pairs_to_try(env, model, starts):
        seen = Counter(map(_outcome, *(part.tolist() for part in map(np.asarray, step(keys, state, action)))))
        expected: Counter[Outcome] = Counter()
        fields = (model.next_state, model.reward.astype(np.float32), model.terminated, model.probability)
        for *outcome, probability in zip(*(field[state, action].tolist() for field in fields), strict=True):
            expected[_outcome(*outcome)] += probability
        where = f"{env.name}: model, from state {state} by action {env.action_names[action]!r}"
        _check_frequencies(where, "next state, reward and end", seen, expected)


def _outcome(next_state: int, reward: float, terminated: bool) -> Outcome:
    """An outcome as it is counted: rewards rounded to five digits, and no next state where the episode ends."""
    return ("any" if terminated else next_state), float(f"{reward:.5g}"), terminated


def _check_distribution(
    env: AnyTabularEnvironment, method: str, probability: np.ndarray, shape: tuple[int, ...]
) -> None:
    if probability.shape[:-1] != shape or not (
        probability.min() >= 0 and np.allclose(probability.sum(-1), 1, atol=1e-6)
    ):
        raise ValueError(f"{env.name}: {method} must give probabilities that are not negative and sum to one")


def _check_frequencies(where: str, what: str, seen: Mapping[T, int], expected: Mapping[T, float]) -> None:
    """Raises if an outcome happened so often or so seldom that chance cannot explain it."""
    count = sum(seen.values())
    for outcome in {**expected, **seen}:
        times, probability = seen.get(outcome, 0), min(expected.get(outcome, 0.0), 1.0)
        allowed = 6 * np.sqrt(count * probability * (1 - probability)) + 6 * (probability > 0)
        if abs(times - count * probability) > allowed:
            happened = f"it happened {times} times in {count}"
            raise ValueError(f"{where}, gives {what} {outcome} the probability {probability:.4g}; {happened}")


def _pairs_to_try(env: AnyTabularEnvironment, model: Model, starts: np.ndarray) -> list[tuple[int, int]]:
    """Some states that occur, each with an action: those with many outcomes, and with few."""
    possible = model.probability > 0
    flags = np.where(possible, model.terminated, True).astype(np.int32)
    outcomes = Outcomes(np.where(possible, model.next_state, 0), model.reward, flags)
    occurs = reached(env, outcomes, np.flatnonzero(starts > 0))[0]
    counts = (possible.sum(-1) * occurs[:, None]).ravel()
    ordered = np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)]
    chosen = ordered[np.unique(np.linspace(0, len(ordered) - 1, _PAIRS).astype(int))]
    return [divmod(pair, env.num_actions) for pair in chosen.tolist()]


def _words(generator: np.random.Generator, kinds: WordKinds, count: int) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Random kinds ``[count]``, and words of them: the least, the greatest or any between."""
    kind = generator.integers(kinds.count, size=count)
    words = []
    for first, last in zip(kinds.first_words(), kinds.last_words(), strict=True):
        between = generator.integers(first[kind], last[kind], endpoint=True, dtype=np.uint32)
        words.append(np.choose(generator.integers(3, size=count), (first[kind], last[kind], between)))
    return kind, tuple(words)


def _look_at(
    env: AnyTabularEnvironment, params: Numbers, number: Array, action: Array, words: Words
) -> tuple[Array, ...]:
    """A step: next state, reward, flags; whether `decode` gives the next state back; whether time plays no part."""
    before = contract.decode(env, number)
    older = _older(before)
    after, reward, flags = flagged_step(env, params, before, action, words)
    late, late_reward, late_flags = flagged_step(env, params, older, action, words)
    next_number = contract.encode(env, after)
    same = [contract.encode(env, older) == contract.encode(env, before), late.time == after.time + np.int32(_LATER)]
    same += [_alike(late, after), after.time == before.time + 1, reward == late_reward, flags == late_flags]
    return next_number, reward, flags, _alike(after, contract.decode(env, next_number)), jnp.stack(same).all()


def _is_time(path: tuple[Any, ...]) -> bool:
    return jax.tree_util.keystr(path) in (".time", "['time']")


def _older(state: State) -> State:
    return jax.tree_util.tree_map_with_path(lambda path, leaf: leaf + _LATER if _is_time(path) else leaf, state)


def _alike(one: EpisodeState, other: EpisodeState) -> Array:
    """Whether two states are the same but for their time."""
    leaves = zip(jax.tree_util.tree_flatten_with_path(one)[0], jax.tree.leaves(other), strict=True)
    return jnp.stack([jnp.bool_(True), *((a == b).all() for (path, a), b in leaves if not _is_time(path))]).all()


def _text(state: EpisodeState) -> str:
    return repr(jax.tree.map(lambda leaf: np.asarray(leaf).tolist(), state))


def _row(words: tuple[np.ndarray, ...], row: int) -> list[int]:
    return [int(word[row]) for word in words]
