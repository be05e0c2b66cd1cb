"""Of equally good choices: the first, or any of them."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.core import choices
from hrljax.core.random import threshold
from tests.contexts import learning
from tests.maps import SMALL

OPTIONS: dict[str, Any] = {"seeds": 2, "num_episodes": 4, "bin_size": 2, "progress": False}
LEARNERS = {
    "Q-learning": hrl.QLearning,
    "SARSA": hrl.SARSA,
    "SARSA(lambda)": hrl.SARSALambda,
    "Q(lambda)": hrl.QLambda,
    "Dyna-Q": hrl.DynaQ,
    "R-MAX": hrl.RMax,
    "linear Dyna": lambda **options: hrl.LinearDyna(hrl.variable_features(SMALL), **options),
    "options": lambda **options: hrl.OptionQ(hrl.primitive_options(SMALL), **options),
    "HORDQ": lambda **options: hrl.HORDQ(SMALL.hierarchy(), **options),
    "shared HORDQ": lambda **options: hrl.SharedHORDQ(SMALL.hierarchy(), **options),
    "MAXQ": lambda **options: hrl.MAXQ(SMALL.hierarchy(), **options),
    "HAMQ": lambda **options: hrl.HAMQ(SMALL.hierarchy(), **options),
}


def test_each_of_those_that_tie_is_as_likely_and_no_other():
    values = [jnp.float32(value) for value in (1, 3, -2, 3, 3)]
    first = choices.greedy(values)[0]
    words = np.arange(300, dtype=np.uint32)
    random = jax.vmap(lambda word: choices.greedy_by("random", values, first, word))(words)
    assert dict(zip(*np.unique(random, return_counts=True), strict=True)) == {1: 100, 3: 100, 4: 100}
    assert int(choices.greedy_by("first", values, first, jnp.uint32(2))) == 1


@pytest.mark.parametrize("epsilon", [0.0, 0.5])
def test_the_first_action_of_an_episode_without_knowledge_is_any(epsilon: float):
    """Words from the threshold on do not explore."""
    words = np.arange(2**24 - 400, 2**24, dtype=np.uint32)
    assert words[0] >= int(threshold(np.float32(epsilon)))

    def action(learner: Any) -> Any:
        tables = learner.init(SMALL, 4).tables
        return jax.vmap(lambda word: learner.begin(4, tables, jnp.int32(0), (word,), learning()))(words)

    assert np.unique(action(hrl.QLearning(epsilon=epsilon, ties="random")), return_counts=True)[1].tolist() == [100] * 4
    assert np.unique(action(hrl.QLearning(epsilon=epsilon))).tolist() == [0]


@pytest.mark.parametrize(
    "name", [name if name == "Q-learning" else pytest.param(name, marks=pytest.mark.slow) for name in LEARNERS]
)
def test_every_learner_may_break_ties_at_random_under_every_mapping(name: str):
    """Without exploration: the first action is always the same one if the first of equally good ones is taken."""
    first, random = (LEARNERS[name](epsilon=0.0, ties=ties) for ties in ("first", "random"))
    params = SMALL.default_params._replace(max_steps=30, slip_probability=0.0)
    runs = {learner.ties: hrl.sweep(SMALL, learner, params=params, **OPTIONS) for learner in (first, random)}
    assert not runs["first"]["return"].equals(runs["random"]["return"])
    vmapped = hrl.sweep(SMALL, random, params=params, mapping="vmap", **OPTIONS)
    for variable in vmapped:
        np.testing.assert_array_equal(vmapped[variable], runs["random"][variable])


def test_a_store_from_before_there_was_a_choice_goes_on(tmp_path: Path):
    """The default is no setting: what a store or a file says of itself is what it said before."""
    assert "ties" not in hrl.QLearning().settings()
    assert hrl.QLearning(ties="random").settings()["ties"] == "random"
    hrl.sweep(SMALL, hrl.QLearning(), store=tmp_path / "store", **OPTIONS)
    assert hrl.sweep(SMALL, hrl.QLearning(ties="first"), store=tmp_path / "store", **OPTIONS).complete == 1
    with pytest.raises(ValueError, match=r"learner\.ties is 'absent' there and 'random' here"):
        hrl.sweep(SMALL, hrl.QLearning(ties="random"), store=tmp_path / "store", **OPTIONS)


def test_a_file_of_what_was_learned_keeps_the_choice(tmp_path: Path):
    learner = hrl.QLearning(ties="random")
    curves = hrl.sweep(hrl.make("Bus"), learner, keep_learned=True, **{**OPTIONS, "num_episodes": 1})
    hrl.Learned.of(curves, hrl.make("Bus"), learner).save(tmp_path / "learned.npz")
    loaded = hrl.Learned.load(tmp_path / "learned.npz").learner
    assert isinstance(loaded, hrl.QLearning)
    assert loaded.ties == "random"


def test_other_choices_are_refused():
    for make in (*LEARNERS.values(), hrl.FeudalQ):
        with pytest.raises(ValueError, match="ties must be one of 'first', 'random', got 'last'"):
            make(ties="last")
