"""Gymnasium's tables as environments: the same values, the same chances, and something to learn in."""

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces

import hrljax as hrl
from hrljax.core import random
from hrljax.envs.base import TabularEnvironment
from hrljax.envs.grid.maze import Maze
from hrljax.envs.table import Table, TableEnvironment
from hrljax.interop.gymnasium import SingleEnv, from_table
from hrljax.solvers import Model, value_iteration

TABLES = {
    "lake": ("FrozenLake-v1", {}),
    "large lake": ("FrozenLake-v1", {"map_name": "8x8", "is_slippery": False}),
    "cliff": ("CliffWalking-v1", {}),
    "slippery cliff": ("CliffWalking-v1", {"is_slippery": True}),
    "taxi": ("Taxi-v4", {}),
    "rainy taxi": ("Taxi-v4", {"is_rainy": True}),
}
TABLES = {name: table for name, table in TABLES.items() if table[0] in gymnasium.registry}
each_table = pytest.mark.parametrize("name", TABLES)
with_cliff = pytest.mark.skipif("cliff" not in TABLES, reason="this Gymnasium is too old for CliffWalking-v1")


def source(name: str):
    env_id, options = TABLES[name]
    return gymnasium.make(env_id, **options)


def plain_value_iteration(table, discount: float, sweeps: int) -> np.ndarray:
    """``[S]``: in plain Python, on Gymnasium's table itself."""
    value = [0.0] * len(table)
    for _ in range(sweeps):
        value = [
            max(sum(p * (r + discount * value[s] * (not end)) for p, s, r, end in row) for row in actions.values())
            for actions in table.values()
        ]
    return np.array(value)


@each_table
def test_optimal_values_are_those_of_the_table(name: str):
    env = source(name)
    ours = from_table(env)
    expected = plain_value_iteration(env.unwrapped.P, 0.95, 150)
    np.testing.assert_allclose(value_iteration(ours.model(), 0.95).value, expected, rtol=1e-4, atol=1e-4)


@each_table
def test_the_model_has_every_outcome_of_the_table_and_no_other(name: str):
    env = source(name)
    model = from_table(env).model()
    for state, actions in env.unwrapped.P.items():
        for action, row in actions.items():
            expected: dict[tuple, float] = {}
            for probability, after, reward, ends in row:
                outcome = (int(after), float(reward), bool(ends))
                expected[outcome] = expected.get(outcome, 0.0) + probability
            here = (state, action)
            found = zip(*(f[here].tolist() for f in (model.next_state, model.reward, model.terminated)), strict=True)
            likely = {o: p for o, p in zip(found, model.probability[here].tolist(), strict=True) if p > 0}
            assert likely == pytest.approx({o: p for o, p in expected.items() if p > 0})


@pytest.mark.parametrize("name", [name for name in ("lake", "slippery cliff", "rainy taxi") if name in TABLES])
def test_what_is_simulated_is_the_table_to_the_last_bit_of_a_word(name: str):
    """The model that follows from `transition` on every kind of word."""
    env = from_table(source(name))
    simulated, exact = TabularEnvironment.model(env), env.model()
    size = env.num_states

    def dense(model: Model) -> np.ndarray:
        rows = np.zeros((size, env.num_actions, 2 * size))
        column = model.next_state + size * model.terminated
        where = np.indices(column.shape)
        np.add.at(rows, (where[0], where[1], column), model.probability)
        return rows

    np.testing.assert_allclose(dense(simulated), dense(exact), rtol=0, atol=2 * 2.0**-random.WORD_BITS)
    rewards = [(model.probability * model.reward).sum(-1) for model in (simulated, exact)]
    np.testing.assert_allclose(*rewards, atol=1e-5)
    starts = TabularEnvironment.initial_distribution(env), env.initial_distribution()
    np.testing.assert_allclose(*starts, rtol=0, atol=2 * 2.0**-random.WORD_BITS)


def test_q_learning_learns_the_frozen_lake():
    env = from_table("FrozenLake-v1")
    assert (env.name, env.default_params.max_steps) == ("FrozenLake-v1", 100)
    learner = hrl.QLearning(step_size=0.1, epsilon=0.2, discount=0.99, initial_value=1.0)
    run = jax.jit(lambda key: hrl.train(env, learner, key, 6000, evaluate_every=100, bin_size=30))(jax.random.key(0))
    assert float(run.greedy_return[-1]) > 0.7  # 0.7402 with the policy that is optimal without a limit
    assert float(run.metrics["return"][0]) < 0.1


@with_cliff
def test_a_table_under_gymnasium_again_is_the_table():
    env = SingleEnv(from_table("CliffWalking-v1"))
    original = gymnasium.make("CliffWalking-v1")
    actions = [0, *[1] * 11, 2]
    for each in (env, original):
        each.reset(seed=0)
    for action in actions:
        mine, its = env.step(action), original.step(action)
        assert mine[:4] == (its[0], float(its[1]), its[2], its[3])
    assert mine[2]


def test_equal_tables_are_equal_environments():
    lake, other = from_table("FrozenLake-v1"), from_table("FrozenLake-v1")
    assert lake == other
    assert hash(lake) == hash(other)
    assert lake != from_table(source("large lake"))
    assert lake != from_table("FrozenLake-v1", max_steps=5)
    assert "16 states, 4 actions" in str(lake.table)


@with_cliff
def test_the_limit_of_steps_and_the_beginning_may_be_given():
    initial = np.zeros(48)
    initial[[3, 40]] = 0.25, 0.75
    env = from_table("CliffWalking-v1", initial=initial, max_steps=7)
    assert env.default_params.max_steps == 7
    starts = np.asarray(jax.vmap(lambda key: env.reset(key)[0])(jax.random.split(jax.random.key(0), 2000)))
    assert set(starts.tolist()) == {3, 40}
    assert np.mean(starts == 40) == pytest.approx(0.75, abs=0.04)
    assert from_table("CliffWalking-v1").default_params.max_steps == 1000


class Shifted(gymnasium.Env):
    observation_space = spaces.Discrete(2, start=1)
    action_space = spaces.Discrete(1)


class Bare(gymnasium.Env):
    observation_space = spaces.Discrete(2)
    action_space = spaces.Discrete(1)


class Tiny(Bare):
    def __init__(self, table: dict):
        self.P = table


GOOD = {0: {0: [(0.5, 1, 1.0, False), (0.5, 0, 0.0, False)]}, 1: {0: [(1.0, 0, 2.0, True)]}}


def test_rows_of_different_lengths_by_hand():
    env = from_table(Tiny(GOOD), initial=[1.0, 0.0])
    outcome = jax.jit(lambda state, word: env.transition(env.decode(state), jnp.int32(0), (word,), env.default_params))
    half = 1 << 23
    cases = {(0, half - 1): (0, 0.0, False), (0, half): (1, 1.0, False), (1, 2 * half - 1): (0, 2.0, True)}
    for (state, word), expected in cases.items():
        after, reward, ends, _ = outcome(jnp.int32(state), jnp.uint32(word))
        assert (int(after.number), float(reward), bool(ends), int(after.time)) == (*expected, 1)


def test_bad_tables_are_refused():
    with pytest.raises(TypeError, match="observation_space of Shifted must be Discrete and start at 0"):
        from_table(Shifted())
    with pytest.raises(TypeError, match="Bare has none"):
        from_table(Bare())
    with pytest.raises(TypeError, match="initial must be given"):
        from_table(Tiny(GOOD))
    with pytest.raises(ValueError, match="P of Tiny must have all 2 states and 1 actions"):
        from_table(Tiny({0: GOOD[0]}), initial=[1, 0])
    with pytest.raises(ValueError, match="must have an outcome for every state and action"):
        from_table(Tiny({**GOOD, 1: {0: []}}), initial=[1, 0])
    with pytest.raises(ValueError, match="probability must have rows that are not negative and sum to one"):
        from_table(Tiny({**GOOD, 1: {0: [(0.5, 0, 0.0, True)]}}), initial=[1, 0])
    with pytest.raises(ValueError, match="next states must be from 0 to 1"):
        from_table(Tiny({**GOOD, 1: {0: [(1.0, 2, 0.0, True)]}}), initial=[1, 0])
    with pytest.raises(ValueError, match="rewards must be finite"):
        from_table(Tiny({**GOOD, 1: {0: [(1.0, 0, np.inf, True)]}}), initial=[1, 0])
    with pytest.raises(ValueError, match=r"initial must be probabilities of shape \(2,\), got shape \(3,\)"):
        from_table(Tiny(GOOD), initial=[1, 0, 0])
    with pytest.raises(ValueError, match="initial must have no negative entry and sum to one, got a sum of 2"):
        from_table(Tiny(GOOD), initial=[1, 1])
    with pytest.raises(ValueError, match="max_steps must be an integer from 1 to 2147483647, got 0"):
        from_table(Tiny(GOOD), initial=[1, 0], max_steps=0)
    with pytest.raises(TypeError, match=r"max_steps must be an integer from 1 to 2147483647, got 2\.5"):
        from_table(Tiny(GOOD), initial=[1, 0], max_steps=2.5)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"env must be a Gymnasium environment or its id, got Maze\(\)"):
        from_table(Maze())  # type: ignore[arg-type]
    model = from_table(Tiny(GOOD), initial=[1, 0]).model()
    with pytest.raises(ValueError, match="one shape"):
        Table(model._replace(reward=model.reward[..., :1]), np.array([1.0, 0.0]))
    with pytest.raises(TypeError, match=r"model must be a hrljax.solvers.Model such as env.model\(\), got 5"):
        Table(5, np.array([1.0, 0.0]))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="next_state must be integers, got float64"):
        Table(model._replace(next_state=model.next_state + 0.5), np.array([1.0, 0.0]))
    with pytest.raises(TypeError, match="action_names must be a sequence of names, got 'a'"):
        TableEnvironment(Table(model, np.array([1.0, 0.0])), action_names="a")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="action_names must have 1 names"):
        TableEnvironment(Table(model, np.array([1.0, 0.0])), action_names=("a", "b"))


def test_actions_have_the_names_that_gymnasium_gives_them():
    assert from_table("FrozenLake-v1").action_names == ("left", "down", "right", "up")
    assert from_table("FrozenLake-v1", action_names="wsen").action_names == ("w", "s", "e", "n")
    with pytest.raises(ValueError, match="action_names must have 4 names"):
        from_table("FrozenLake-v1", action_names=["left"])


@with_cliff
def test_constants_of_an_environment_are_names_in_the_order_of_its_actions():
    assert from_table("CliffWalking-v1").action_names == ("up", "right", "down", "left")
    assert from_table(TABLES["taxi"][0]).action_names == tuple("012345")  # Gymnasium's Taxi names none


@pytest.mark.parametrize(
    ("attributes", "shape"),
    [
        ({"shape": (2, 3)}, (2, 3)),
        ({"nrow": 3, "ncol": 2}, (3, 2)),
        ({"shape": (1, 2, 3)}, None),
        ({"shape": (3, 3)}, None),
        ({"shape": None}, None),
        ({"nrow": 6}, None),
        ({}, None),
    ],
)
def test_states_are_cells_where_rows_and_columns_are_told(attributes: dict[str, object], shape: object):
    class Source(gymnasium.Env[int, int]):
        observation_space, action_space = spaces.Discrete(6), spaces.Discrete(1)
        P = {state: {0: [(1.0, 5, 0.0, True)]} for state in range(6)}
        initial_state_distrib = np.eye(6)[0]

    source = Source()
    for name, value in attributes.items():
        setattr(source, name, value)
    assert from_table(source).shape == shape
