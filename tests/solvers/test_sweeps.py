"""Sweeps: in place against a plain program and against all states at once; policy iteration of large models."""

import re
from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.engine import compiler
from hrljax.envs.grid.gridworld import GridParams, Gridworld
from hrljax.solvers import Model, policy_iteration, sweeps, value_iteration
from hrljax.solvers import dynamic_programming as dp


def random_model(seed: int, num_states: int = 6, num_actions: int = 3, ending: float = 0.0) -> Model:
    generator = np.random.default_rng(seed)
    transition = generator.dirichlet(np.full(num_states, 0.3), (num_states, num_actions)) * (1 - ending)
    return Model.from_dense(transition, generator.normal(size=transition.shape))


@pytest.fixture
def all_at_once(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Solvers as they are where loops are not native."""
    jax.clear_caches()
    monkeypatch.setattr(sweeps, "loops_are_native", lambda: False)
    yield
    monkeypatch.undo()
    jax.clear_caches()


def plain_sweep(model: Model, value: list[float], discount: float, epsilon: float, backwards: bool) -> None:
    states = range(model.num_states)
    for state in reversed(states) if backwards else states:
        q = []
        for action in range(model.num_actions):
            outcomes = zip(*(array[state, action].tolist() for array in model), strict=True)
            q.append(sum(p * (r + (0.0 if end else discount * value[after])) for after, p, r, end in outcomes))
        value[state] = (1 - epsilon) * max(q) + epsilon * sum(q) / len(q)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 5), epsilon=st.sampled_from([0.0, 0.3]))
@settings(deadline=None, max_examples=20)
def test_sweeps_in_place_are_those_of_a_plain_program(seed: int, count: int, epsilon: float):
    model, discount = random_model(seed, ending=0.1), 0.9
    expected = np.random.default_rng(seed).normal(size=model.num_states).tolist()
    with jax.enable_x64(True):
        start = jnp.array(expected)
        value, swept = sweeps.settled(sweeps.Backup.of(model, discount), start, epsilon, 0.0, count)
    for number in range(count):
        plain_sweep(model, expected, discount, epsilon, backwards=number % 2 == 1)
    assert swept == count
    np.testing.assert_allclose(value, expected, atol=1e-12)


def test_the_package_tells_the_solvers_whether_loops_are_native():
    assert compiler.native_loops_available()
    assert sweeps.loops_are_native() == (jax.default_backend() == "cpu")


@pytest.mark.parametrize("discount", [0.9, 1.0])
@pytest.mark.parametrize("epsilon", [0.0, 0.2])
def test_elsewhere_all_states_at_once_have_the_same_values(
    all_at_once: None, monkeypatch: pytest.MonkeyPatch, discount: float, epsilon: float
):
    model = random_model(3, ending=0.1)
    with jax.enable_x64(True):
        at_once = value_iteration(model, discount, epsilon, 1e-12)
        backup = sweeps.Backup.of(model, discount)
        monkeypatch.setattr(sweeps, "loops_are_native", lambda: True)
        in_place, count = sweeps.settled(backup, jnp.zeros(model.num_states), epsilon, 1e-12, 10_000)
        assert count < at_once.sweeps
        np.testing.assert_allclose(at_once.value, in_place, atol=1e-9)


def test_a_corridor_takes_one_sweep_from_below():
    """Twenty states whose one way leads to the last: backwards, one sweep knows them all, and one more that it does."""
    size, discount = 20, 0.5
    transition = np.zeros((size, 2, size))
    transition[range(size), 0, [0, *range(size - 1)]] = 1
    transition[range(size - 1), 1, range(1, size)] = 1
    model = Model.from_dense(transition, np.full((size, 2), -1.0))
    solution = value_iteration(model, discount, tolerance=0.0)
    assert solution.sweeps == 3  # forwards: nothing but the last state; backwards: all; forwards: nothing more
    np.testing.assert_allclose(solution.value, [-(2 - 2.0 ** (1 - size + i)) for i in range(size)], rtol=1e-6)


@given(seed=st.integers(0, 2**32 - 1), discount=st.sampled_from([0.0, 0.5, 0.99]))
@settings(deadline=None, max_examples=20)
def test_no_policy_is_worse_than_the_least_value(seed: int, discount: float):
    model = random_model(seed, ending=0.05)
    policy = np.random.default_rng(seed).integers(0, model.num_actions, model.num_states)
    with jax.enable_x64(True):
        least = sweeps.Backup.of(model, discount).least_value(discount)
        assert (dp.policy_evaluation(model, policy, discount, tolerance=1e-12) >= least - 1e-9).all()
        assert sweeps.Backup.of(model, 1.0).least_value(1.0) == 0


@pytest.mark.slow
@pytest.mark.parametrize("discount", [0.5, 0.99, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_policies_evaluated_by_sweeps_lead_to_the_same_optimum(seed: int, discount: float):
    model = random_model(seed, num_states=30, ending=0.05)
    by_sweeps = jax.jit(partial(dp._policy_iteration_by_sweeps, max_improvements=100))
    with jax.enable_x64(True):
        expected, actual = policy_iteration(model, discount), by_sweeps(model, discount)
    np.testing.assert_array_equal(actual.policy, expected.policy)
    np.testing.assert_allclose(actual.value, expected.value, atol=1e-9)
    np.testing.assert_allclose(actual.q, expected.q, atol=1e-9)


def test_large_models_need_no_square_of_their_states(monkeypatch: pytest.MonkeyPatch):
    def refused(*arguments: Any) -> Any:
        raise AssertionError("a linear system")

    monkeypatch.setattr(dp, "_policy_iteration_by_systems", refused)
    size = 60
    rows = ["." * size for _ in range(size)]
    rows[1], rows[-2] = ".S" + "." * (size - 2), "." * (size - 2) + "G."
    env = Gridworld(map="\n".join(rows))
    assert env.num_states > dp.MOST_SOLVED_STATES
    model = env.model(GridParams(slip_probability=0.0))
    solution = policy_iteration(model)
    start = int(np.flatnonzero(env.initial_distribution())[0])
    assert solution.value[start] == -2 * (size - 3)
    np.testing.assert_allclose(solution.value, value_iteration(model).value, atol=1e-4)


def test_a_sweep_in_place_is_one_native_loop_that_copies_no_table():
    """Else a sweep takes time that grows with the square of the states."""
    size = 5003
    backup = sweeps.Backup(jnp.zeros((size, 2)), jnp.full((size, 2, 2), 0.25), jnp.zeros((size, 2, 2), jnp.uint32))
    text = jax.jit(sweeps._in_place).lower(backup, jnp.zeros(size), 0.0, jnp.int32(0)).compile().as_text() or ""
    assert "xla_cpu_small_call" in text
    in_loops = [line for line in text.splitlines() if re.search(rf"f32\[{size}\]\S* copy\(", line)]
    assert len(in_loops) <= 1, in_loops  # of what is given, before the loop
