"""Numbers and actions that an environment is given: which are taken, and what is said of the others."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.envs.base import concrete_params
from hrljax.envs.grid.maze import Maze, MazeParams
from hrljax.envs.taxi.env import FickleTaxiParams, TaxiParams

MAZE = Maze()
KEY_WORDS = np.zeros(2, np.uint32)


def reset(params: object) -> object:
    return MAZE.reset(jax.random.key(0), params)  # type: ignore[arg-type]


def step(action: object) -> object:
    return MAZE.step(jax.random.key(0), MAZE.decode(jnp.int32(0)), action)  # type: ignore[arg-type]


@pytest.mark.parametrize("use", [reset, MAZE.model, MAZE.initial_distribution])
@pytest.mark.parametrize("wrong", [{"max_steps": 5}, TaxiParams(), MazeParams, (0.0, -1.0, 5)], ids=str)
def test_params_are_those_of_the_environment(use: Callable[[object], object], wrong: object):
    with pytest.raises(
        TypeError, match=r"params must be a MazeParams, the numbers of Maze, .*_replace\(max_steps=5\), got "
    ):
        use(wrong)


def test_params_of_another_variant_are_refused():
    assert TaxiParams._fields != FickleTaxiParams._fields
    with pytest.raises(TypeError, match="the numbers of Maze"):
        reset(FickleTaxiParams())


@pytest.mark.parametrize(
    ("numbers", "error", "message"),
    [
        ({"max_steps": 2**31}, ValueError, "env.max_steps must be an integer from 1 to 2147483647, got 2147483648"),
        ({"max_steps": 0}, ValueError, "env.max_steps must be an integer from 1 to 2147483647, got 0"),
        ({"max_steps": "x"}, TypeError, "env.max_steps must be an integer from 1 to 2147483647, got 'x'"),
        ({"max_steps": 5.5}, TypeError, "env.max_steps must be an integer from 1 to 2147483647, got 5.5"),
        ({"max_steps": np.nan}, TypeError, "env.max_steps must be an integer from 1 to 2147483647, got nan"),
        ({"step_reward": "-1"}, TypeError, "env.step_reward must be a number, got '-1'"),
        ({"step_reward": True}, TypeError, "env.step_reward must be a number, got True"),
        ({"step_reward": np.zeros(2)}, TypeError, r"env.step_reward must be a number, got array\(\[0., 0.\]\)"),
        ({"step_reward": 1e60}, ValueError, r"env.step_reward must be a finite number .*3.4e\+38\], got 1e\+60"),
        ({"slip_probability": 1.5}, ValueError, r"env.slip_probability must be a finite number in \[0, 1\], got 1.5"),
    ],
)
def test_numbers_are_in_their_range(numbers: dict, error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        reset(MazeParams(**numbers))


def test_numpys_numbers_are_numbers():
    params = concrete_params(MazeParams(np.array(0.25), jnp.float32(-2), np.int64(7)))  # type: ignore[arg-type]
    assert params == MazeParams(0.25, -2.0, 7)
    assert type(params.max_steps) is int


@pytest.mark.parametrize("action", [0, np.int64(0), np.array(0), jnp.uint8(0)], ids=repr)
def test_an_action_is_an_integer_of_any_kind(action: object):
    assert jax.tree.all(jax.tree.map(jnp.array_equal, step(action), step(jnp.int32(0))))


@pytest.mark.parametrize(
    ("action", "error"),
    [
        (3, ValueError),
        (-1, ValueError),
        (1.7, TypeError),
        (None, TypeError),
        ("north", TypeError),
        (np.zeros(2, int), TypeError),
    ],
)
def test_an_action_that_does_not_exist_is_refused(action: object, error: type[Exception]):
    with pytest.raises(error, match="action must be an integer from 0 to 2, got "):
        step(action)


@pytest.mark.parametrize(
    ("traced", "message"),
    [
        (lambda x: reset(MazeParams(max_steps=x)), r"env.max_steps must be an integer .*, got a traced float32\[\]"),
        (lambda x: reset(MazeParams(slip_probability=x[None])), r"must be a number, got a traced float32\[1\]"),
        (step, r"action must be an integer from 0 to 2, got a traced float32\[\]"),
        (
            lambda x: MAZE.model(MazeParams(slip_probability=x)),
            r"params must be fixed .*slip_probability=a traced float32\[\]",
        ),
    ],
)
def test_what_is_traced_is_named_by_its_type(traced: Callable[[object], object], message: str):
    with pytest.raises(TypeError, match=message) as refused:
        jax.eval_shape(traced, np.float32(0))
    assert "Tracer" not in str(refused.value)
