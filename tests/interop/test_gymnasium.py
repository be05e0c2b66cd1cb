"""Single environments under Gymnasium: its own checks, parity with the native ones, seeds, pictures, refusals."""

import subprocess
import sys

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.utils.seeding import np_random

import hrljax as hrl
from hrljax.envs.taxi.env import Taxi
from hrljax.interop import episodes
from hrljax.interop.gymnasium import SingleEnv
from tests.interop.walker import Walker
from tests.maps import SMALL

TABULAR = ("Bus", "Gridworld", "Maze", "Taxi")


def checked(env_id: str) -> None:
    """Gymnasium's checks, every warning being an error."""
    check_env(gymnasium.make(env_id, disable_env_checker=True).unwrapped)
    env = gymnasium.make(env_id)  # with the wrapper that checks the first calls
    env.reset(seed=0)
    env.step(env.action_space.sample())


def test_importing_the_library_registers_every_environment_and_loads_no_adapter():
    code = (
        "import sys, hrljax, gymnasium; names = hrljax.registered(); assert len(names) >= 4;"
        "assert all(f'hrljax/{name}-v0' in gymnasium.registry for name in names);"
        "assert not any(name.startswith('hrljax.interop') for name in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", [name for name in hrl.registered() if name != "Mario"])
def test_every_environment_passes_gymnasiums_checks(name: str):
    checked(f"hrljax/{name}-v0")


@pytest.mark.slow
@pytest.mark.skipif("Mario" not in hrl.registered(), reason="Mario is not there")
def test_mario_passes_gymnasiums_checks(quick_compiler: None):
    checked("hrljax/Mario-v0")


def test_an_environment_of_ones_own_passes_gymnasiums_checks(walker_id: str):
    checked(walker_id)
    assert gymnasium.make(walker_id).metadata["render_modes"] == []


def test_a_name_that_gymnasium_cannot_have_is_refused():
    with pytest.raises(ValueError, match=r"name must consist of letters, digits, .* got 'my env'"):
        hrl.register("my env", Walker)
    assert "my env" not in hrl.registered()


@pytest.mark.parametrize("made", [SMALL, *TABULAR[1:], Walker()], ids=lambda made: getattr(made, "name", made))
def test_steps_are_those_of_the_native_environment(made):
    env, seed = SingleEnv(made, params={"max_steps": 40}), 5
    native, params = env.environment, env.params
    reset, step = jax.jit(native.reset), jax.jit(native.step)
    generator, actions = np_random(seed)[0], np.random.default_rng(0)
    ends = 0
    for episode in range(4):
        key = jax.random.wrap_key_data(generator.integers(0, 1 << 32, 2, np.uint32))
        obs, state = reset(jax.random.fold_in(key, 0), params)
        seen, info = env.reset(seed=seed if episode == 0 else None)
        assert info == {}
        for time in range(1, 41):
            assert seen in env.observation_space
            assert all(map(np.array_equal, jax.tree.leaves(seen), leaves_in_order(obs)))
            action = int(actions.integers(native.num_actions))
            obs, state, *outcome = step(jax.random.fold_in(key, time), state, jnp.int32(action), params)
            seen, *its_outcome = env.step(action)
            assert [type(x) for x in its_outcome] == [float, bool, bool, dict]
            assert its_outcome == jax.tree.map(lambda x: x.item(), outcome)
            assert set(its_outcome[-1]) == set(native.metrics)
            if its_outcome[1] or its_outcome[2]:
                break
        ends += its_outcome[1] or its_outcome[2]
    assert ends == 4


def leaves_in_order(observation):
    """Leaves of an observation in the order in which those of a dict come: by name."""
    tree = dict(observation._asdict()) if hasattr(observation, "_asdict") else observation
    return jax.tree.leaves(tree)


def test_options_and_numbers_reach_the_environment():
    env = gymnasium.make("hrljax/Taxi-v0", stochastic=True, rules="gymnasium", params={"illegal_reward": -3.0})
    assert env.unwrapped.environment == Taxi(stochastic=True, rules="gymnasium")
    env.reset(seed=0)
    rewards = {env.step(4)[1] for _ in range(3)}
    assert rewards <= {-3.0, -1.0}
    assert -3.0 in rewards
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.environment == env.unwrapped.environment
    assert again.unwrapped.params == env.unwrapped.params
    own = SingleEnv(SMALL, params=SMALL.default_params._replace(max_steps=3))
    assert own.params.max_steps == 3


def test_seeds_repeat_and_differ():
    env = gymnasium.make("hrljax/Bus-v0")

    def walk(seed: int | None) -> list:
        trace = [env.reset(seed=seed)]
        for action in np.random.default_rng(1).integers(0, 4, 30).tolist():
            trace.append(env.step(action))
            if trace[-1][2]:
                break
        return trace

    first, unseeded = walk(3), walk(None)
    assert data_equivalence(walk(3), first, exact=True)
    assert data_equivalence(walk(None), unseeded, exact=True)
    assert not data_equivalence(unseeded, first)
    assert not data_equivalence(walk(4), first)


def test_an_episode_is_cut_off_at_the_limit_and_then_needs_a_reset():
    env = gymnasium.make("hrljax/Maze-v0", params={"max_steps": 5}).unwrapped
    with pytest.raises(ResetNeeded, match="call reset first"):
        env.step(0)
    env.reset(seed=0)
    ends = [env.step(0)[2:4] for _ in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]
    with pytest.raises(ResetNeeded, match="call reset first"):
        env.step(0)
    env.reset()
    assert env.step(0)[2:4] == (False, False)


def test_the_step_is_compiled_once_for_all_equal_environments():
    before = episodes.advance._cache_size()
    for seed in range(3):
        env = gymnasium.make("hrljax/Bus-v0", map=SMALL.map, params={"max_steps": 123}).unwrapped
        env.reset(seed=seed)
        for action in (0, np.int64(1), np.array(2), 3):
            env.step(action)
            if not env._goes_on:
                env.reset()
    assert episodes.advance._cache_size() == before + 1


@pytest.mark.parametrize("name", TABULAR)
def test_pictures_are_those_of_the_environment(name: str):
    env = gymnasium.make(f"hrljax/{name}-v0", render_mode="ansi", disable_env_checker=True)
    env.reset(seed=1)
    text = env.render()
    assert isinstance(text, str)
    assert text == env.unwrapped.environment.render(env.unwrapped.state)
    picture = env.unwrapped.environment.render(env.unwrapped.state, "rgb_array")
    assert picture.dtype == np.uint8
    assert picture.ndim == 3
    assert picture.std() > 10
    env.step(1 if name != "Taxi" else 0)
    moves = {env.step(action)[0] for action in (0, 1, 2)}
    assert len(moves) > 1
    assert env.render() != text


def test_pictures_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match="render mode must be one of 'ansi', 'rgb_array'; got 'human'"):
        SingleEnv("Bus", render_mode="human")
    with pytest.raises(ValueError, match="Walker has no pictures, for it has no renderer; got the render mode 'ansi'"):
        SingleEnv(Walker(), render_mode="ansi")
    with pytest.raises(ResetNeeded, match="render needs a state"):
        SingleEnv("Bus", render_mode="ansi").render()
    with pytest.warns(UserWarning, match="render needs a render_mode"):
        assert SingleEnv("Bus").render() is None


def test_bad_input_is_refused():
    with pytest.raises(TypeError, match="Bus has no option 'nonsense'; its options are map, site"):
        gymnasium.make("hrljax/Bus-v0", nonsense=1)
    with pytest.raises(ValueError, match=r"params of Bus must be among slip_probability, .* got nonsense"):
        gymnasium.make("hrljax/Bus-v0", params={"nonsense": 1})
    with pytest.raises(ValueError, match=r"env.slip_probability must be a finite number in \[0, 1\], got 2"):
        gymnasium.make("hrljax/Bus-v0", params={"slip_probability": 2})
    with pytest.raises(TypeError, match="options are for environments that are given by name, got site"):
        SingleEnv(SMALL, site="cell")
    env = SingleEnv(SMALL)
    with pytest.raises(ValueError, match="options must be empty, got where"):
        env.reset(options={"where": 1})
    env.reset(seed=0)
    for action in (-1, 4):
        with pytest.raises(ValueError, match=f"action must be an integer from 0 to 3, got {action}"):
            env.step(action)
    for action in (1.5, "north", None, np.array([0, 1])):
        with pytest.raises(TypeError, match="action must be an integer from 0 to 3, got "):
            env.step(action)
    with pytest.raises(TypeError, match="Taxi has no option 'slip_probability': it is one of its numbers"):
        gymnasium.make("hrljax/Taxi-v0", slip_probability=0.1)
    with pytest.raises(TypeError, match=r"env.max_steps must be an integer from 1 to 2147483647, got '5'"):
        SingleEnv(SMALL, params={"max_steps": "5"})
