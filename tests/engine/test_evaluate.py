"""Exact values of greedy policies: against the optimum, against NumPy, and at the right moment of a run."""

from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.engine.evaluate import greedy_return
from hrljax.envs.bus.env import Bus, BusParams
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.base import outside_of_training
from hrljax.learners.child_values import Known
from hrljax.solvers.dynamic_programming import value_iteration
from hrljax.solvers.model import Model
from tests.maps import SMALL

ZERO = np.uint32(0)
SHORT = BusParams(max_steps=60)


@pytest.fixture(scope="module")
def optimal_q(bus_model: Model) -> jax.Array:
    return value_iteration(bus_model).q.ravel()


def test_the_optimal_table_earns_the_optimum(bus: Bus, optimal_q: jax.Array):
    value = greedy_return(hrljax.QLearning(), bus, 4, optimal_q, bus.default_params, ZERO, 0)
    assert value.dtype == jnp.float32
    assert float(value) == pytest.approx(-24.586, abs=0.01)


def test_an_episode_is_cut_off_at_the_limit_of_steps(bus: Bus, optimal_q: jax.Array):
    """The shortest tour takes 18 steps; without damage nothing ends an episode before."""
    params = BusParams(max_steps=17, damage_probability=0.0)
    assert float(greedy_return(hrljax.SARSA(), bus, 4, optimal_q, params, ZERO, 0)) == pytest.approx(-17)


def test_an_axis_of_the_environment_cannot_be_evaluated(bus: Bus, optimal_q: jax.Array):
    def value(slip: jax.Array) -> jax.Array:
        params = BusParams()._replace(slip_probability=slip)
        return greedy_return(hrljax.QLearning(), bus, 4, optimal_q, params, ZERO, 0)

    with pytest.raises(ValueError, match="exact evaluation needs fixed params"):
        jax.eval_shape(value, jnp.float32(0.1))


class Learned(NamedTuple):
    learner: Any
    prepared: Any
    tables: Any
    parts: np.ndarray  # [tasks, S, A, 4]
    choice: np.ndarray  # [S, tasks], 0 where the root never decides


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(hrljax.RandomRoot(), id="random"),
        pytest.param(hrljax.ModelRoot(), id="model", marks=pytest.mark.slow),
    ],
)
def learned(request: pytest.FixtureRequest) -> Learned:
    learner = hrljax.HORDQ(SMALL.hierarchy(), request.param, pseudo_reward=5.0, initial_value=-12.0)
    run = jax.jit(lambda key: hrljax.train(SMALL, learner, key, 200))(jax.random.key(2))
    prepared = learner.prepare(SMALL)
    parts = np.asarray(run.learned.q).reshape(-1, SMALL.num_states, 4, 4)
    choose = random_choice if isinstance(request.param, hrljax.RandomRoot) else planned_choice
    return Learned(learner, prepared, run.learned, parts, choose(parts, prepared, run))


ACTIVE = tabulate(SMALL.hierarchy(), SMALL).active[1:]


def random_choice(parts: np.ndarray, prepared: Any, run: hrljax.Run) -> np.ndarray:
    return ACTIVE.T / ACTIVE.T.sum(1, keepdims=True)


def planned_choice(parts: np.ndarray, prepared: Any, run: hrljax.Run) -> np.ndarray:
    """The best subtask by the learned model wherever the root may decide."""
    points, choice = prepared.root, np.zeros(ACTIVE.T.shape)
    shape = (points.num_x, points.num_slots, -1, points.num_y)
    model, values = np.asarray(run.learned.root.model).reshape(shape), np.asarray(run.learned.root.values)
    outcomes = points.outcomes.reshape(*shape[:2], -1)
    for state in np.flatnonzero((points.planning >= 0) & (points.state[points.point] == np.arange(len(choice)))):
        x, y = divmod(int(points.point[state]), points.num_y)
        worth = {}
        for slot in np.flatnonzero(points.can_invoke[x, :, y]):
            task = points.tasks.reshape(shape[:2])[x, slot]
            best = parts[task, state, parts[task, state].sum(-1).argmax()]
            after = model[x, slot, :-1, y] @ values.reshape(-1, points.num_y)[outcomes[x, slot], y]
            worth[task] = best[0] + best[1] + after if model[x, slot, -1, y] else np.float32(-30)
        choice[state, max(worth, key=worth.__getitem__)] = 1
    return choice


def test_the_root_is_taken_to_choose_as_it_does(learned: Learned):
    root, tables, asked = learned.learner.root, learned.tables.root, outside_of_training(ZERO, 0)
    child_value = learned.learner._child_value(Known(learned.prepared.layout, learned.tables.q, None, asked))
    actual = jax.jit(jax.vmap(lambda s: root.probabilities(learned.prepared.root, tables, child_value, s, asked)))(
        jnp.arange(SMALL.num_states, dtype=jnp.int32)
    )
    decides = learned.choice.any(1)
    assert decides.sum() > 50
    np.testing.assert_allclose(actual[decides], learned.choice[decides], rtol=1e-6)


@pytest.fixture(scope="module")
def model() -> Model:
    return SMALL.model()


def test_a_hierarchical_policy_has_the_value_that_numpy_finds(learned: Learned, model: Model):
    """By backward induction over (subtask, state) pairs in float64."""
    actions = learned.parts.sum(-1).argmax(-1)
    rows, tasks = (np.arange(SMALL.num_states), actions), np.arange(len(ACTIVE))[:, None, None]
    value = np.zeros(ACTIVE.shape)
    for _ in range(SHORT.max_steps):
        arriving = np.where(ACTIVE, value, (learned.choice * value.T).sum(1))
        follows = np.where(model.terminated[rows], 0, arriving[tasks, model.next_state[rows]])
        value = (model.probability[rows] * (model.reward[rows] + follows)).sum(-1)
    expected = SMALL.initial_distribution() @ (learned.choice * value.T).sum(1)
    actual = greedy_return(learned.learner, SMALL, learned.prepared, learned.tables, SHORT, ZERO, 0)
    assert float(actual) == pytest.approx(expected, abs=1e-3)
    assert -100 < expected < -12


def evaluated(key: jax.Array) -> hrljax.Run:
    learner = hrljax.SARSA(initial_value=-25.0)
    return hrljax.train(SMALL, learner, key, 32, params=SHORT, bin_size=5, evaluate_every=3)


def test_a_run_is_evaluated_after_the_last_episode_of_a_bin():
    """At a checkpoint: the value of what a run of so many episodes learns."""
    learner, key = hrljax.SARSA(initial_value=-25.0), jax.random.key(4)
    whole = jax.jit(evaluated)(key)
    assert whole.greedy_return.shape == (2,)
    shorter = jax.jit(lambda key: hrljax.train(SMALL, learner, key, 30, params=SHORT, bin_size=5))(key)
    evaluate = jax.jit(lambda tables, zero: greedy_return(learner, SMALL, 4, tables, SHORT, zero, 0))
    assert evaluate(shorter.learned, ZERO) == whole.greedy_return[1]
    assert whole.greedy_return[0] != whole.greedy_return[1]


def test_a_key_may_be_a_constant_of_the_compiled_function():
    """Where the compiler knows the key, it still may not fuse what a run rounds separately."""
    key = jax.random.key(4)
    chex.assert_trees_all_equal(jax.jit(evaluated)(key), jax.jit(lambda: evaluated(key))())


@pytest.mark.slow
def test_a_greedy_policy_goes_by_the_schedule_of_the_episode_that_it_is_asked_in():
    """Subtasks obey for 30 of 40 episodes: what is said of the last ones is said of a learner that is free."""

    def with_pseudo_reward(value: Any) -> hrljax.SharedHORDQ:
        return hrljax.SharedHORDQ(SMALL.hierarchy(), hrljax.RandomRoot(), pseudo_reward=value, initial_value=-12.0)

    scheduled = with_pseudo_reward(lambda episode: jnp.where(episode < 30, jnp.float32(1000), jnp.float32(0)))
    run = jax.jit(lambda key: hrljax.train(SMALL, scheduled, key, 40, params=SHORT, bin_size=20, evaluate_every=1))(
        jax.random.key(2)
    )
    free, obedient = (
        float(greedy_return(learner, SMALL, learner.prepare(SMALL), run.learned, SHORT, ZERO, 0))
        for learner in map(with_pseudo_reward, (0.0, 1000.0))
    )
    assert float(run.greedy_return[-1]) == pytest.approx(free, abs=1e-3)
    assert abs(free - obedient) > 1
    told, expected, other = (
        hrljax.Learned(SMALL, learner, run.learned, episodes=40).policy().slots
        for learner in (scheduled, with_pseudo_reward(0.0), with_pseudo_reward(1000.0))
    )
    np.testing.assert_array_equal(told, expected)
    assert (told != other).any()
