"""Rewards of every type are the numbers that they mean, in whatever uses an environment."""

from dataclasses import dataclass
from itertools import cycle
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hrljax as hrl
from hrljax.core import random
from hrljax.core.counting import count
from hrljax.engine import simulator
from hrljax.envs.base import concrete_params
from tests.strategies import ProblemEnvironment, random_problem

UNSEEN = -77.0
LEARNER = hrl.QLearning(step_size=1.0, discount=0.0, epsilon=1.0, initial_value=UNSEEN)
"""What it learns are the last rewards of each action."""

OF_PYTHON = {"Python int": int, "Python bool": bool, "Python float": float, "NumPy float64": np.float64}
DTYPES = ("int32", "int8", "uint8", "bool", "float16", *OF_PYTHON)
WAYS = ("native looked up", "vmap computed", "train", "native computed", "vmap looked up")


class Numbers(NamedTuple):
    unused: float = 0.0  # to be swept: then steps are computed
    max_steps: int = 200


@dataclass(frozen=True, eq=False)
class Typed(ProblemEnvironment):
    """A random problem whose rewards have a type; those of Python are the same in every step."""

    dtype: str = "float32"
    default_params = Numbers()  # type: ignore[assignment]

    def transition(self, state: Any, action: Any, words: Any, params: Any) -> Any:
        after, reward, terminated, info = super().transition(state, action, words, params)
        if self.dtype in OF_PYTHON:
            reward = OF_PYTHON[self.dtype](self.problem.reward[0, 0])
        else:
            reward = reward.astype(self.dtype)
        return after, reward, terminated, info


def made(dtype: str, seed: int) -> Typed:
    problem = random_problem(np.random.default_rng(seed), num_states=4, num_actions=2, ending=0.2)
    reward = problem.reward * 8  # integers
    if dtype.startswith("uint"):
        reward = np.abs(reward)
    elif "bool" in dtype:
        reward = reward > 0
    elif "float" in dtype:
        reward = problem.reward
    reward = np.full_like(reward, reward[0, 0]) if dtype in OF_PYTHON else reward
    return Typed(problem._replace(reward=reward.astype(np.float32)), dtype)


def rewards_learned(env: Typed, way: str) -> np.ndarray:
    """``[S, A]``: what runs learned of rewards, `UNSEEN` where none took the action."""
    if way == "train":
        run = jax.jit(lambda key: hrl.train(env, LEARNER, key, 20))(jax.random.key(0))
        return np.asarray(run.learned)
    mapping, _, steps = way.partition(" ")
    axes = {"env.unused": [0.0]} if steps == "computed" else None
    options: Any = {"num_episodes": 20, "mapping": mapping, "keep_learned": True, "progress": False}
    return hrl.sweep(env, LEARNER, seeds=1, axes=axes, **options)["learned"].values


@pytest.mark.slow
@given(dtype=st.sampled_from(DTYPES), seed=st.integers(0, 1000))
@settings(deadline=None, max_examples=10, derandomize=True)
def test_steps_have_the_rewards_of_the_model(dtype: str, seed: int):
    env = made(dtype, seed)
    reward, model = env.problem.reward, env.model()
    happens = model.probability > 0
    np.testing.assert_array_equal(model.reward[happens], np.broadcast_to(reward[..., None], happens.shape)[happens])
    params = concrete_params(env.default_params)
    simulators = simulator.simulator(env, params, 0), simulator._Tabular(env, params, 0)
    key = jax.random.key(seed)

    @jax.jit
    @jax.vmap
    def rewards(state: Any, action: Any) -> Any:
        blocks = [(of, of.block(random.key_words(key), count())) for of in simulators]
        steps = [of.step(state, action, block, jnp.int32(0)).reward for of, block in blocks]
        return env.step(key, env.decode(state), action)[2], *steps

    states, actions = (part.ravel() for part in np.indices(reward.shape, np.int32))
    for taken in rewards(states, actions):
        assert taken.dtype == jnp.float32
        np.testing.assert_array_equal(taken, reward.ravel())


@pytest.mark.slow
@pytest.mark.parametrize(("dtype", "way"), [*zip(DTYPES, cycle(WAYS), strict=False)])
def test_what_is_learned_are_the_rewards_of_the_model(dtype: str, way: str):
    env = made(dtype, seed=len(dtype))
    learned = rewards_learned(env, way).reshape(env.problem.reward.shape)
    seen = learned != UNSEEN
    assert seen.any()
    np.testing.assert_array_equal(learned[seen], env.problem.reward[seen])
