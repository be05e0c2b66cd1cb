"""Mario as an environment: contract, rewards, the end of an episode, settings and bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.mario.competition import ENDED, OBSERVED, PLAYING, Episode, unbegun
from hrljax.envs.mario.env import ALL_ACTIONS, THESIS_ACTIONS, Mario, MarioParams, _reward
from hrljax.envs.mario.levels.ascii import to_ascii
from hrljax.envs.mario.levels.generator import generate_level

ENV = Mario(seeds=(1247, 3, 4))
RIGHT_JUMP_SPEED = ENV.action_names.index("right jump speed")
KEY = jax.random.key(5)


class Compiled:
    """The environment's functions, compiled once for the whole file; numbers are arguments."""

    transition = staticmethod(jax.jit(lambda state, action, params: ENV.transition(state, action, (), params)))


NO_OP = ENV.action_names.index("no op")


def first(level: int = 0) -> Episode:
    """What `Mario.initial` returns, without compiling the engine another time."""
    return step(unbegun(ENV.course, level), NO_OP)[0]


def word_of(level: int) -> jax.Array:
    return jnp.uint32((level << 24) // 3 + (1 << 20))


def numbers(**changes: float) -> MarioParams:
    params = MarioParams()._replace(**changes)
    floats = {name: np.float32(value) for name, value in params._asdict().items() if name != "max_steps"}
    return params._replace(**floats, max_steps=np.int32(params.max_steps))


def step(state: Episode, action: int = RIGHT_JUMP_SPEED, **changes: float):
    state, reward, terminated, info = Compiled.transition(state, jnp.int32(action), numbers(**changes))
    return state, float(reward), bool(terminated), {name: bool(value) for name, value in info.items()}


@pytest.mark.slow
def test_the_first_observation():
    state = first()
    assert (int(state.time), int(state.phase), int(state.world.level)) == (0, PLAYING, 0)
    objects = ENV.objects(state)
    assert int(objects.present.sum()) == 1 + int(state.world.num_sprites)
    assert float(objects.x[0]) == 2.0
    assert float(objects.y[0]) == pytest.approx(14.4332185)
    screen = np.asarray(ENV.observation(state))
    assert ENV.observation_space.contains(screen)
    assert screen[1, 2] == ord("M")
    assert (screen == ord("M")).sum() == 1


def test_words_choose_every_level(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("hrljax.envs.mario.env.begin", lambda course, level, quantum: unbegun(course, level))
    levels = [int(ENV.initial((word_of(level),), MarioParams()).world.level) for level in range(3)]
    assert levels == [0, 1, 2]


@pytest.mark.slow
def test_an_episode_begins_with_a_step_without_keys():
    initial = jax.jit(lambda word: ENV.initial((word,), MarioParams()))
    for level in range(3):
        jax.tree.map(np.testing.assert_array_equal, initial(word_of(level)), first(level))


@pytest.mark.slow
def test_rewards_by_hand():
    state = first()
    after, reward, terminated, info = step(state, step_reward=-0.5, displacement_reward=2.0)
    moved = np.float32((after.world.player.x - state.world.player.x) / 16)
    assert moved > 0
    assert reward == np.float32(-0.5) + 2 * moved
    assert not terminated
    assert (info["win"], info["death"]) == (False, False)
    richer = state._replace(world=state.world._replace(coins=jnp.int32(3), kills=jnp.int32(2)))
    params = MarioParams(coin_reward=10.0, kill_reward=100.0, step_reward=-1.0)
    no = jnp.bool_(False)
    assert _reward(state, richer, params, ends=no, won=no) == 229
    assert _reward(state, richer, params, ends=~no, won=no) == -10


def play_to_the_end(state: Episode, **changes: float):
    """The last step of the episode of a policy that runs and jumps blindly, and the state before it."""
    for _ in range(400):
        before = state
        state, reward, terminated, info = step(state, **changes)
        if terminated:
            return before, state, reward, info
    raise AssertionError("the episode does not end")


@pytest.mark.slow
def test_nothing_changes_after_death():
    before, state, reward, info = play_to_the_end(first(), death_reward=-50.0)
    moved = float(state.world.player.x - before.world.player.x)
    assert reward == -50 or moved != 0
    assert (info["win"], info["death"]) == (False, True)
    assert int(state.phase) == OBSERVED
    again, reward, terminated, info = step(state, action=0, displacement_reward=1.0)
    assert (reward, terminated) == (0, True)
    assert not any(info.values())
    jax.tree.map(np.testing.assert_array_equal, again, state)


@pytest.mark.slow
def test_the_limit_of_steps_kills():
    state, reward, terminated, _ = step(first(), max_steps=2)
    assert (reward, terminated) == (np.float32(-0.01), False)
    state, reward, terminated, info = step(state, max_steps=2)
    assert (reward, terminated, info["death"], int(state.time)) == (-10, True, True, 2)
    assert int(state.world.player.death_time) == 2


def near_exit(x: float) -> Episode:
    state = first()
    player = state.world.player._replace(x=jnp.float32(x), y=jnp.float32(50), x_old=jnp.float32(x))
    return state._replace(world=state.world._replace(player=player))


@pytest.mark.slow
def test_reaching_the_exit_wins():
    state, reward, terminated, info = step(near_exit(16 * 318 - 1))
    assert (reward, terminated, info["win"], info["death"]) == (100, True, True, False)
    assert int(state.world.player.win_time) > 0


@pytest.mark.slow
def test_an_end_in_the_last_tick_of_a_step_is_told_by_the_next():
    for distance in np.arange(0.5, 40, 0.5):
        state, reward, terminated, info = step(near_exit(16 * 318 - distance), step_reward=-1.0)
        if int(state.phase) == ENDED:
            assert (reward, terminated, info["win"]) == (-1, False, False)
            after, reward, terminated, info = step(state, action=0)
            assert (reward, terminated, info["win"], int(after.phase)) == (100, True, True, OBSERVED)
            assert int(after.time) == 2
            jax.tree.map(np.testing.assert_array_equal, after.world, state.world)
            return
    raise AssertionError("no distance at which Mario wins in the last tick")


def test_actions():
    assert len(ALL_ACTIONS) == 12
    assert len(THESIS_ACTIONS) == 9
    assert set(ALL_ACTIONS) - set(THESIS_ACTIONS) == {(0, 0, 1), (0, 1, 1), (0, 0, 0)}
    assert ENV.action_names[:4] == ("left", "left speed", "left jump", "left jump speed")
    assert ENV.action_names[4] == "no op"
    thesis = hrl.make("Mario", preset="thesis")
    assert thesis.num_actions == 9
    assert "no op" not in thesis.action_names
    assert thesis.default_params == MarioParams(death_reward=-50.0, displacement_reward=1.0)
    assert Mario(preset="thesis", actions="all").num_actions == 12
    assert Mario().action_space.n == 12
    assert Mario() == Mario()
    assert hash(Mario()) == hash(Mario())


def test_levels_as_text():
    level = generate_level(9, 1, 5, 30)
    env = Mario(levels=(to_ascii(level),))
    np.testing.assert_array_equal(env.course.tiles[0], level.tiles.ravel())
    assert int(env.course.exit_column[0]) == level.exit_column


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"level_type": 3}, "level_type must be .*got 3"),
        ({"difficulty": -1}, "difficulty must be .*got -1"),
        ({"width": 10}, "width must be .*got 10"),
        ({"seeds": ()}, "1 to 65536 levels, got 0"),
        ({"preset": "hard"}, "preset must be one of 'competition', 'thesis', got 'hard'"),
        ({"actions": "some"}, "actions must be one of None, 'all', 'thesis', got 'some'"),
        ({"quantum": 3}, "quantum must be one of None, 1, 2, .*got 3"),
        ({"levels": ("type: castle",)}, "."),
    ],
)
def test_bad_options(options: dict, text: str):
    with pytest.raises(ValueError, match=text):
        Mario(**options)


@pytest.mark.slow
def test_bad_actions():
    state = first()
    for action, error, text in [
        (jnp.zeros(2, jnp.int32), TypeError, r"action must be an integer from 0 to 11, got Array\(\[0, 0\]"),
        (jnp.float32(1), TypeError, "action must be an integer from 0 to 11, got 1.0"),
        (jnp.int32(12), ValueError, "action must be an integer from 0 to 11, got 12"),
    ]:
        with pytest.raises(error, match=text):
            ENV.transition(state, action, (), MarioParams())


def test_types_are_stable():
    state = first()
    after = step(state)[0]
    described = [jax.tree.map(lambda a: (a.shape, a.dtype, a.weak_type), s) for s in (state, after)]
    assert described[0] == described[1]
    assert not any(a.weak_type for a in jax.tree.leaves(state))
    assert {a.dtype.name for a in jax.tree.leaves(state)} == {"float32", "int32", "uint8", "bool"}
