"""The vector environment: equal to single ones, step by step, in every autoreset mode."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import hrljax as hrl
from hrljax.interop import episodes
from hrljax.interop.gymnasium import BatchedEnv, SingleEnv
from tests.interop.walker import Walker
from tests.maps import SMALL

N = 5
WRECKING = {"max_steps": 12, "breakdown_probability": 1.0, "road_change_probability": 0.5}
"""So that episodes end both ways within few steps."""

each_mode = pytest.mark.parametrize("mode", AutoresetMode)


def pair(mode: AutoresetMode, env_id: str, count: int = N, **kwargs: Any) -> tuple[gymnasium.vector.VectorEnv, ...]:
    sync = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    ours = gymnasium.make_vec(env_id, count, autoreset_mode=mode, **kwargs)
    theirs = gymnasium.make_vec(env_id, count, **sync, **kwargs)
    assert isinstance(ours, BatchedEnv)
    assert isinstance(theirs, gymnasium.vector.SyncVectorEnv)
    return ours, theirs


def same(ours: Any, theirs: Any) -> bool:
    """Equal in every value, type and dtype."""
    return data_equivalence(ours, theirs, exact=True)


def assert_walks_agree(mode: AutoresetMode, envs: tuple[Any, ...], num_actions: int, steps: int = 40) -> np.ndarray:
    """Returns how many episodes ended in either way."""
    ours, theirs = envs
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata == theirs.metadata
    assert same(ours.reset(seed=11), theirs.reset(seed=11))
    actions, ends = np.random.default_rng(2), np.zeros(2, int)
    for _ in range(steps):
        action = actions.integers(0, num_actions, ours.num_envs)
        mine, its = ours.step(action), theirs.step(action)
        assert same(mine, its)
        assert mine[0] in ours.observation_space
        _, _, terminated, truncated, _ = mine
        ends += terminated.sum(), truncated.sum()
        if mode == AutoresetMode.DISABLED and (terminated | truncated).any():
            mask = terminated | truncated
            assert same(ours.reset(options={"reset_mask": mask}), theirs.reset(options={"reset_mask": mask.copy()}))
    return ends


@each_mode
def test_steps_infos_and_ends_are_those_of_single_environments(mode: AutoresetMode):
    ends = assert_walks_agree(mode, pair(mode, "hrljax/Bus-v0", map=SMALL.map, params=WRECKING), 4)
    assert ends.min() >= 3


QUICK: dict[str, dict[str, Any]] = {
    "BoyanChain": {"length": 12, "params": {"max_steps": 9}},
    "Bus": {"params": {"max_steps": 9, "breakdown_probability": 1.0, "road_change_probability": 0.5}},
    "Gridworld": {"map": "cliff", "params": {"max_steps": 9, "slip_probability": 0.5}},
    "Maze": {"params": {"max_steps": 9, "slip_probability": 0.5}},
    "Taxi": {"stochastic": True, "fickle": True, "params": {"max_steps": 9}},
    "Mario": {"params": {"max_steps": 3}},
}
"""Options and numbers with which episodes are short and full of chance."""


@pytest.mark.parametrize("name", [name for name in hrl.registered() if name != "Mario"])
@pytest.mark.parametrize(
    "mode",
    [mode if mode == AutoresetMode.NEXT_STEP else pytest.param(mode, marks=pytest.mark.slow) for mode in AutoresetMode],
)
def test_every_environment_is_batched_as_it_is_alone(mode: AutoresetMode, name: str):
    env_id = f"hrljax/{name}-v0"
    num_actions = gymnasium.make(env_id).action_space.n
    ends = assert_walks_agree(mode, pair(mode, env_id, **QUICK[name]), num_actions, 25)
    assert ends[1] >= 3


@pytest.mark.slow
def test_mario_is_batched_as_he_is_alone(quick_compiler: None):
    """In the mode that does the most: a program of his takes half a minute to compile."""
    actions, mode = hrl.make("Mario").num_actions, AutoresetMode.SAME_STEP
    ends = assert_walks_agree(mode, pair(mode, "hrljax/Mario-v0", **QUICK["Mario"], count=2), actions, 7)
    assert ends[0] >= 2  # Mario dies when his time is up


@each_mode
def test_observations_that_are_trees_and_infos_that_are_numbers(mode: AutoresetMode, walker_id: str):
    ends = assert_walks_agree(mode, pair(mode, walker_id, params={"max_steps": 3, "far": 1.2}), 2)
    assert ends.min() >= 3


def test_an_environment_without_events_has_empty_infos():
    mode = AutoresetMode.SAME_STEP
    ends = assert_walks_agree(mode, pair(mode, "hrljax/Maze-v0", params={"max_steps": 4}), 3, 12)
    assert ends[1] > 0


def test_single_environments_with_the_seeds_of_the_batch_go_through_its_states():
    """Not by way of Gymnasium's own vector environment."""
    batch, singles = BatchedEnv(SMALL, N, params=WRECKING, autoreset_mode="SameStep"), []
    obs, _ = batch.reset(seed=[7, 3, None, 100, 7])
    for seed in (7, 3, 100):
        singles.append(SingleEnv(SMALL, params=WRECKING))
        singles[-1].reset(seed=seed)
    actions = np.random.default_rng(4)
    for _ in range(25):
        action = actions.integers(0, 4, N)
        action[4] = action[0]
        obs, reward, terminated, truncated, infos = batch.step(action)
        assert obs[0] == obs[4]
        for single, i in zip(singles, (0, 1, 3), strict=True):
            seen, *outcome, info = single.step(action[i])
            assert outcome == [reward[i], terminated[i], truncated[i]]
            if terminated[i] or truncated[i]:
                assert infos["final_obs"][i] == seen
                assert {name: infos["final_info"][name][i] for name in info} == info
                seen, _ = single.reset()
            else:
                assert {name: infos[name][i] for name in info} == info
            assert obs[i] == seen


@each_mode
def test_a_mask_resets_some_and_leaves_the_others(mode: AutoresetMode):
    ours, theirs = pair(mode, "hrljax/Bus-v0", map=SMALL.map, params=WRECKING)
    assert same(ours.reset(seed=1), theirs.reset(seed=1))
    mask = np.array([True, False, False, True, False])
    for seed in (None, 9, [1, 2, 3, 4, 5]):
        action = np.full(N, 2)
        assert same(ours.step(action), theirs.step(action))
        options = {"reset_mask": mask}
        assert same(ours.reset(seed=seed, options=options), theirs.reset(seed=seed, options=dict(options)))
        assert list(options) == ["reset_mask"]
    assert same(ours.step(np.full(N, 1)), theirs.step(np.full(N, 1)))


def test_a_mask_takes_the_place_of_the_reset_that_is_due():
    envs = pair(AutoresetMode.NEXT_STEP, "hrljax/Maze-v0", params={"max_steps": 2})
    for env in envs:
        env.reset(seed=0)
        env.step(np.zeros(N, int))
        env.step(np.zeros(N, int))
        env.reset(options={"reset_mask": np.array([True] + [False] * (N - 1))})
    ours, theirs = (env.step(np.zeros(N, int)) for env in envs)
    assert same(ours, theirs)
    assert ours[1].tolist() == [-1.0] + [0.0] * (N - 1)


def test_without_autoreset_an_episode_that_is_over_needs_a_reset():
    env = gymnasium.make_vec("hrljax/Maze-v0", 2, autoreset_mode="Disabled", params={"max_steps": 1})
    with pytest.raises(ResetNeeded, match="call reset first"):
        env.step(np.zeros(2, int))
    env.reset(seed=0)
    env.step(np.zeros(2, int))
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded, match=r"environments \[1\] are over"):
        env.step(np.zeros(2, int))


def test_gymnasiums_statistics_are_those_of_the_episodes():
    env = RecordEpisodeStatistics(gymnasium.make_vec("hrljax/Maze-v0", 3, params={"max_steps": 4}))
    env.reset(seed=0)
    for _ in range(4):
        *_, infos = env.step(np.zeros(3, int))
    assert infos["episode"]["r"].tolist() == [-4.0] * 3
    assert infos["episode"]["l"].tolist() == [4] * 3


def test_a_limit_of_gymnasiums_own_truncates_earlier():
    for limit, expected in ((3, 3), (99, 4)):
        env = gymnasium.make_vec("hrljax/Maze-v0", 2, max_episode_steps=limit, params={"max_steps": 4})
        assert env.unwrapped.params.max_steps == expected


def test_the_batched_step_is_compiled_once():
    before = episodes.advance_all._cache_size()
    env = BatchedEnv(SMALL, 4, params={"max_steps": 77})
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(4, int))
        env.reset()
    assert episodes.advance_all._cache_size() == before + 1


def test_pictures_of_all_environments():
    env = gymnasium.make_vec("hrljax/Maze-v0", 2, render_mode="ansi")
    with pytest.raises(ResetNeeded, match="render needs states"):
        env.render()
    env.reset(seed=3)
    single = SingleEnv("Maze", render_mode="ansi")
    frames = env.render()
    for seed, frame in zip((3, 4), frames, strict=True):
        single.reset(seed=seed)
        assert frame == single.render()
    with pytest.warns(UserWarning, match="render needs a render_mode"):
        assert BatchedEnv("Maze", 2).render() is None


def test_bad_input_is_refused():
    for count, error in ((0, ValueError), (1.5, TypeError), (True, TypeError)):
        with pytest.raises(error, match=f"num_envs must be an integer from 1 to 2147483647, got {count}"):
            BatchedEnv("Maze", count)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="max_episode_steps must be an integer from 1 to 2147483647, got 0"):
        BatchedEnv("Maze", 2, max_episode_steps=0)
    with pytest.raises(TypeError, match=r"max_episode_steps must be an integer from 1 to 2147483647, got 2.5"):
        BatchedEnv("Maze", 2, max_episode_steps=2.5)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"seed must be an integer, a sequence of integers or None, got 1.5"):
        BatchedEnv("Maze", 2).reset(seed=1.5)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="'sometimes' is not a valid AutoresetMode"):
        BatchedEnv("Maze", 2, autoreset_mode="sometimes")
    with pytest.raises(ValueError, match="Walker has no pictures, for it has no renderer; got the render mode 'ansi'"):
        BatchedEnv(Walker(), 2, render_mode="ansi")
    env = BatchedEnv(SMALL, 2)
    with pytest.raises(ResetNeeded, match="reset all environments"):
        env.reset(options={"reset_mask": np.array([True, False])})
    env.reset(seed=0)
    for actions in ([0], [0.5, 1.0], [[0, 1]]):
        with pytest.raises(ValueError, match="actions must be 2 integers, got"):
            env.step(actions)
    with pytest.raises(ValueError, match="actions must be from 0 to 3, got 0 to 4"):
        env.step([0, 4])
    with pytest.raises(ValueError, match="seed must have one entry for each of 2 environments, got 3"):
        env.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match="options must be empty or have reset_mask, got mask"):
        env.reset(options={"mask": 1})
    for mask in ([True, False], np.array([1, 0])):
        with pytest.raises(TypeError, match="must be a NumPy array of bool"):
            env.reset(options={"reset_mask": mask})
    for mask in (np.array([True]), np.array([False, False])):
        with pytest.raises(ValueError, match=r"must have shape \(2,\) and a True"):
            env.reset(options={"reset_mask": mask})
