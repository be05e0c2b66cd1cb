"""Programs written for gymnax learn the Bus domain: in the manner of purejaxrl, and rejax itself."""

from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

import jax
import numpy as np
import pytest

from hrljax.interop import gymnax as adapter
from tests.interop.ppo import Config, make_train
from tests.maps import SMALL

OPTIMUM = -11.2
"""Expected return of the optimal policy on the small map; a random one gets about -70 in 200 steps."""


@pytest.fixture(autouse=True)
def lenient_promotion() -> Iterator[None]:
    """The learners here are other people's, or use optax, which mixes integers and floats."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


def bus(step_values: Any) -> tuple[Any, Any]:
    return adapter.make(SMALL, one_hot=True, step_values=step_values, params={"max_steps": 200})


@pytest.mark.slow
def test_ppo_learns():
    returns = np.asarray(jax.jit(make_train(Config(num_envs=16, num_updates=24), *bus(6)))(jax.random.PRNGKey(0)))
    assert returns[0] < 4 * OPTIMUM
    assert returns[-4:].mean() > 1.5 * OPTIMUM


def test_ppo_can_be_traced_with_five_values():
    """That they are those of the six is tested step by step elsewhere."""
    returns = jax.eval_shape(make_train(Config(num_updates=7), *bus(5)), jax.random.PRNGKey(0))
    assert (returns.shape, returns.dtype) == ((7,), np.float32)


def test_ppo_learns_through_gymnaxs_own_wrappers():
    purerl = pytest.importorskip("gymnax.wrappers.purerl", reason="gymnax is not installed (it caps jax and gymnasium)")
    is_old = int(version("gymnax").split(".")[0]) < 1
    env, params = bus(5 if is_old else 6)
    wrapped = purerl.LogWrapper(purerl.FlattenObservationWrapper(env))
    config = Config(num_updates=3)
    returns = np.asarray(jax.jit(make_train(config, wrapped, params))(jax.random.PRNGKey(0)))
    unwrapped = np.asarray(jax.jit(make_train(config, env, params))(jax.random.PRNGKey(0)))
    np.testing.assert_array_equal(returns, unwrapped)

    _, state = wrapped.reset(jax.random.PRNGKey(1), params)
    state = state.replace(env_state=state.env_state._replace(time=state.env_state.time + 199))
    *_, info = wrapped.step(jax.random.PRNGKey(2), state, 0, params)
    assert (bool(info["returned_episode"]), float(info["returned_episode_returns"])) == (True, -1.0)


def test_rejax_learns():
    rejax = pytest.importorskip("rejax", reason="rejax is not installed (with gymnax, it caps jax and gymnasium)")
    env, params = bus(5)
    sizes = {"num_envs": 32, "num_steps": 64, "num_epochs": 4, "num_minibatches": 4}
    agent = rejax.PPO.create(
        env=env, env_params=params, total_timesteps=61_440, eval_freq=20_480, learning_rate=5e-3, **sizes
    )
    _, (lengths, returns) = jax.jit(agent.train)(jax.random.PRNGKey(0))
    curve = np.asarray(returns).mean(-1)
    assert np.asarray(lengths).max() <= 200
    assert curve[0] < 4 * OPTIMUM
    assert curve[-1] > 2 * OPTIMUM
