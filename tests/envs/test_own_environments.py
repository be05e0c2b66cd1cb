"""Mistakes in an environment of a user's own are errors before training is compiled, and name what is wrong."""

import re
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.core.random import below
from hrljax.envs import checks, outcomes
from hrljax.envs.base import concrete_params
from hrljax.envs.checks import check_before_training
from hrljax.sweeps import job
from tests.envs.corridor import LENGTH, Corridor, Numbers, State, Untabular, changed

TABLE = np.array([-1.0, 0.0, 0.0, 0.0])


def in_steps(**parts: Callable[..., Any]) -> dict[str, Any]:
    """A change of some of what `transition` returns, each as a function of the state and of that part."""

    def step(state: Any, action: Any, words: Any, params: Any, *returned: Any) -> tuple[Any, ...]:
        names = ("after", "reward", "terminated", "info")
        return tuple(parts.get(n, lambda s, part: part)(state, part) for n, part in zip(names, returned, strict=True))

    return {"step": step}


def reward(of: Callable[..., Any]) -> dict[str, Any]:
    return in_steps(reward=of)


def paying(of: Callable[..., Any]) -> Any:
    """A corridor with other rewards, by the state, the numbers, the usual reward and whether the episode ends."""
    return changed(step=lambda s, a, w, params, after, r, t, info: (after, of(s, params, r, t), t, info))


class NoTime(NamedTuple):
    cell: Any
    has_key: Any


def decides_in_python(self: Any, state: Any) -> Any:
    return state.cell + LENGTH if state.has_key == 1 else state.cell


def begins_in_python(self: Any, words: Any, params: Any) -> Any:
    if words[0] > 5:
        return Corridor().initial(words, params)
    return self.decode(jnp.int32(1))


def unpacks_two_words(self: Any, state: Any, action: Any, words: Any, params: Any) -> Any:
    first, _ = words
    return Corridor().transition(state, action, (first,), params)


def needs_word(number: int) -> Callable[..., Any]:
    def transition(self: Any, state: Any, action: Any, words: Any, params: Any) -> Any:
        return Corridor().transition(state, action, (words[number],), params)

    return transition


FAULTS: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "reward None": (reward(lambda s, r: None), TypeError, "transition must return a number as reward, got None"),
    "reward str": (reward(lambda s, r: "1"), TypeError, "transition must return a number as reward, got '1'"),
    "reward complex": (reward(lambda s, r: jnp.complex64(1j)), TypeError, "a number as reward, got complex64"),
    "reward list": (reward(lambda s, r: [r]), TypeError, "a number as reward, got a list"),
    "reward vector": (reward(lambda s, r: r[None]), ValueError, "and only one, got float32 of shape [1]"),
    "reward too large": (reward(lambda s, r: 10**400), ValueError, "which float32 cannot hold"),
    "reward nan": (
        reward(lambda s, r: jnp.where(s.cell == 2, jnp.nan, r)),
        ValueError,
        "transition must return a finite number as reward, got nan from state 2 by action 'left'",
    ),
    "reward infinite": (
        reward(lambda s, r: jnp.log(s.cell.astype(jnp.float32))),
        ValueError,
        "a finite number as reward, got -inf from state 4 by action 'left'",
    ),
    "reward python infinite": (
        reward(lambda s, r: 1e39),
        ValueError,
        "a finite number as reward, got inf from state 1 by action 'left'",
    ),
    "terminated int": (
        in_steps(terminated=lambda s, t: t.astype(jnp.int32)),
        TypeError,
        "transition must return a bool as terminated, got int32",
    ),
    "terminated number": (in_steps(terminated=lambda s, t: 0), TypeError, "a bool as terminated, got 0"),
    "terminated vector": (in_steps(terminated=lambda s, t: t[None]), ValueError, "got bool of shape [1]"),
    "event int": (
        in_steps(info=lambda s, i: {"key": i["key"].astype(jnp.int32)}),
        TypeError,
        "transition must return a bool as event 'key', got int32",
    ),
    "event None": (in_steps(info=lambda s, i: {"key": None}), TypeError, "a bool as event 'key', got None"),
    "event missing": (
        in_steps(info=lambda s, i: {"lock": i["key"]}),
        ValueError,
        "each event that metrics names in its info: 'key' is missing, it has 'lock'",
    ),
    "info None": (in_steps(info=lambda s, i: None), TypeError, "a mapping from names of events as info, got None"),
    "three values": (
        {"step": lambda *a: a[4:7]},
        TypeError,
        "transition must return next state, reward, terminated and info, got 3 values",
    ),
    "only a state": ({"step": lambda *a: a[4]}, TypeError, "reward, terminated and info, got 3 values"),
    "field of another type": (
        in_steps(after=lambda s, a: a._replace(cell=a.cell.astype(jnp.float32))),
        TypeError,
        "transition must return a state with int32 as cell, as initial does, got float32",
    ),
    "field of another shape": (
        in_steps(after=lambda s, a: a._replace(has_key=a.has_key[None])),
        TypeError,
        "a state with int32 as has_key, as initial does, got int32 of shape [1]",
    ),
    "field a str": (
        in_steps(after=lambda s, a: a._replace(cell="x")),
        TypeError,
        "transition must return a state of numbers and arrays, got 'x' as cell",
    ),
    "field too large": (
        in_steps(after=lambda s, a: a._replace(cell=np.int64(1) << 40)),
        ValueError,
        "as cell, which int32 cannot hold",
    ),
    "state of another kind": (
        in_steps(after=lambda s, a: NoTime(a.cell, a.has_key)),
        TypeError,
        "transition must return a State of cell, has_key, time, as initial does, got a NoTime of cell, has_key",
    ),
    "no time": (
        {"initial": lambda self, words, params: NoTime(jnp.int32(1), jnp.int32(0))},
        TypeError,
        "every state must have a field time (int32, steps taken), got None from initial",
    ),
    "decode of another type": (
        {"decode": lambda self, i: State(i % LENGTH, i >= LENGTH, 0)},
        TypeError,
        "decode must return a state with int32 as has_key, as initial does, got bool",
    ),
    "encode float": (
        {"encode": lambda self, s: (s.has_key * LENGTH + s.cell).astype(jnp.float32)},
        TypeError,
        "encode must return an integer, got float32",
    ),
    "encode too large": (
        {"encode": lambda self, s: s.has_key * 3 * LENGTH + s.cell},
        ValueError,
        "encode must return a number in 0..10, got 12 from state 1 by action 'left'",
    ),
    "encode negative": (
        {"encode": lambda self, s: s.has_key * LENGTH + s.cell - 2},
        ValueError,
        "encode must return a number in 0..10, got -1 for a state that initial returns",
    ),
    "encode of the end": (
        {"num_states": 2 * LENGTH - 1},
        ValueError,
        "encode must return a number in 0..6, got 7 from state 6 by action 'right'",
    ),
    "decode of another state": (
        {"decode": lambda self, i: State(jnp.minimum(i % LENGTH, 2), i // LENGTH, jnp.int32(0))},
        ValueError,
        "encode(decode(3)) must be 3, got 2",
    ),
    "word missing": ({"transition": needs_word(2)}, ValueError, "transition takes 3 random words, but num_words is 1"),
    "words to unpack": ({"transition": unpacks_two_words}, ValueError, "takes 2 random words, but num_words is 1"),
    "too many words to unpack": (
        {"transition": unpacks_two_words, "num_words": 3, "word_cuts": lambda self, p: ((), (), ())},
        ValueError,
        "takes 2 random words, but num_words is 3",
    ),
    "no first word": ({"num_initial_words": 0}, ValueError, "initial takes 1 random words, but num_initial_words is 0"),
    "num_words None": ({"num_words": None}, TypeError, "num_words must be an integer of at least 0, got None"),
    "cuts of another number of words": (
        {"num_words": 2},
        ValueError,
        "word_cuts must return a tuple for each of the 2 words of num_words, got 1",
    ),
    "cuts not in tuples": (
        {"word_cuts": lambda self, params: (0.25,)},
        TypeError,
        "word_cuts must return a tuple that has a tuple of probabilities for each word, got (0.25,)",
    ),
    "cut negative": (
        {"word_cuts": lambda self, params: ((-0.5,),)},
        ValueError,
        "word_cuts must return probabilities, got -0.5 for word 0",
    ),
    "cut missing": (
        {"word_cuts": lambda self, params: ((),)},
        ValueError,
        "word_cuts lacks a probability at which the meaning of a word changes: from state 1, action 'left' leads",
    ),
    "first cut missing": (
        {"initial_word_cuts": lambda self, params: ((),)},
        ValueError,
        "initial_word_cuts lacks a probability at which the meaning of a word changes: initial leads elsewhere",
    ),
    "if in transition": (
        reward(lambda s, r: 1.0 if s.cell == 2 else 0.0),
        TypeError,
        "transition decides in Python by an array whose value is not known while the program is compiled: "
        "use jnp.where in place of if, and &, | and ~ in place of and, or and not",
    ),
    "if in encode": ({"encode": decides_in_python}, TypeError, "encode decides in Python by an array"),
    "if in initial": ({"initial": begins_in_python}, TypeError, "initial decides in Python by an array"),
    "if in decode": (
        {"decode": lambda self, i: State(i, 0, 0) if i < LENGTH else State(i - LENGTH, 1, 0)},
        TypeError,
        "decode decides in Python by an array",
    ),
    "table of NumPy": (
        reward(lambda s, r: TABLE[s.cell]),
        TypeError,
        "use jax.numpy, such as jnp.asarray(table)[index] in place of table[index]",
    ),
    "metrics str": ({"metrics": "key"}, TypeError, "metrics must be a tuple of names, got 'key'"),
    "metrics reserved": ({"metrics": ("length",)}, ValueError, "metrics must be different names, none of return"),
    "actions str": ({"action_names": "left"}, TypeError, "action_names must be a tuple of names, got 'left'"),
    "no actions": ({"action_names": ()}, ValueError, "action_names must name at least one action"),
    "num_states float": ({"num_states": 8.0}, TypeError, "num_states must be an integer of at least 1, got 8.0"),
}


@pytest.fixture
def nothing_compiles(monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: Any) -> None:
        raise AssertionError("training was compiled")

    monkeypatch.setattr(job.Job, "compiled", refuse)
    monkeypatch.setattr(import_module("hrljax.engine.train"), "Trainer", refuse)


def ways_to_fail(env: Any) -> dict[str, Callable[[], Any]]:
    ways = {
        "sweep": lambda: hrl.sweep(env, hrl.QLearning(), seeds=1, num_episodes=2, progress=False),
        "train": lambda: hrl.train(env, hrl.QLearning(), jax.random.key(0), 2),
        "check": lambda: hrl.check(env),
    }
    return ways | ({"model": env.model} if env.is_tabular else {})


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.usefixtures("nothing_compiles")
def test_a_fault_is_named_by_whatever_uses_the_environment(fault: str):
    attributes, error, message = FAULTS[fault]
    env = changed(**attributes)
    for way, use in ways_to_fail(env).items():
        with pytest.raises(error, match=re.escape(message)) as raised:
            use()
        assert "Tracer" not in str(raised.value), way
        assert str(raised.value).startswith(("Corridor: ", "Changed: ")), way


UNTABULAR_FAULTS: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "reward nan": (
        reward(lambda s, r: jnp.where(s.has_key == 1, jnp.nan, r)),
        ValueError,
        r"a finite number as reward, got nan in step \d+ of an episode by action '",
    ),
    "event infinite": (
        in_steps(info=lambda s, i: {**i, "cell": jnp.float32(jnp.inf)}),
        ValueError,
        r"a finite number as event 'cell', got inf in step 1 of an episode by action",
    ),
    "event str": (
        in_steps(info=lambda s, i: {**i, "cell": "x"}),
        TypeError,
        "a bool or a number as event 'cell', got 'x'",
    ),
    "event missing": (in_steps(info=lambda s, i: {"key": i["key"]}), ValueError, "'cell' is missing, it has 'key'"),
    "reward None": (reward(lambda s, r: None), TypeError, "a number as reward, got None"),
    "field of another type": (
        in_steps(after=lambda s, a: a._replace(cell=a.cell.astype(jnp.float32))),
        TypeError,
        "a state with int32 as cell, as initial does, got float32",
    ),
}


@pytest.mark.parametrize("fault", UNTABULAR_FAULTS)
def test_a_fault_is_named_where_states_have_no_numbers(fault: str):
    attributes, error, message = UNTABULAR_FAULTS[fault]
    env = changed(Untabular, **attributes)
    for use in (lambda: check_before_training(env, concrete_params(env.default_params)), lambda: hrl.check(env)):
        with pytest.raises(error, match=f"^Corridor: transition must return .*{message}"):
            use()


@pytest.mark.usefixtures("nothing_compiles")
def test_every_value_of_a_swept_number_is_looked_at():
    """At the third value of two, the reward of a state that random steps seldom reach is infinite."""
    env = changed(
        step=lambda s, a, w, p, after, r, t, i: (after, jnp.where(t, 1 / (jnp.float32(p.key_reward) - 2), r), t, i)
    )
    options = {"seeds": 1, "num_episodes": 2, "progress": False}
    message = "transition must return a finite number as reward, got inf from state 6 by action 'right'"
    axes = {"env.key_reward": [0.0, 1.0, 2.0], "env.slip_probability": [0.0, 0.5]}
    with pytest.raises(ValueError, match=message):
        hrl.sweep(env, hrl.QLearning(), axes=axes, **options)
    with pytest.raises(ValueError, match=message):
        hrl.sweep(env, hrl.QLearning(), params=Numbers(key_reward=2.0), **options)
    with pytest.raises(AssertionError, match="training was compiled"):
        hrl.sweep(env, hrl.QLearning(), axes={"env.key_reward": [0.0, 1.0]}, **options)


@pytest.mark.usefixtures("nothing_compiles")
def test_an_if_on_a_swept_number_is_one_sentence():
    env = paying(lambda s, p, r, t: 1.0 if p.key_reward > 0.1 else 0.0)
    options = {"seeds": 1, "num_episodes": 2, "progress": False, "axes": {"env.key_reward": [0.0, 1.0]}}
    with pytest.raises(
        TypeError, match=r"^Corridor: transition decides .* use jnp\.where in place of if, and &"
    ) as raised:
        hrl.sweep(env, hrl.QLearning(), **options)
    assert "Tracer" not in str(raised.value)
    hrl.check(env)  # a number that is not swept is known


@pytest.mark.parametrize("fault", ["reward nan", "encode too large", "encode of the end", "decode of another state"])
@pytest.mark.usefixtures("nothing_compiles")
def test_an_environment_with_too_many_outcomes_is_acted_in_at_random(fault: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(outcomes, "_MOST_ENTRIES", 1)
    attributes, error, message = FAULTS[fault]
    with pytest.raises(error, match=re.escape(message.partition(" from ")[0].partition("(3)")[0])):
        hrl.sweep(changed(**attributes), hrl.QLearning(), seeds=1, num_episodes=2, progress=False)


def test_a_run_that_is_compiled_by_its_user_has_the_same_errors():
    attributes, error, message = FAULTS["reward nan"]
    env = changed(**attributes)
    for transform in (jax.jit, jax.vmap):
        key = jax.random.key(0) if transform is jax.jit else jax.random.split(jax.random.key(0), 2)
        with pytest.raises(error, match=re.escape(message)):
            transform(lambda key: hrl.train(env, hrl.QLearning(), key, 2))(key)


def test_what_is_right_is_looked_at_once(monkeypatch: pytest.MonkeyPatch):
    env, params = Corridor(spare=9), concrete_params(Numbers())
    nothing_swept, swept = [{}], [{"key_reward": 0.0}, {"key_reward": 1.0}]
    for points in (nothing_swept, swept):
        check_before_training(env, params, points)
    monkeypatch.setattr(jax, "eval_shape", None)
    monkeypatch.setattr(jax, "jit", None)
    for points in (nothing_swept, swept):
        check_before_training(Corridor(spare=9), params, points)


def test_numbers_that_belong_to_no_state_may_lead_anywhere():
    env = paying(lambda s, p, r, t: jnp.where(s.has_key > 1, jnp.nan, r))
    hrl.check(env)
    model = env.model()
    expected = Corridor().model()
    for ours, theirs in zip(model, expected, strict=True):
        np.testing.assert_array_equal(ours[: 2 * LENGTH], theirs[: 2 * LENGTH])
    assert model.terminated[2 * LENGTH :, :, 0].all()
    assert not model.reward[2 * LENGTH :].any()


@pytest.mark.slow
def test_python_numbers_and_numpy_arrays_are_what_they_mean():
    """Flags, fields, cuts and numbers of states; and infos may tell more than metrics names."""

    class Loose(Corridor):
        num_words = np.int64(1)
        action_names, metrics = ["left", "right"], ["key"]

        def initial(self, words: Any, params: Any) -> Any:
            return State(1 + below(words[0], 0.5), 0, 0)

        def decode(self, index: Any) -> Any:
            return super().decode(index)._replace(time=0)

        def transition(self, state: Any, action: Any, words: Any, params: Any) -> Any:
            after, reward, terminated, info = super().transition(state, action, words, params)
            return [after, reward, terminated, {**info, "note": 3}]

        def word_cuts(self, params: Any) -> Any:
            return [np.array([params.slip_probability, 1.5])]

    with jax.numpy_dtype_promotion("standard"):
        hrl.check(Loose())
        for ours, theirs in zip(Loose().model(), Corridor().model(), strict=True):
            np.testing.assert_array_equal(ours, theirs)

    endless = changed(**in_steps(terminated=lambda s, t: False, info=lambda s, i: {"key": np.bool_(True)}))
    run = hrl.train(endless, hrl.QLearning(), jax.random.key(0), 2)
    np.testing.assert_array_equal(run.metrics["key"], run.metrics["length"])


def test_rewards_may_depend_on_the_limit_of_steps():
    env = paying(lambda s, p, r, t: -1.0 / p.max_steps)
    run = hrl.train(env, hrl.QLearning(), jax.random.key(0), 2, params=Numbers(max_steps=8))
    np.testing.assert_array_equal(run.metrics["return"], run.metrics["length"] * np.float32(-0.125))


def test_few_of_many_combinations_of_swept_numbers_are_looked_at(monkeypatch: pytest.MonkeyPatch):
    looked_at: list[Any] = []
    monkeypatch.setattr(checks, "check_values", lambda env, points, sample: looked_at.extend(points))
    values = np.linspace(0, 1, 100).tolist()
    numbers = concrete_params(Numbers(max_steps=9))
    swept = [{"key_reward": reward, "slip_probability": slip} for reward in values for slip in values]
    check_before_training(Corridor(), numbers, swept)
    assert len(set(looked_at)) == len(looked_at) <= 16
    assert looked_at[0] == Numbers(0.0, 0.0, 9)
    assert looked_at[-1] == Numbers(1.0, 1.0, 9)
