"""Steps that are looked up equal the environment's own, bit for bit."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.core import random
from hrljax.core.counting import count
from hrljax.core.random import WORD_RANGE
from hrljax.engine.counters import BLOCK
from hrljax.engine.simulator import Simulator, simulator
from hrljax.engine.train import train
from hrljax.envs import outcomes
from hrljax.envs.base import concrete_params
from hrljax.envs.bus.env import Bus
from hrljax.envs.outcomes import WordKinds, outcome_table
from tests.maps import SMALL

ENVIRONMENTS: dict[str, Any] = {
    "Bus": SMALL,
    "Bus-all-at-once": Bus(SMALL.map, site="cell", slip="other", road_change="any", breakdown="after"),
    "Gridworld": hrljax.make("Gridworld", map="cliff"),
    "Maze": hrljax.make("Maze"),
    "Taxi": hrljax.make("Taxi", stochastic=True, fickle=True, rules="gymnasium"),
    "Taxi-dry": hrljax.make("Taxi"),
}


@pytest.fixture
def no_tables(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Makes every table too large from now on."""

    def refuse() -> None:
        monkeypatch.setattr(outcomes, "_MOST_ENTRIES", 0)
        monkeypatch.setattr(outcomes, "_cached_table", outcomes._table)

    return refuse


def steps(of: Simulator[Any], states: jax.Array, actions: jax.Array) -> Any:
    """What every position of one block leads to, from its state by its action, and the learner's words."""

    @jax.jit
    def run() -> Any:
        block = of.block(random.key_words(jax.random.key(3)), count(5))
        positions = jnp.arange(BLOCK, dtype=jnp.int32)
        step = jax.vmap(lambda s, a, i: (of.step(s, a, block, i), of.learner_words(block, i)))
        return step(states, actions, positions)

    return run()


@pytest.mark.slow
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_step_that_is_looked_up_is_the_step_that_is_computed(name: str, no_tables: Callable[[], None]):
    env = ENVIRONMENTS[name]
    numbers = {f: 0.4 for f in env.default_params._fields if f.endswith("_probability")}
    params = concrete_params(env.default_params._replace(**numbers))
    looked_up = simulator(env, params, 3)
    no_tables()
    computed = simulator(env, params, 3)
    assert type(looked_up) is not type(computed)
    rng = np.random.default_rng(0)
    for _ in range(20):
        states = jnp.asarray(rng.integers(env.num_states, size=BLOCK), jnp.int32)
        actions = jnp.asarray(rng.integers(env.num_actions, size=BLOCK), jnp.int32)
        actual, expected = (jax.tree.leaves(steps(of, states, actions)) for of in (looked_up, computed))
        for one, other in zip(actual, expected, strict=True):
            assert one.dtype == other.dtype
            np.testing.assert_array_equal(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("mapping", ["native", "vmap"])
def test_runs_do_not_depend_on_how_their_steps_are_found(mapping: Any, no_tables: Callable[[], None]):
    """A swept number of the environment is traced, so that its steps are computed."""
    options: Any = {"seeds": 3, "num_episodes": 30, "bin_size": 7, "mapping": mapping, "progress": False}
    learner = hrljax.QLearning(initial_value=-20.0)
    looked_up = hrljax.sweep(SMALL, learner, **options)
    axes = {"env.slip_probability": [SMALL.default_params.slip_probability]}
    computed = hrljax.sweep(SMALL, learner, axes=axes, **options).isel({"env.slip_probability": 0})
    for name in looked_up.data_vars:
        np.testing.assert_array_equal(looked_up[name], computed[name], err_msg=str(name))


def test_there_is_no_table_for_traced_numbers_many_outcomes_or_many_entries(monkeypatch: pytest.MonkeyPatch):
    params = concrete_params(SMALL.default_params)
    table = outcome_table(SMALL, params)
    assert table is not None
    assert outcome_table(Bus(SMALL.map), params) is table  # made once
    assert outcome_table(SMALL, params._replace(max_steps=7)) is not table  # on which steps may depend

    @jax.jit
    def traced(probability: jax.Array) -> jax.Array:
        assert outcome_table(SMALL, params._replace(slip_probability=probability)) is None
        return probability

    traced(jnp.float32(0.2))
    for limit in ("_MOST_CUTS", "_MOST_ENTRIES"):
        with monkeypatch.context() as patch:
            patch.setattr(outcomes, limit, 3)
            assert outcomes._table(SMALL, params) is None


def test_a_table_is_made_for_an_environment_that_has_no_hash():
    @dataclass(frozen=True)
    class Unhashable(Bus):
        notes: list[str] = field(default_factory=list)

    run = train(Unhashable(SMALL.map), hrljax.QLearning(), jax.random.key(0), 3)
    expected = train(SMALL, hrljax.QLearning(), jax.random.key(0), 3)
    np.testing.assert_array_equal(run.learned, expected.learned)


def test_words_that_differ_within_their_kind_are_an_error():
    """Else a run, which looks its steps up, would silently leave out what the kind's least words do not show."""

    class Forgetful(Bus):
        def word_cuts(self, params: Any) -> tuple[tuple[float, ...], ...]:
            slip, mishap, road = super().word_cuts(params)
            return slip[:-1], mishap, road

    env, message = Forgetful(SMALL.map), r"Bus: word_cuts lacks .* from state \d+, action 'north' .* words \[\d+, "
    with pytest.raises(ValueError, match=message):
        env.model()
    with pytest.raises(ValueError, match=message):
        train(env, hrljax.QLearning(), jax.random.key(0), 3)


def test_kinds_of_words_are_numbered_by_their_words():
    kinds = WordKinds(((0.25, 0.5, 0.25), (), (1.0, 0.0, 0.1)))
    assert kinds.count == 6
    for words in (kinds.first_words(), kinds.last_words()):
        np.testing.assert_array_equal(kinds.number(tuple(map(jnp.asarray, words))), np.arange(6))
    np.testing.assert_allclose(kinds.weights(), np.outer([0.25, 0.25, 0.5], [0.1, 0.9]).ravel(), rtol=1e-6)
    assert [int(words[0]) for words in kinds.first_words()] == [0, 0, 0]
    assert [int(words[-1]) for words in kinds.last_words()] == [WORD_RANGE - 1] * 3
