"""One run: an environment, a learner and a key give what was learned and its curve."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax import random
from hrljax.envs.base import TabularEnvironment
from hrljax.learners.base import Experience, Learner, Moment, tabulated
from hrljax.numerics import opaque_zero, put_row, stage, take_row

_EPISODE_STREAM = 2
_BLOCK = 16
"""Steps whose random words are computed at once; between blocks the loop looks whether it is done."""


class Run(NamedTuple):
    """Result of one run."""

    learner_state: Any
    metrics: dict[str, Array]  # each [bins] float32: mean per episode of the bin
    steps: Array  # int32 scalar: primitive steps of the whole run
    greedy_return: Array  # [checkpoints] float32, NaN-free: exact value of the greedy policy


class _Loop(NamedTuple):
    learner: Any
    state: Array  # int32 number of the environment's state
    time: Array  # int32 steps in this episode
    episode: Array  # int32 episodes finished
    steps: Array  # uint32 steps of the whole run
    sums: Array  # [bins * metrics] float32


def metric_names(env: TabularEnvironment[Any, Any]) -> tuple[str, ...]:
    """Names of what is counted for every episode."""
    return ("return", "length", *env.metrics)


def train(
    env: TabularEnvironment[Any, Any],
    learner: Learner,
    key: Array,
    num_episodes: int,
    *,
    params: Any = None,
    bin_size: int | None = None,
    block_length: int = _BLOCK,
) -> Run:
    raise NotImplementedError


def _train(env, learner, key, num_episodes, params, bin_size, block=_BLOCK):
    learner = tabulated(learner, num_episodes)
    prepared = learner.prepare(env)
    key_words = random.key_words(key)
    zero = opaque_zero(key_words[0])
    num_bins = -(-num_episodes // bin_size)
    names = metric_names(env)
    width = len(names)
    num_words = env.num_words + learner.num_words

    @stage
    def transition(state, time, action, words):
        before = env.decode(state)
        after, reward, terminated, info = env.transition(before, action, words, params)
        return env.encode(after), reward, terminated, [info[name] for name in env.metrics]

    def moment(loop, live):
        return Moment(loop.episode, live, zero)

    def begin(tables, episode, live):
        words = random.words(key_words, episode.astype(jnp.uint32), env.num_initial_words + learner.num_begin_words, _EPISODE_STREAM)
        first = env.encode(env.initial(words[: env.num_initial_words], params))
        at = Moment(jnp.minimum(episode, num_episodes - 1), live, zero)
        return learner.begin(prepared, tables, first, words[env.num_initial_words :], at), first

    def step(loop: _Loop, words, limit) -> _Loop:
        live = loop.episode < limit
        now = moment(loop, live)
        action = learner.action(loop.learner.control)
        next_state, reward, terminated, events = transition(loop.state, loop.time, action, words[: env.num_words])
        time = loop.time + 1
        done = terminated | (time >= params.max_steps)
        experience = Experience(loop.state, action, reward, next_state, terminated, done)
        learned = learner.learn(prepared, loop.learner, experience, words[env.num_words :], now)
        counts = [reward, jnp.float32(1), *(e.astype(jnp.float32) for e in events)]
        row_at = loop.episode // bin_size * width
        row = take_row(loop.sums, row_at, width)
        row = row + lax.select(jnp.broadcast_to(live, (width,)), jnp.stack(counts), jnp.zeros(width, jnp.float32))
        sums = put_row(loop.sums, row_at, row)
        episode = loop.episode + (done & live).astype(jnp.int32)
        control, state = lax.cond(done, lambda: begin(learned.tables, episode, live), lambda: (learned.control, next_state))
        return _Loop(learned._replace(control=control), state, lax.select(done, jnp.int32(0), time), episode, loop.steps + live.astype(jnp.uint32), sums)

    def run_block(loop, limit):
        words = random.WordBlock(key_words, loop.steps, block, num_words)
        return lax.fori_loop(0, block, lambda i, l: step(l, words[i], limit), loop)

    def segment(loop, limit):
        return lax.while_loop(lambda l: l.episode < limit, lambda l: run_block(l, limit), loop)

    state0 = learner.init(env, prepared)
    control, first = begin(state0.tables, jnp.int32(0), jnp.bool_(True))
    state0 = state0._replace(control=control)
    loop = _Loop(state0, first, jnp.int32(0), jnp.int32(0), jnp.uint32(0), jnp.zeros(num_bins * width, jnp.float32))
    interval = learner.planning_interval or num_episodes
    def seg(loop):
        if learner.planning_interval:
            loop = loop._replace(learner=loop.learner._replace(tables=learner.plan(prepared, loop.learner.tables, moment(loop, jnp.bool_(True)))))
        return segment(loop, jnp.minimum((loop.episode // interval + 1) * interval, num_episodes))
    loop = lax.while_loop(lambda l: l.episode < num_episodes, seg, loop)
    return loop.learner, loop.sums.reshape(num_bins, width), loop.steps
