"""Agents that others have described: what their descriptions say of them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.core.random import WORD_RANGE
from hrljax.envs.mario.competition import begin, unbegun
from hrljax.envs.mario.env import Mario
from hrljax.learners.base import LearnerState, Transition
from hrljax.learners.mario.nearest_things import NearestThingsSARSA
from hrljax.learners.mario.sample import SampleAgent, forward_actions
from hrljax.learners.relational.concepts import NearestThings
from tests.contexts import learning

ENV = Mario(seeds=(2,), difficulty=5, preset="thesis")


def trials(agent: SampleAgent, count: int, seed: int) -> list[list[int]]:
    """The actions of some trials, one after the other."""
    generator, prepared = np.random.default_rng(seed), agent.prepare(ENV)
    state, first = agent.init(ENV, prepared), jax.jit(lambda: begin(ENV.course, 0))()

    def word() -> jax.Array:
        return jnp.uint32(generator.integers(WORD_RANGE))

    @jax.jit
    def start(tables: Any, word: jax.Array):
        return agent.begin(prepared, tables, first, (word,), learning())

    @jax.jit
    def step(state: LearnerState, episode: Any, word: jax.Array):
        action = agent.action(state.control)
        after, reward, terminated, _ = ENV.transition(episode, action, (), ENV.default_params)
        told = Transition(episode, action, reward, after, terminated)
        return agent.learn(prepared, state, told, (word,), learning()), after, action, terminated

    played = []
    for _ in range(count):
        state = state._replace(control=start(state.tables, word()))
        episode, terminated, actions = first, False, []
        while not terminated:
            state, episode, action, terminated = step(state, episode, word())
            actions.append(int(action))
        played.append(actions)
    return played


@pytest.mark.slow
def test_the_sample_agent_replays_its_last_trial_but_for_seven_steps():
    played = trials(SampleAgent(epsilon=0.5), 5, seed=1)
    lefts = {i for i, (direction, *_) in enumerate(ENV.action_table) if direction < 0}
    for before, after in zip(played, played[1:], strict=False):
        kept = max(len(before) - 7, 0)
        assert after[:kept] == before[:kept]
    assert not lefts & {action for trial in played for action in trial}
    assert len({tuple(trial) for trial in played}) > 1
    assert max(map(len, played)) > 7


def test_forward_actions():
    assert [ENV.action_names[i] for i in forward_actions(ENV)] == [
        "jump", "right", "right speed", "right jump", "right jump speed",
    ]  # fmt: skip


def test_nearest_things_are_paid_for_every_ten_tiles():
    """The change of a weight is the step size times the reward, with 10 for each of two borders that were passed."""
    learner = NearestThingsSARSA(step_size=0.5, discount=0.0, epsilon=0.0, interval_reward=10.0)
    assert learner.concepts == NearestThings(3)
    prepared = learner.prepare(ENV)
    start = unbegun(ENV.course, 0)
    action = jnp.int32(4)

    @jax.jit
    def moved(x_before: jax.Array, x_after: jax.Array):
        def at(x: jax.Array) -> Any:
            world = start.world
            return start._replace(world=world._replace(player=world.player._replace(x=x)))

        told = Transition(at(x_before), action, jnp.float32(1), at(x_after), jnp.bool_(False))
        state = learner.init(ENV, prepared)
        return learner.learn(prepared, state, told, (jnp.uint32(0),), learning()).tables.weights

    bias = learner.concepts.num * ENV.num_actions + 4
    for before, after, reward in ((100, 159, 1), (100, 161, 11), (159, 321, 21), (161, 159, -9)):
        weights = np.asarray(moved(jnp.float32(before), jnp.float32(after)))
        assert weights[bias] == 0.5 * reward
        assert set(np.unique(weights)) <= {0, np.float32(0.5 * reward)}


def test_another_environment_and_bad_numbers_are_refused():
    with pytest.raises(TypeError, match="env must be Mario"):
        SampleAgent().prepare(hrl.make("Bus"))
    with pytest.raises(ValueError, match="forgotten must be an integer from 0"):
        SampleAgent(forgotten=-1)
    with pytest.raises(TypeError, match="concepts must be"):
        hrl.RelationalHORDQ(concepts="all")  # pyright: ignore[reportArgumentType]
