"""Episodes step by step: they are those of the environment, and what is no policy is refused."""

import jax
import numpy as np
import pytest
from PIL import Image

import hrljax as hrl
from hrljax.interop.gymnasium import SingleEnv


def best_policy(env) -> np.ndarray:
    return np.asarray(hrl.solvers.value_iteration(env.model()).policy)


def test_a_rollout_goes_through_the_states_of_the_environment():
    env = hrl.make("Maze")
    policy, key = best_policy(env), jax.random.key(3)
    rolled = hrl.rollout(env, policy, key)
    assert len(rolled) == len(rolled.states) - 1 == rolled.table.sizes["step"]
    assert bool(rolled.table["terminated"])
    assert not rolled.table["truncated"]
    numbers = [int(env.encode(state)) for state in rolled.states]
    assert rolled.table["state"].values.tolist() == numbers[:-1]
    assert rolled.table["next_state"].values.tolist() == numbers[1:]
    np.testing.assert_array_equal(rolled.table["action"], policy[numbers[:-1]])
    np.testing.assert_array_equal(rolled.table["return"], np.cumsum(rolled.table["reward"]))
    model, pairs = env.model(), (numbers[:-1], rolled.table["action"].values)
    assert (model.next_state[pairs] == np.array(numbers[1:])[:, None]).any(1).all()


def test_the_key_decides_what_happens():
    env = hrl.make("Bus")
    policy = best_policy(env)
    first, again, other = (hrl.rollout(env, policy, key).table for key in (0, jax.random.key(0), 1))
    assert first.identical(again)
    assert not first.identical(other)
    assert set(env.metrics) < set(first)


@pytest.mark.slow
def test_a_policy_with_a_memory_forgets_it_before_the_episode():
    env = hrl.make("Bus")
    learner = hrl.HORDQ(env.hierarchy(), pseudo_reward=5.0, initial_value=-25.0)
    run = jax.jit(lambda key: hrl.train(env, learner, key, 2))(jax.random.key(0))
    policy = hrl.Learned(env, learner, run.learned).policy()
    first = hrl.rollout(env, policy, max_steps=3)
    assert hrl.rollout(env, policy, max_steps=3).table.identical(first.table)
    assert repr(first) == "<Rollout on Bus: 3 steps, return -3, left>"

    class Turning:
        """Takes every action in turn."""

        def reset(self) -> None:
            self.steps = -1

        def __call__(self, state: int) -> int:
            self.steps += 1
            return self.steps % env.num_actions

    turning = Turning()
    for _ in range(2):
        assert hrl.rollout(env, turning, max_steps=6).table["action"].values.tolist() == [0, 1, 2, 3, 0, 1]


def test_an_episode_is_cut_off_by_the_numbers_of_the_environment():
    env = hrl.make("Taxi")
    table = hrl.rollout(env, lambda state: 0, params=env.default_params._replace(max_steps=4)).table
    assert (table.sizes["step"], bool(table["terminated"]), bool(table["truncated"])) == (4, False, True)


def test_a_film_has_a_picture_of_every_state(tmp_path):
    env = hrl.make("Maze")
    rolled = hrl.rollout(env, best_policy(env), max_steps=3)
    rolled.film(tmp_path / "maze.gif", fps=2)
    with Image.open(tmp_path / "maze.gif") as film:
        assert (film.n_frames, film.info["duration"]) == (4, 500)


@pytest.mark.slow
def test_mario_is_played_by_a_function_of_its_state():
    env = hrl.make("Mario")
    rolled = hrl.rollout(env, lambda state: env.num_actions - 1, max_steps=2)
    assert "state" not in rolled.table
    assert int(rolled.states[-1].time) == 2


@pytest.mark.parametrize("name", ["Bus", "Taxi"])
def test_it_is_the_episode_of_the_gymnasium_environment_with_that_key(name: str, monkeypatch):
    env = hrl.make(name)
    policy, key = best_policy(env), jax.random.key(11)
    rolled = hrl.rollout(env, policy, key)
    monkeypatch.setattr("hrljax.interop.episodes.draw_key", lambda generator: np.asarray(jax.random.key_data(key)))
    gym = SingleEnv(env)
    observation, _ = gym.reset(seed=0)
    rewards, is_over = [], False
    while not is_over:
        observation, reward, terminated, truncated, _ = gym.step(policy[observation])
        rewards.append(reward)
        is_over = terminated or truncated
    np.testing.assert_array_equal(rolled.table["reward"], np.array(rewards, np.float32))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"policy": np.zeros(3, int)}, ValueError, r"policy must be a function, or integers of shape \(2304,\)"),
        ({"policy": lambda state: 4}, ValueError, "policy: action must be an integer from 0 to 3, got 4"),
        ({"policy": lambda state: "north"}, TypeError, "policy: action must be an integer"),
        ({"key": -1}, ValueError, "key must be an integer from 0"),
        ({"key": "a"}, TypeError, "key must be a new-style key"),
        ({"max_steps": 0}, ValueError, "max_steps must be an integer from 1"),
        ({"env": "Bus"}, TypeError, "env must be an environment"),
    ],
)
def test_bad_arguments_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        hrl.rollout(**{"env": hrl.make("Bus"), "policy": lambda state: 0, **arguments})
