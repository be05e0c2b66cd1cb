"""`hrl.check` passes what is right, and finds what training cannot see."""

import re
import sys
import types
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.core.random import below
from hrljax.envs import outcomes
from hrljax.envs.base import TabularEnvironment
from tests.envs.corridor import LENGTH, Corridor, Numbers, State, Untabular, changed

GENERATOR = np.random.default_rng(0)


def after(of: Callable[..., Any]) -> dict[str, Any]:
    """A change of the next state, by the state, the words and the usual next state."""
    return {"step": lambda state, a, words, p, after, *rest: (of(state, words, after), *rest)}


def odd_first(self: Any, words: Any, params: Any) -> Any:
    return State(1 + (words[0] & 1).astype(jnp.int32), jnp.int32(0), jnp.int32(0))


def tilted(model: Any) -> Any:
    """A model that says nothing of slips."""
    return model._replace(
        probability=(model.probability == model.probability.max(-1, keepdims=True)).astype(np.float64)
    )


FAULTS: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "time stands still": (
        after(lambda s, w, a: a._replace(time=s.time)),
        ValueError,
        "transition must return a state of time 1, got 0",
    ),
    "time begins late": (
        {"initial": lambda self, w, p: State(below(w[0], 0.5).astype(jnp.int32), jnp.int32(0), jnp.int32(3))},
        ValueError,
        "initial must return a state of time 0, got 3",
    ),
    "ends by time": (
        {"step": lambda s, a, w, p, after, r, t, i: (after, r, t | (after.time >= 5), i)},
        ValueError,
        "encode and transition must not depend on time (which is 0 in training and in the model) but for counting it: "
        "a step from state",
    ),
    "number by time": (
        {"encode": lambda self, s: s.has_key * LENGTH + s.cell + jnp.where(s.time > 6, 1, 0)},
        ValueError,
        "encode and transition must not depend on time",
    ),
    "key is forgotten": (
        {"encode": lambda self, s: s.cell},
        ValueError,
        "decode(encode(state)) must be the state, but for its time: a step from state 0 by action 'left' leads to "
        "State(cell=0, has_key=1, time=1), whose number 0 decodes to State(cell=0, has_key=0, time=0)",
    ),
    "odd words": (
        after(lambda s, w, a: a._replace(cell=jnp.where((w[0] & 6) == 2, s.cell, a.cell))),
        ValueError,
        "word_cuts lacks a probability at which the meaning of a word changes: a step from state",
    ),
    "odd first words": (
        {"initial": odd_first, "initial_word_cuts": lambda self, p: ((2**-24, 1 - 2**-24),)},
        ValueError,
        "initial_word_cuts lacks a probability at which the meaning of a word changes: initial leads elsewhere",
    ),
    "random of NumPy": (
        {"step": lambda s, a, w, p, after, r, *rest: (after, r + GENERATOR.random(dtype=np.float32), *rest)},
        ValueError,
        "step must depend on nothing but its arguments: with the same ones, part [2] of what it returned was",
    ),
    "model of its own": (
        {"model": lambda self, params=None: tilted(Corridor().model(params))},
        ValueError,
        "model, from state",
    ),
    "model without sum": (
        {"model": lambda self, params=None: Corridor().model(params)._replace(probability=np.ones((11, 2, 2)))},
        ValueError,
        "model must give probabilities that are not negative and sum to one",
    ),
    "start of its own": (
        {"initial_distribution": lambda self, params=None: np.eye(11)[1]},
        ValueError,
        "initial_distribution, gives state 1 the probability 1; it happened",
    ),
    "renderer missing": (
        {"renderer": "no_such_module"},
        ValueError,
        "renderer must be a module with functions text(env, state) and rgb_array(env, state), got 'no_such_module'",
    ),
    "text of numbers": ({"renderer": "tests_drawing"}, TypeError, "render must return a str for 'ansi', got 3"),
    "picture of floats": (
        {"renderer": "tests_drawing", "render_modes": ("rgb_array",)},
        TypeError,
        "render must return uint8 of shape [H, W, 3] for 'rgb_array', got float64 of shape [2, 2, 3]",
    ),
    "no space": (
        {"observation_space": 11},
        TypeError,
        "observation_space must be a space of Gymnasium, got 11",
    ),
    "params without limit": (
        {"default_params": {"slip_probability": 0.25}},
        TypeError,
        "default_params must be a NamedTuple with a field max_steps, got {'slip_probability': 0.25}",
    ),
}


@pytest.fixture(autouse=True)
def drawing(monkeypatch: pytest.MonkeyPatch):
    module: Any = types.ModuleType("tests_drawing")
    module.text, module.rgb_array = lambda env, state: 3, lambda env, state: np.zeros((2, 2, 3))
    monkeypatch.setitem(sys.modules, "tests_drawing", module)


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_what_training_cannot_see_is_found(fault: str):
    attributes, error, message = FAULTS[fault]
    with pytest.raises(error, match=re.escape(f"Corridor: {message}")):
        hrl.check(changed(**attributes))


OBSERVED = {
    "outside": lambda self, state: jnp.stack([state.cell - 5, state.has_key]),
    "of another type": lambda self, state: jnp.stack([state.cell, state.has_key]).astype(jnp.float32) + 0.5,
    "of another shape": lambda self, state: state.cell,
    "of another kind": lambda self, state: {"cell": state.cell},
}


@pytest.mark.parametrize("observed", OBSERVED)
def test_an_observation_outside_of_its_space_is_found(observed: str):
    env = changed(Untabular, observation=OBSERVED[observed])
    with pytest.raises(ValueError, match="observation must return an element of Box"):
        hrl.check(env)


def test_what_is_right_passes():
    assert hrl.check(Corridor()) is None
    assert hrl.check(Untabular(), Numbers(slip_probability=0.5)) is None


def test_other_arguments_are_refused():
    with pytest.raises(TypeError, match=r"env must be an environment such as hrljax\.make"):
        hrl.check(gymnasium.make("CartPole-v1"))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"env\.slip_probability must be a finite number in \[0, 1\]"):
        hrl.check(Corridor(), Numbers(slip_probability=2.0))
    with pytest.raises(TypeError, match=r"params must be a Numbers, the numbers of .*, got \{'max_steps': 5\}"):
        hrl.check(Corridor(), {"max_steps": 5})


def test_an_environment_without_a_hash_cannot_be_swept():
    @dataclass(frozen=True)
    class Listed(Corridor):
        cells: list[int] = field(default_factory=list)

    with pytest.raises(TypeError, match=r"must have a hash, to be swept; make it a dataclass\(frozen=True\)"):
        hrl.check(Listed())


def test_an_environment_with_many_outcomes_is_checked_without_its_model(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(outcomes, "_MOST_ENTRIES", 1)
    monkeypatch.setattr(TabularEnvironment, "model", lambda self, params=None: 1 / 0)
    hrl.check(Corridor(spare=4))
