"""The environments under gymnax's two interfaces: parity with the native ones, auto-reset, spaces, numbers."""

import copy
import importlib.util
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.interop import gymnax as adapter
from hrljax.interop import gymnax_spaces
from tests.interop.walker import Walker
from tests.maps import SMALL

LIMIT = 8
HAS_GYMNAX = importlib.util.find_spec("gymnax") is not None
ENVIRONMENTS = {"Bus": SMALL, "Maze": hrl.make("Maze"), "Taxi": hrl.make("Taxi"), "Walker": Walker()}


def made(name: str, **settings: Any):
    return adapter.make(ENVIRONMENTS[name], params={"max_steps": LIMIT}, **settings)


def assert_same(these: Any, those: Any) -> None:
    jax.tree.map(np.testing.assert_array_equal, these, those)


@pytest.mark.parametrize(
    ("name", "one_hot"), [*((name, False) for name in ENVIRONMENTS), ("Bus", True), ("Maze", True), ("Taxi", True)]
)
def test_steps_are_native_ones_and_begin_anew_where_an_episode_is_over(name: str, one_hot: bool):
    """All at once: 30 steps of random actions, with 6 values and with 5, against native steps with the same keys."""
    native = ENVIRONMENTS[name]
    env, params = made(name, one_hot=one_hot)
    older, _ = made(name, one_hot=one_hot, step_values=5)
    key = jax.random.PRNGKey(3)
    actions = jax.random.randint(jax.random.key(1), (30,), 0, native.num_actions)

    def seen(obs: Any) -> Any:
        return jax.nn.one_hot(obs, native.num_states, dtype=jnp.float32) if one_hot else obs

    @jax.jit
    def compare(state, action, key):
        new, old = env.step(key, state, action, params), older.step(key, state, action, params)
        step_key, reset_key = (jax.random.wrap_key_data(k) for k in jax.random.split(key))
        stepped = native.step(step_key, state, action, params.numbers)
        return new, old, stepped, native.reset(reset_key, params.numbers)

    obs, state = env.reset(key, params)
    native_obs, native_state = native.reset(jax.random.wrap_key_data(key), params.numbers)
    assert_same((obs, state), (seen(native_obs), native_state))
    ends = 0
    for action, key in zip(actions, jax.random.split(jax.random.PRNGKey(4), 30), strict=True):
        new, old, stepped, begun = compare(state, action, key)
        obs, state, reward, terminated, truncated, info = new
        done = bool(terminated | truncated)
        ends += done
        native_obs, after, *outcome, events = stepped
        assert_same((reward, terminated, truncated), tuple(outcome))
        ended = {"terminated": terminated, "truncated": truncated}
        assert_same(info, {**events, **ended, "final_observation": seen(native_obs)})
        assert_same((obs, state), (seen(begun[0]), begun[1]) if done else (seen(native_obs), after))
        assert len(old) == 5
        assert_same(old[:4], (obs, state, reward, terminated | truncated))
        assert_same(old[4], {**info, "discount": np.float32(not terminated)})
    assert ends >= 2


def test_old_and_new_keys_are_the_same_keys():
    env, params = made("Bus")
    old, new = jax.random.PRNGKey(2), jax.random.key(2)
    assert_same(env.reset(old, params), env.reset(new, params))
    _, state = env.reset(old, params)
    assert_same(env.step(old, state, 1, params), env.step(new, state, 1, params))


def test_a_step_without_reset_stays_where_the_episode_ended():
    env, params = made("Maze")
    older, _ = made("Maze", step_values=5)
    key = jax.random.PRNGKey(0)
    _, state = env.reset(key, params)
    late = state._replace(time=jnp.int32(LIMIT - 1))
    assert not env.is_truncated(late, params)
    obs, after, reward, terminated, events = env.step_env(key, late, 0, params)
    assert (float(reward), bool(terminated), events) == (-1.0, False, {})
    assert int(after.time) == LIMIT
    assert env.is_truncated(after, params)
    assert_same(obs, env.get_obs(after, params))
    assert_same(obs, env.observe(key, after, 0, params))
    assert bool(older.step_env(key, late, 0, params)[3])


def test_numbers_may_be_traced_and_mapped_over():
    env, params = adapter.make("Maze")
    assert params.max_steps_in_episode == params.max_steps == 1000
    assert params.slip_probability == 0
    limits = jnp.array([1, 2, 3], jnp.int32)
    rewards = jnp.array([-1.0, -2.0, -3.0])
    several = params.replace(max_steps_in_episode=limits, step_reward=rewards)
    axes = jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, several)
    key = jax.random.PRNGKey(0)
    _, state = env.reset(key, params)
    step = jax.vmap(env.step, (None, None, None, axes))
    _, after, reward, _, truncated, _ = step(key, state, jnp.int32(0), several)
    assert reward.tolist() == [-1.0, -2.0, -3.0]
    assert truncated.tolist() == [True, False, False]
    assert after.time.tolist() == [0, 1, 1]
    assert reward.dtype == jnp.float32
    plain = jax.jit(env.step)(key, state, 0, params)  # numbers of Python, as weakly typed tracers
    assert_same(plain, env.step(key, state, 0))
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(plain))


def test_an_environment_is_a_value_and_survives_copies():
    env, params = adapter.make("Bus", one_hot=True)
    again, its_params = copy.deepcopy((env, params))
    assert (env, params) == (again, its_params)
    assert hash(env) == hash(again)
    assert (env.name, env.num_actions) == ("Bus", 4)
    assert env != adapter.make("Bus")[0]


@pytest.mark.filterwarnings("ignore:Explicitly requested dtype int64")  # gymnax before 1.0 draws int64
def test_spaces_hold_what_is_observed():
    env, params = adapter.make(SMALL, one_hot=True)
    space = env.observation_space(params)
    assert (type(space).__name__, space.shape, space.low, space.high) == ("Box", (SMALL.num_states,), 0, 1)
    assert space.dtype == jnp.float32
    obs, _ = env.reset(jax.random.PRNGKey(0), params)
    assert obs.shape == space.shape
    assert (float(obs.sum()), bool(space.contains(obs)), bool(space.contains(2 * obs))) == (1.0, True, False)
    actions = env.action_space(params)
    assert (type(actions).__name__, actions.n, actions.shape) == ("Discrete", 4, ())
    drawn = jax.jit(jax.vmap(actions.sample))(jax.random.split(jax.random.PRNGKey(1), 50))
    assert set(drawn.tolist()) == {0, 1, 2, 3}
    assert drawn.dtype == jnp.int32
    assert adapter.make(SMALL)[0].observation_space(params).n == SMALL.num_states


def test_spaces_are_gymnaxs_own_where_it_is_installed():
    env, params = adapter.make("Maze")
    module = type(env.action_space(params)).__module__
    assert module == ("gymnax.environments.spaces" if HAS_GYMNAX else "hrljax.interop.gymnax_spaces")


def test_stand_ins_of_trees(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gymnax_spaces, "_spaces", lambda: gymnax_spaces._StandIns)
    env, params = adapter.make(Walker())
    space = env.observation_space(params)
    assert isinstance(space, gymnax_spaces.Dict)
    assert isinstance(space.spaces["parts"], gymnax_spaces.Tuple)
    obs, _ = env.reset(jax.random.PRNGKey(0), params)
    assert space.contains(obs._asdict())
    assert not space.contains({**obs._asdict(), "place": jnp.full(2, 99.0)})
    drawn = jax.jit(jax.vmap(space.sample))(jax.random.split(jax.random.PRNGKey(0), 200))
    assert jax.jit(jax.vmap(space.contains))(drawn).all()
    assert drawn["place"].shape == (200, 2)
    assert float(drawn["place"].max()) > 8
    assert drawn["parts"][1].dtype == jnp.int8
    numbers = gymnax_spaces.gymnax_space(gymnasium_spaces().MultiDiscrete([2, 5]))
    assert np.asarray(numbers.high).tolist() == [1, 4]
    with pytest.raises(TypeError, match="gymnax has no counterpart of the space"):
        gymnax_spaces.gymnax_space(gymnasium_spaces().Text(3))


def gymnasium_spaces() -> Any:
    return importlib.import_module("gymnasium.spaces")


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="step_values must be one of 5, 6, got 4"):
        adapter.make("Bus", step_values=4)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="one_hot needs a tabular environment, got Walker"):
        adapter.make(Walker(), one_hot=True)
    with pytest.raises(ValueError, match=r"unknown environment 'Buss'"):
        adapter.make("Buss")
    env, params = adapter.make("Maze")
    with pytest.raises(ValueError, match="params must be among slip_probability, step_reward, max_steps, got slip"):
        params.replace(slip=0.5)
    with pytest.raises(AttributeError, match="slip"):
        _ = params.slip
    with pytest.raises(ValueError, match=r"env.slip_probability must be a finite number in \[0, 1\], got 3"):
        params.replace(slip_probability=3)
    with pytest.raises(TypeError, match=r"env.max_steps must be an integer from 1 to 2147483647, got 'many'"):
        params.replace(max_steps="many")
    with pytest.raises(
        TypeError, match=r"params must be GymnaxParams .*got MazeParams\(slip_probability=a traced float32"
    ):
        env.reset(jax.random.key(0), params.numbers)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"environment must be an environment such as .*got 'Maze'"):
        adapter.GymnaxEnvironment("Maze")  # type: ignore[arg-type]
