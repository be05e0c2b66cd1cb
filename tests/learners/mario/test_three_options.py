"""A master over three options: what its description says, and its update by hand."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.core.random import WORD_RANGE
from hrljax.envs.mario.competition import Episode, unbegun
from hrljax.envs.mario.env import Mario
from hrljax.learners.base import LearnerState, Transition
from hrljax.learners.mario.three_options import OPTIONS, Pits, ThreeOptions, situation
from tests.contexts import learning

WIDTH = 40
SARSA, SPECIALIST, RULES = range(len(OPTIONS))


def level() -> str:
    """Ground with a pit at columns 20 and 21, and a wall at column 30."""
    rows = [["."] * WIDTH for _ in range(15)]
    for row in (13, 14):
        rows[row] = ["." if column in (20, 21) else "#" for column in range(WIDTH)]
    rows[12][30] = "%"
    things = [["."] * WIDTH for _ in range(15)]
    things[12][38] = "!"
    return "\n".join(["type: overground", *map("".join, rows), "", *map("".join, things)])


ENV = Mario(levels=(level(),), preset="thesis")
AGENT = ThreeOptions(step_size=0.5, epsilon=0.0, discount=0.5, trace_length=3)
PREPARED = AGENT.prepare(ENV)
START = AGENT.init(ENV, PREPARED)


def at(column: int, speed: float = 0.0, on_ground: bool = True) -> Episode:
    """Mario in the middle of a column, at some tiles a step."""
    episode = unbegun(ENV.course, 0)
    x = jnp.float32(16 * column + 8)
    player = episode.world.player._replace(
        x=x, x_old=x - np.float32(speed * 16 / 5), y=jnp.float32(13 * 16 - 1), on_ground=jnp.bool_(on_ground)
    )
    return episode._replace(world=episode.world._replace(player=player, num_sprites=jnp.int32(0)))


@jax.jit
def described(episode: Episode):
    return situation(ENV, episode), Pits().held(ENV, episode)[0][0]


@jax.jit
def learn(state: LearnerState, transition: Transition, word: jax.Array):
    return AGENT.learn(PREPARED, state, transition, (word, word, word), learning())


def step(state: LearnerState, before: Episode, after: Episode, reward: float, ends: bool = False, word: int = 0) -> Any:
    action = AGENT.action(state.control)
    told = Transition(before, action, jnp.float32(reward), after, jnp.bool_(ends))
    return learn(state, told, jnp.uint32(word))


@pytest.mark.parametrize(
    ("episode", "number", "pit", "concept"),
    [
        (at(10), 0b0001, False, (5 * 2 + 1) * 4),
        (at(15), 0b0001, False, (5 * 2 + 1) * 4),
        (at(16, speed=2.5), 0b1001, True, (4 * 2 + 1) * 4 + 2),
        (at(20, on_ground=False, speed=9.0), 0b1000, True, 0 * 4 + 3),
        (at(25, speed=-3.0), 0b1001, True, (5 * 2 + 1) * 4),
        (at(26), 0b0001, False, (5 * 2 + 1) * 4),
        (at(28), 0b0101, False, (5 * 2 + 1) * 4),
    ],
)
def test_what_the_master_and_the_specialist_know(episode: Episode, number: int, pit: bool, concept: int):
    (known, is_near), held = described(episode)
    assert (int(known), bool(is_near), int(held)) == (number, pit, concept)
    assert 0 <= concept < Pits.num


def test_an_option_is_worth_what_it_earned_and_what_it_led_to():
    master = np.zeros((16, 3), np.float32)
    master[0b1001] = [3, 8, 4]
    master[0b0001] = [1, 99, 2]
    state = START._replace(
        tables=START.tables._replace(master=jnp.asarray(master.ravel())),
        control=START.control._replace(option=jnp.int32(RULES), situation=jnp.int32(0b0001)),
    )
    state = step(state, at(10), at(13), reward=1)
    assert np.array_equal(state.tables.master, master.ravel())
    assert int(state.control.option) == RULES
    state = step(state, at(13), at(16), reward=6)
    # Towards 1 + g 6 + g^2 8, with g = 1/2: the pit is near, so the specialist counts.
    master[0b0001, RULES] = 2 + 0.5 * (1 + 3 + 2 - 2)
    assert np.array_equal(state.tables.master, master.ravel())
    assert (int(state.control.option), int(state.control.situation)) == (SPECIALIST, 0b1001)
    after = step(state, at(16), at(10), reward=-2)
    # Back where no pit is near, the specialist is no option: 4 is the best.
    master[0b1001, SPECIALIST] = 8 + 0.5 * (-2 + 0.5 * 4 - 8)
    assert np.array_equal(after.tables.master, master.ravel())
    assert int(after.control.option) == RULES
    died = step(state, at(16), at(16), reward=-50, ends=True)
    assert float(died.tables.master.reshape(16, 3)[0b1001, SPECIALIST]) == 8 + 0.5 * (-50 - 8)


@pytest.mark.parametrize("option", [SARSA, SPECIALIST, RULES])
def test_an_option_learns_only_while_it_runs(option: int):
    state = START._replace(control=START.control._replace(option=jnp.int32(option), situation=jnp.int32(0b1001)))
    after = step(state, at(16), at(17), reward=4)
    for number, name in ((SARSA, "sarsa"), (SPECIALIST, "specialist")):
        changed = bool(np.any(getattr(after.tables, name).weights != getattr(START.tables, name).weights))
        assert changed == (number == option), name
    assert int(after.tables.sarsa.trail.length) == (option == SARSA)
    # A trail ends with its option: rules are worth more where no pit is near.
    rules = START.tables.master.at[0b0001 * 3 + RULES].set(1)
    gone_on = step(after._replace(tables=after.tables._replace(master=rules)), at(17), at(10), reward=0)
    assert int(gone_on.control.option) == RULES
    assert int(gone_on.tables.sarsa.trail.length) == 0


def test_the_specialist_is_called_only_near_a_pit():
    agent = ThreeOptions(epsilon=1.0)
    random = np.random.default_rng(0)

    @jax.jit
    def called(episode: Episode, words: jax.Array):
        def one(word: jax.Array):
            return agent.begin(PREPARED, START.tables, episode, (word, word, word), learning()).option

        return jax.lax.map(one, words)

    words = jnp.asarray(random.integers(WORD_RANGE, size=300), jnp.uint32)
    for column, options in ((10, {SARSA, RULES}), (17, {SARSA, SPECIALIST, RULES})):
        counts = np.bincount(np.asarray(called(at(column), words)), minlength=3)
        assert set(np.flatnonzero(counts).tolist()) == options
        assert counts[sorted(options)].min() > 300 / len(options) - 40


def test_another_environment_and_bad_numbers_are_refused():
    with pytest.raises(TypeError, match="env must be Mario"):
        ThreeOptions().prepare(hrl.make("Bus"))
    with pytest.raises(ValueError, match="trace_length must be an integer from 1"):
        ThreeOptions(trace_length=0)
