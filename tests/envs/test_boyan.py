"""Boyan's chain by hand, and linear Dyna on it: the limit that theory gives, and the order of the published curves."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.boyan import BoyanChain, BoyanState
from hrljax.learners.features import Features
from tests.words import KEY

NEAR, FAR = 0, 2**23


def step(position: int, word: int) -> tuple[int, float, bool]:
    env = hrl.make("BoyanChain", length=12)
    state = BoyanState(jnp.int32(position), jnp.int32(4))
    after, reward, ended, _ = env.transition(state, jnp.int32(0), (jnp.uint32(word),), env.default_params)
    assert after.time == 5
    return int(after.position), float(reward), bool(ended)


def test_steps_by_hand():
    assert step(12, NEAR) == (11, -3, False)
    assert step(12, FAR) == (10, -3, False)
    assert step(2, NEAR) == (1, -3, False)
    assert step(2, FAR) == (0, -3, False)
    assert step(1, NEAR) == step(1, FAR) == (0, -2, False)
    assert step(0, NEAR) == step(0, FAR) == (0, 0, True)


@pytest.mark.parametrize("length", [4, 12, 96])
def test_a_position_is_worth_minus_twice_itself(length: int):
    value = hrl.solvers.value_iteration(hrl.make("BoyanChain", length=length).model()).value
    np.testing.assert_allclose(value, -2.0 * np.arange(length + 1), rtol=1e-5)


def test_features_interpolate():
    """Those of Boyan's Figure: from [0, 0, 0, 1] at the far end to [1, 0, 0, 0]."""
    matrix = hrl.make("BoyanChain", length=12).interpolation()
    assert matrix.shape == (13, 4)
    assert matrix[12].tolist() == [0, 0, 0, 1]
    assert matrix[11].tolist() == [0, 0, 0.25, 0.75]
    assert matrix[6].tolist() == [0, 0.5, 0.5, 0]
    assert matrix[0].tolist() == [1, 0, 0, 0]
    np.testing.assert_array_equal(matrix @ np.array([0, 4, 8, 12]), np.arange(13))


@pytest.mark.parametrize(
    ("options", "message"), [({"length": 10}, "multiple of spacing=4"), ({"spacing": 0}, "from 1")]
)
def test_wrong_settings_are_refused(options: dict[str, int], message: str):
    with pytest.raises(ValueError, match=message):
        BoyanChain(**options)


def slower(first: float, kept: float) -> Any:
    """Step sizes of the paper: nearly constant, then falling a little faster than with the episode."""
    return lambda episode: first * (kept + 1) / (kept + (jnp.asarray(episode, jnp.float32) + 1) ** 1.1)


def trained(env: BoyanChain, learner: hrl.LinearDyna, episodes: int, runs: int) -> np.ndarray:
    """``[runs, n]``: theta."""
    keys = jax.random.split(KEY, runs)
    run = jax.jit(lambda keys: jax.lax.map(lambda key: hrl.train(env, learner, key, episodes), keys))(keys)
    return np.asarray(run.learned.theta, np.float64)


def least_squares(env: BoyanChain, matrix: np.ndarray, discount: float) -> np.ndarray:
    """The solution of least-squares TD for the states as often as they are visited: ``A theta = b``."""
    model, states = env.model(), np.arange(env.num_states)
    chain = np.zeros((env.num_states, env.num_states))
    np.add.at(chain, (states[:, None], model.next_state[:, 0]), model.probability[:, 0] * ~model.terminated[:, 0])
    reward = (model.probability * model.reward).sum(2)[:, 0]
    visits = np.linalg.solve(np.eye(env.num_states) - chain.T, env.initial_distribution())
    weighted = matrix.T * visits
    return np.linalg.solve(weighted @ (matrix - discount * chain @ matrix), weighted @ reward)


@pytest.mark.parametrize("planning", ["mg", "random"])
def test_the_limit_is_the_solution_of_least_squares_td(planning: Any):
    """The paper's Theorem 3.1, with features in which the values are not linear."""
    env = hrl.make("BoyanChain", length=12)
    matrix = np.random.default_rng(4).random((13, 3)).astype(np.float32)
    matrix /= np.linalg.norm(matrix, axis=1, keepdims=True)
    sizes = {"step_size": slower(0.3, 100), "model_step_size": slower(0.3, 100)}
    learner = hrl.LinearDyna(Features.from_dense(matrix), discount=0.9, planning=planning, **sizes)
    theta = trained(env, learner, 3000, 20)
    expected = least_squares(env, matrix.astype(np.float64), 0.9)
    values = hrl.solvers.value_iteration(env.model(), 0.9).value
    assert np.abs(matrix @ expected - values).max() > 0.5
    np.testing.assert_allclose((theta @ matrix.T).mean(0), matrix @ expected, atol=0.1)


@pytest.mark.slow
def test_the_curves_of_the_paper():
    """98 states (the end counts), 25 features, one planning step and falling step sizes, as Sutton et al. 2008 had.

    Their curves are a picture, so that it is the order that is held. Without planning the error falls slowest; then
    with features drawn at random; with prioritized sweeping it falls by two orders of magnitude in 100 episodes.
    """
    env = hrl.make("BoyanChain")
    matrix = env.interpolation()
    over = Features.from_dense(matrix)
    assert (env.num_states, over.size) == (97, 25)
    sizes = {"step_size": slower(0.1, 100), "model_step_size": slower(0.1, 100)}
    kinds = {"none": {"planning_steps": 0}, "random": {"planning": "random"}, "mg": {"planning": "mg"}}
    error = {}
    for kind, options in kinds.items():
        for episodes in (1, 50, 100):
            theta = trained(env, hrl.LinearDyna(over, **sizes, **options), episodes, 30)
            wrong = theta @ matrix.T + 2.0 * np.arange(97)
            error[kind, episodes] = np.sqrt((wrong**2).mean(1)).mean()
    assert all(105 < error[kind, 1] < 115 for kind in kinds)
    assert error["mg", 50] < 3 < 50 < error["random", 50] < 0.85 * error["none", 50]
    assert error["mg", 100] < 2 < 30 < error["random", 100] < 0.75 * error["none", 100]
