"""Exact solvers: against each other, against values by hand, and on the Bus against figures found elsewhere."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.envs.bus.env import Bus, BusParams
from hrljax.envs.bus.map import KAO_V1
from hrljax.envs.grid.maze import Maze
from hrljax.solvers import dynamic_programming as dp
from hrljax.solvers.model import Model

WALLED = KAO_V1.replace("A", "|").replace(" B ", "---")

# Compiled once for each shape of model; called eagerly, the solvers compile anew on every call.
value_iteration = jax.jit(dp.value_iteration)
policy_iteration = jax.jit(dp.policy_iteration)
policy_evaluation = jax.jit(dp.policy_evaluation)


def from_start(env: Bus, value: jax.Array) -> np.ndarray:
    """Values at the start for each status of the road."""
    return np.asarray(value)[env.initial_distribution() > 0]


def mean(env: Bus, value: jax.Array) -> float:
    return float(env.initial_distribution() @ np.asarray(value, np.float64))


def near(figure: Any) -> Any:
    return pytest.approx(figure, abs=0.01)


# The Bus


def test_the_optimum_of_the_bus(bus: Bus, bus_model: Model):
    value = value_iteration(bus_model).value
    assert from_start(bus, value).tolist() == near([-22.14, -24.08, -27.53])
    assert mean(bus, value) == near(-24.59)


def test_a_bus_blind_to_sites_pays_for_it(bus: Bus, bus_model: Model):
    blind = value_iteration(bus.model(BusParams(damage_probability=0.0)))
    assert mean(bus, blind.value) == near(-19.90)
    value = policy_evaluation(bus_model, blind.policy)
    assert from_start(bus, value).tolist() == near([-34.46, -54.45, -52.04])
    assert mean(bus, value) == near(-46.99)


def test_a_bus_without_sites():
    free = Bus(map=KAO_V1.replace("A", " ").replace("B", " "))
    assert free.num_states == 576
    assert mean(free, value_iteration(free.model()).value) == near(-19.90)


def test_a_bus_with_walls_for_sites():
    walled = Bus(map=WALLED)
    assert mean(walled, value_iteration(walled.model()).value) == near(-35.75)


def test_never_driving_into_a_site_is_worse_than_walls_because_slips_cross_it(bus: Bus, bus_model: Model):
    cells = np.asarray(jax.vmap(bus.decode)(jnp.arange(bus.num_states, dtype=jnp.int32)).cell)
    crosses = bus.layout.site[cells] > 0
    discouraged = bus_model._replace(reward=np.where(crosses[:, :, None], -1000.0, bus_model.reward))
    policy = np.asarray(value_iteration(discouraged).policy)
    assert not crosses[np.arange(bus.num_states), policy].any()
    assert mean(bus, policy_evaluation(bus_model, policy)) == near(-36.31)


def test_the_best_epsilon_soft_policy_of_the_bus(bus: Bus, bus_model: Model):
    value = value_iteration(bus_model, epsilon=0.1).value
    assert from_start(bus, value).tolist() == near([-25.09, -27.55, -30.62])
    assert mean(bus, value) == near(-27.75)


@pytest.mark.parametrize(
    ("env", "params", "figure"),
    [
        pytest.param(Bus(road_change="any"), BusParams(), -24.60, id="redraw"),
        pytest.param(Bus(site="cell"), BusParams(), -24.93, id="site-is-a-cell"),
        pytest.param(Bus(), BusParams(slip_probability=0.0), -21.83, id="no-slips"),
        pytest.param(Bus(), BusParams(road_change_probability=0.0), -24.75, id="static-roads"),
        pytest.param(Bus(), BusParams(breakdown_probability=0.5), -24.64, id="breakdown-half"),
    ],
)
def test_variants_of_the_bus(env: Bus, params: BusParams, figure: float):
    assert mean(env, value_iteration(env.model(params)).value) == near(figure)


def test_a_bus_blind_to_sites_that_are_cells():
    env = Bus(site="cell")
    blind = value_iteration(env.model(BusParams(damage_probability=0.0)))
    assert mean(env, policy_evaluation(env.model(), blind.policy)) == near(-47.44)


def test_crossing_a_closed_site_costs_more_than_five_and_less_than_sixty(bus: Bus, bus_model: Model):
    """Which is why a pseudo-reward of 5 is harmless in this domain and one of 60 is not."""
    west_of_a, road_a = 14, 1
    q = np.asarray(value_iteration(bus_model).q)[west_of_a << 6 | road_a]
    assert q.tolist() == pytest.approx([-22.7, -52.2, -25.5, -25.5], abs=0.05)
    assert 5 < q.max() - q[1] < 60


# Solvers against each other


def random_model(seed: int, num_states: int = 5, num_actions: int = 3, ending: float = 0.0) -> Model:
    """A dense model; every action ends the episode with at least the probability `ending`."""
    generator = np.random.default_rng(seed)
    transition = generator.dirichlet(np.full(num_states, 0.5), (num_states, num_actions)) * (1 - ending)
    return Model.from_dense(transition, generator.normal(size=transition.shape))


@given(seed=st.integers(0, 2**32 - 1), episodic=st.booleans())
@settings(deadline=None, max_examples=40)
def test_all_solvers_agree(seed: int, episodic: bool):
    model, discount = (random_model(seed, ending=0.2), 1.0) if episodic else (random_model(seed), 0.8)
    with jax.enable_x64(True):
        by_values = value_iteration(model, discount, tolerance=1e-12)
        by_policies = policy_iteration(model, discount)
        evaluated = policy_evaluation(model, by_policies.policy, discount, tolerance=1e-12)
        one_hot = np.eye(model.num_actions)[np.asarray(by_values.policy)]
        evaluated_weights = policy_evaluation(model, one_hot, discount, tolerance=1e-12)
        assert by_values.q.dtype == jnp.float64
        for value in (by_policies.value, evaluated, evaluated_weights, by_values.q.max(-1)):
            np.testing.assert_allclose(value, by_values.value, atol=1e-9)
        np.testing.assert_allclose(by_policies.q, by_values.q, atol=1e-9)
        matrix, reward = dp.transition_matrix(model, jnp.asarray(one_hot))
        solved = np.linalg.solve(np.eye(model.num_states) - discount * np.asarray(matrix), np.asarray(reward))
        np.testing.assert_allclose(solved, by_values.value, atol=1e-9)


@given(seed=st.integers(0, 2**32 - 1), epsilon=st.sampled_from([0.0, 0.1, 0.5, 1.0]))
@settings(deadline=None, max_examples=20)
def test_the_soft_optimum_is_the_value_of_its_own_soft_policy(seed: int, epsilon: float):
    model = random_model(seed, ending=0.2)
    with jax.enable_x64(True):
        solution = value_iteration(model, 1.0, epsilon, 1e-12)
        greedy = np.eye(model.num_actions)[np.asarray(solution.policy)]
        soft = (1 - epsilon) * greedy + epsilon / model.num_actions
        evaluated = policy_evaluation(model, soft, tolerance=1e-12)
        np.testing.assert_allclose(evaluated, solution.value, atol=1e-9)


def test_solvers_map_over_models():
    models = [random_model(seed) for seed in range(3)]
    stacked = Model(*map(np.stack, zip(*models, strict=True)))
    mapped = jax.jit(jax.vmap(lambda model, discount: dp.value_iteration(model, discount)))(
        stacked, jnp.array([0.5, 0.9, 0.9])
    )
    for i, discount in enumerate((0.5, 0.9, 0.9)):
        np.testing.assert_allclose(mapped.value[i], value_iteration(models[i], discount).value, rtol=1e-5)


# Values by hand


def two_states() -> Model:
    """State 0 tries (action 0) to reach state 1, with luck 1/2; there, action 0 ends for 10, action 1 goes back."""
    transition = np.zeros((2, 2, 2))
    transition[0, 0] = 0.5, 0.5
    transition[0, 1] = 1, 0
    transition[1, 1] = 1, 0
    return Model.from_dense(transition, np.array([[-1.0, -3.0], [10.0, 0.0]]))


def test_two_states_without_discount():
    """V(1) = 10; V(0) = -1 + V(0) / 2 + V(1) / 2 = 8."""
    for solve in (value_iteration, policy_iteration):
        solution = solve(two_states())
        np.testing.assert_allclose(solution.value, [8, 10], atol=1e-4)
        np.testing.assert_allclose(solution.q, [[8, 5], [10, 8]], atol=1e-4)
        np.testing.assert_array_equal(solution.policy, [0, 0])


def test_two_states_with_discount():
    """With discount 1/2, V(0) = -1 + V(0) / 4 + 10 / 4 = 2."""
    for solve in (value_iteration, policy_iteration):
        solution = solve(two_states(), 0.5)
        np.testing.assert_allclose(solution.value, [2, 10], atol=1e-4)
        np.testing.assert_allclose(solution.q, [[2, -2], [10, 1]], atol=1e-4)


def test_the_value_of_a_random_policy_by_hand():
    """V(0) = -2 + 3/4 V(0) + 1/4 V(1) and V(1) = 5 + V(0) / 2: V(0) = -6, V(1) = 2."""
    value = policy_evaluation(two_states(), np.full((2, 2), 0.5))
    np.testing.assert_allclose(value, [-6, 2], atol=1e-4)


def test_ties_go_to_the_first_action():
    model = Model.from_dense(np.zeros((1, 3, 1)), np.array([[1.0, 2.0, 2.0]]))
    assert value_iteration(model).policy == policy_iteration(model).policy == 1


def test_a_horizon_cuts_off_a_policy_that_never_ends():
    forever = np.array([1, 0])  # stays in state 0 for -3 a step
    assert policy_evaluation(two_states(), forever, 1.0, 50).tolist() == [-150, 10]
    assert policy_evaluation(two_states(), forever, 0.5).tolist() == pytest.approx([-6, 10], abs=1e-4)


def test_sweeps_are_limited():
    solution = value_iteration(two_states(), max_sweeps=3)
    assert solution.sweeps == 3
    assert value_iteration(two_states(), tolerance=100.0).sweeps == 1


# Models


def test_a_dense_model_ends_where_its_rows_lack_probability():
    model = Model.from_dense(np.array([[[0.25, 0.5], [0, 1]], [[0, 0], [0.1, 0.9]]]), np.ones((2, 2)))
    assert (model.num_states, model.num_actions) == (2, 2)
    np.testing.assert_allclose((model.probability * model.terminated).sum(-1), [[0.25, 0], [1, 0]], atol=1e-12)
    np.testing.assert_array_equal(model.successors(), [[[0, 1, -1], [-1, 1, -1]], [[-1, -1, -1], [0, 1, -1]]])


@pytest.mark.parametrize(
    ("transition", "reward", "message"),
    [
        (
            np.ones((2, 2)),
            np.ones((2, 2)),
            r"transition must be probabilities of shape \(any, any, any\), got shape \(2, 2\)",
        ),
        (np.zeros((2, 1, 3)), np.ones((2, 1)), r"transition must have shape \[S, A, S\], got \(2, 1, 3\)"),
        (np.zeros((2, 1, 2)), np.ones(2), r"reward must have shape \[S, A\] or \[S, A, S\].*got \(2,\)"),
        (np.full((2, 1, 2), 0.6), np.ones((2, 1)), "rows that sum to at most one"),
        (np.array([[[-0.1, 0.5]], [[0, 1]]]), np.ones((2, 1)), "non-negative rows"),
        (np.zeros((2, 1, 2)), np.full((2, 1), np.nan), "reward must be finite"),
    ],
)
def test_bad_dense_models_are_refused(transition: np.ndarray, reward: np.ndarray, message: str):
    with pytest.raises(ValueError, match=message):
        Model.from_dense(transition, reward)


TWO_STATES = Model.from_dense(np.array([[[0.25, 0.5], [0, 1]], [[0, 0], [0.1, 0.9]]]), np.ones((2, 2)))


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: dp.value_iteration(TWO_STATES, 2), ValueError, r"discount must be a finite number in \[0, 1\], got 2"),
        (lambda: dp.value_iteration(TWO_STATES, "1"), TypeError, "discount must be a number, got '1'"),
        (lambda: dp.value_iteration(TWO_STATES, np.ones(2)), TypeError, "discount must be a number, got array"),
        (
            lambda: dp.value_iteration(TWO_STATES, tolerance=-1),
            ValueError,
            r"tolerance must be .*\[0, 3.4e\+38\], got -1",
        ),
        (lambda: dp.value_iteration(TWO_STATES, epsilon=np.nan), ValueError, r"epsilon must be .*\[0, 1\], got nan"),
        (
            lambda: dp.value_iteration(TWO_STATES, max_sweeps=0),
            ValueError,
            "max_sweeps must be an integer from 1 to .*got 0",
        ),
        (lambda: dp.value_iteration(Maze()), TypeError, r"model must be a hrljax.solvers.Model such as .*got Maze\(\)"),
        (lambda: dp.policy_iteration(TWO_STATES, -0.5), ValueError, r"discount must be .*\[0, 1\], got -0.5"),
        (
            lambda: dp.policy_iteration(TWO_STATES, max_improvements=1.5),
            TypeError,
            "max_improvements must be .*got 1.5",
        ),
        (
            lambda: dp.policy_evaluation(TWO_STATES, [0, 9]),
            ValueError,
            "policy must have actions from 0 to 1, got 0 to 9",
        ),
        (
            lambda: dp.policy_evaluation(TWO_STATES, [0, -1]),
            ValueError,
            "policy must have actions from 0 to 1, got -1 to 0",
        ),
        (
            lambda: dp.policy_evaluation(TWO_STATES, [0.0, 1.0]),
            TypeError,
            r"policy must be integers of shape \(2,\), got",
        ),
        (
            lambda: dp.policy_evaluation(TWO_STATES, [0]),
            ValueError,
            r"actions of shape \(2,\) or .* \(2, 2\), got shape \(1,",
        ),
        (
            lambda: dp.policy_evaluation(TWO_STATES, np.ones((2, 2))),
            ValueError,
            "policy must have rows of probabilities that",
        ),
        (
            lambda: dp.policy_evaluation(TWO_STATES, [0, 0], horizon=2**31),
            ValueError,
            "horizon must be .*got 2147483648",
        ),
        (
            lambda: dp.action_values(TWO_STATES, np.zeros(3)),
            ValueError,
            r"value must be numbers of shape \(2,\), got shape",
        ),
    ],
)
def test_bad_arguments_of_solvers_are_refused(call: Callable[[], object], error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"next_state": TWO_STATES.next_state + 1}, ValueError, "next states must be from 0 to 1"),
        ({"next_state": TWO_STATES.next_state * 1.0}, TypeError, "next_state must be integers, got float64"),
        ({"terminated": TWO_STATES.terminated * 1}, TypeError, "terminated must be bools, got int64"),
        ({"probability": TWO_STATES.probability * 2}, ValueError, "probability must have rows that .*sum to one"),
        ({"reward": TWO_STATES.reward * np.nan}, ValueError, "rewards must be finite"),
        ({"reward": np.zeros(3)}, ValueError, r"the arrays of a model must have one shape \[S, A, K\], got"),
    ],
)
def test_bad_models_are_refused(change: dict[str, np.ndarray], error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        dp.value_iteration(TWO_STATES._replace(**change))


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=30)
def test_merging_outcomes_changes_no_backup_and_leaves_them_distinct(seed: int):
    generator = np.random.default_rng(seed)
    shape = 3, 2, 6
    follows, ends = generator.integers(0, 3, shape), generator.random(shape) < 0.3
    reward, weight = generator.integers(-1, 1, shape).astype(float), generator.dirichlet(np.ones(6), shape[:2])
    model = Model.merged(follows, reward, ends, weight)
    value = generator.normal(size=3)
    expected = (weight * (reward + np.where(ends, 0, value[follows]))).sum(-1)
    backup = (model.probability * (model.reward + np.where(model.terminated, 0, value[model.next_state]))).sum(-1)
    np.testing.assert_allclose(backup, expected, atol=1e-12)
    kinds = np.stack([model.next_state, model.reward, model.terminated], -1)
    for pair in np.ndindex(shape[:2]):
        used = kinds[pair][model.probability[pair] > 0]
        assert len(np.unique(used, axis=0)) == len(used)


def test_a_model_says_how_large_it_is():
    assert repr(Maze().model()) == "Model(42 states, 3 actions, 1 outcomes of each at most)"
