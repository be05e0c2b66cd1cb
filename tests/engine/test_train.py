"""`train` under jit and vmap: which numbers may be traced, and what is said of the others."""

import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.envs.grid.maze import Maze

MAZE = Maze()


def trained(learner: Any = None, num_episodes: Any = 3, **options: Any) -> hrljax.Run:
    return hrljax.train(MAZE, learner or hrljax.QLearning(), jax.random.key(0), num_episodes, **options)


@pytest.mark.parametrize(
    ("run", "message"),
    [
        (
            lambda x: trained(params=MAZE.default_params._replace(max_steps=x)),
            r"env.max_steps must be an integer .*float32\[\]",
        ),
        (
            lambda x: trained(params=MAZE.default_params._replace(step_reward=x[None])),
            r"env.step_reward must .*float32\[1\]",
        ),
        (
            lambda x: trained(hrljax.QLearning(step_size=x[None])),
            r"step_size must be a number or a schedule, .*float32\[1\]",
        ),
        (
            lambda x: trained(hrljax.DynaQ(planning_steps=x)),
            r"planning_steps must be an integer .*float32\[\]; .*static",
        ),
        (
            lambda x: trained(num_episodes=x.astype(int)),
            r"num_episodes must be an integer from 1 to .*int32\[\]; .*static",
        ),
        (lambda x: trained(bin_size=x), r"bin_size must be an integer from 1 to .*float32\[\]; .*static_argnames"),
        (
            lambda x: hrljax.train(MAZE, hrljax.QLearning(), x, 3),
            r"key must be a new-style key .*got a traced float32\[\]",
        ),
        (
            lambda x: hrljax.sweep(MAZE, hrljax.QLearning(step_size=x), seeds=1, num_episodes=1),
            "a sweep compiles and maps",
        ),
    ],
)
@pytest.mark.parametrize("transform", [jax.jit, jax.vmap])
def test_what_may_not_be_traced_is_named_by_its_type(
    transform: Callable[..., Any], run: Callable[[Any], Any], message: str
):
    with pytest.raises(TypeError, match=message) as refused:
        jax.eval_shape(transform(run), np.zeros(2 if transform is jax.vmap else (), np.float32))
    assert "Tracer" not in str(refused.value)


def test_numbers_of_numpy_are_those_of_python():
    expected = jax.make_jaxpr(lambda: trained(num_episodes=3, bin_size=2))()
    actual = jax.make_jaxpr(
        lambda: trained(hrljax.QLearning(discount=np.array(1.0)), np.int32(3), bin_size=np.array(2))
    )()
    # Some versions of JAX print where a function lies in memory.
    address = re.compile("0x[0-9a-f]+")
    assert address.sub("", str(actual)) == address.sub("", str(expected))


def test_a_sweep_of_numpys_numbers_fits_into_a_store(tmp_path: Any):
    numbers: dict[str, Any] = {"seeds": np.int64(1), "num_episodes": np.int64(2), "bin_size": jnp.int32(2)}
    hrljax.sweep(MAZE, hrljax.QLearning(), **numbers, key=np.int64(3), store=tmp_path / "x", progress=False)
    same = hrljax.sweep(
        MAZE, hrljax.QLearning(), seeds=1, num_episodes=2, bin_size=2, key=3, store=tmp_path / "x", progress=False
    )
    assert same.attrs["complete"] == 1


@pytest.mark.parametrize("env", [pytest.param("Maze", marks=pytest.mark.slow), "Bus"])
def test_runs_of_a_users_own_vmap_have_the_bits_of_single_ones(env: str):
    """With tables so large that XLA would read them on several cores: one for each run, or one that all share."""

    def run(key: jax.Array, epsilon: jax.Array) -> hrljax.Run:
        return hrljax.train(hrljax.make(env), hrljax.QLearning(epsilon=epsilon), key, 3)

    keys, epsilons = jax.random.split(jax.random.key(0), 64), jnp.linspace(0.1, 0.5, 64)
    runs, alone = jax.jit(jax.vmap(run))(keys, epsilons), jax.jit(run)
    for seed in (0, 63):
        expected = jax.tree.leaves(alone(keys[seed], epsilons[seed]))
        for actual, single in zip(jax.tree.leaves(runs), expected, strict=True):
            np.testing.assert_array_equal(actual[seed], single)
