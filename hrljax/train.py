"""One run: an environment, a learner and a key give what was learned and its curve."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from hrljax import random
from hrljax.envs.base import TabularEnvironment
from hrljax.learners.base import Experience, Learner, LearnerState, Moment, tabulated
from hrljax.numerics import opaque_zero, stage

_BEGIN_STREAM = 2
_BLOCK = 16
"""Steps whose random words are computed at once."""

Env = TabularEnvironment[Any, Any]
Evaluate = Callable[[Any], Array]


class Run(NamedTuple):
    """Result of one run."""

    learned: Any  # the learner's tables after the last episode
    metrics: dict[str, Array]  # each [bins] float32: mean per episode, in bins of episodes
    greedy_return: Array  # [checkpoints] float32: exact value of the greedy policy
    steps: Array  # int32: primitive steps of the whole run


class _Totals(NamedTuple):
    """Sums over the episodes of a bin."""

    reward: Array  # float32
    counts: tuple[Array, ...]  # int32: steps, then the events of the environment


class _Loop(NamedTuple):
    """What changes from step to step."""

    learner: LearnerState
    state: Array  # int32 number of the environment's state
    time: Array  # int32 steps taken in this episode
    episode: Array  # int32 episodes finished
    steps: Array  # uint32 steps of the whole run
    totals: _Totals


def metric_names(env: Env) -> tuple[str, ...]:
    """Names of the entries of `Run.metrics`: return, length (steps), and the environment's events."""
    return ("return", "length", *env.metrics)


def bin_sizes(num_episodes: int, bin_size: int) -> list[int]:
    """Episodes in each bin; only the last may be smaller."""
    full, rest = divmod(num_episodes, bin_size)
    return [bin_size] * full + [rest] * (rest > 0)


def default_bin_size(num_episodes: int) -> int:
    """The bin size that gives about 200 bins."""
    return max(1, num_episodes // 200)


def train(
    env: Env,
    learner: Learner,
    key: Array,
    num_episodes: int,
    *,
    params: Any = None,
    bin_size: int | None = None,
    evaluate_every: int | None = None,
    lockstep: bool = False,
) -> Run:
    """Trains a learner from scratch for a number of episodes. Pure, for one seed; jit and vmap it.

    Compiled by itself it is correct, but not fast on a CPU: `hrljax.sweep` and `hrljax.batch`
    compile it as a native loop.

    Args:
        env: a tabular environment.
        learner: what learns; its numbers may be traced.
        key: a single new-style key; consumed.
        num_episodes: at least 1.
        params: numbers of the environment, `env.default_params` if None; may be traced.
        bin_size: episodes in a bin of the metrics; about a 200th of the run if None.
        evaluate_every: evaluates the greedy policy exactly after every so many bins; never if None.
        lockstep: how the loop is built, not what it computes. True suits `vmap`, where all runs of
            a batch take their steps together; False suits one run.

    Raises:
        TypeError, ValueError: a bad argument, before anything is compiled.
    """
    check_arguments(env, learner, num_episodes, bin_size, evaluate_every)
    params = env.default_params if params is None else params
    return _Trainer(env, tabulated(learner, num_episodes), key, params, num_episodes, lockstep).run(
        bin_size or default_bin_size(num_episodes), evaluate_every
    )


def check_arguments(env: object, learner: object, num_episodes: object, bin_size: object, evaluate_every: object) -> None:
    """Raises for what `train` could not run, naming the argument, the value and what is allowed."""
    if not isinstance(env, TabularEnvironment):
        raise TypeError(f"env must be a tabular environment such as hrljax.make('Bus'), got {env!r}")
    if not isinstance(learner, Learner):
        raise TypeError(f"learner must be a learner such as hrljax.QLearning(), got {learner!r}")
    check_count("num_episodes", num_episodes)
    if bin_size is not None:
        check_count("bin_size", bin_size)
    if evaluate_every is not None:
        check_count("evaluate_every", evaluate_every)


def check_count(name: str, value: object, least: int = 1) -> None:
    """Raises unless `value` is an integer of at least `least` that fits in 31 bits."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value < 2**31:
        raise ValueError(f"{name} must be an integer of at least {least}, got {value!r}")


class _Trainer:
    """The training loop of one run, as nested loops: bins, plans, blocks of random words, steps."""

    def __init__(self, env: Env, learner: Learner, key: Array, params: Any, num_episodes: int, lockstep: bool):
        self.env, self.learner, self.params = env, learner, params
        self.num_episodes, self.lockstep = num_episodes, lockstep
        self.key = random.key_words(key)
        self.zero = opaque_zero(self.key[0])
        self.prepared = learner.prepare(env)
        self.transition = stage(self._transition)

    def run(self, bin_size: int, evaluate_every: int | None) -> Run:
        sizes = bin_sizes(self.num_episodes, bin_size)
        state = self.learner.init(self.env, self.prepared)
        zero = jnp.int32(0)
        control, first = self._begin(state.tables, zero, jnp.bool_(True))
        start = _Loop(state._replace(control=control), first, zero, zero, jnp.uint32(0), self._no_totals())

        def run_bin(loop: _Loop, number: Array) -> tuple[_Loop, _Totals]:
            end = jnp.minimum((number + 1) * bin_size, self.num_episodes)
            loop = lax.while_loop(lambda c: c.episode < end, lambda c: self._between_plans(c, end), loop)
            return loop._replace(totals=self._no_totals()), loop.totals

        def run_stretch(loop: _Loop, numbers: Array) -> tuple[_Loop, tuple[_Totals, Array]]:
            loop, totals = lax.scan(run_bin, loop, numbers)
            return loop, (totals, self._evaluate(loop.learner.tables))

        numbers = jnp.arange(len(sizes), dtype=jnp.int32)
        values = jnp.zeros(0, jnp.float32)
        if evaluate_every is None:
            loop, totals = lax.scan(run_bin, start, numbers)
        else:
            whole = len(sizes) // evaluate_every * evaluate_every
            loop, (totals, values) = lax.scan(run_stretch, start, numbers[:whole].reshape(-1, evaluate_every))
            loop, rest = lax.scan(run_bin, loop, numbers[whole:])
            totals = jax.tree.map(lambda a, b: jnp.concatenate([a.reshape(-1), b]), totals, rest)
        episodes = jnp.asarray(sizes, jnp.float32)
        sums = [totals.reward, *(count.astype(jnp.float32) for count in totals.counts)]
        metrics = {name: total / episodes for name, total in zip(metric_names(self.env), sums, strict=True)}
        return Run(loop.learner.tables, metrics, values, loop.steps.astype(jnp.int32))

    def _evaluate(self, tables: Any) -> Array:
        return self.learner.greedy_return(self.env, self.prepared, tables, self.params)

    def _no_totals(self) -> _Totals:
        return _Totals(jnp.float32(0), (jnp.int32(0),) * (1 + len(self.env.metrics)))

    def _between_plans(self, loop: _Loop, end: Array) -> _Loop:
        """Plans if it is time to, and runs episodes until it is time again or `end` is reached."""
        interval = self.learner.planning_interval
        if interval:
            moment = Moment(loop.episode, jnp.bool_(True), self.zero, self.lockstep)
            tables = lax.cond(
                loop.episode % interval == 0,
                lambda tables: self.learner.plan(self.prepared, tables, moment),
                lambda tables: tables,
                loop.learner.tables,
            )
            loop = loop._replace(learner=loop.learner._replace(tables=tables))
            end = jnp.minimum(end, (loop.episode // interval + 1) * interval)
        return lax.while_loop(lambda c: c.episode < end, lambda c: self._block(c, end), loop)

    def _block(self, loop: _Loop, end: Array) -> _Loop:
        """Up to `_BLOCK` steps, none after `end` episodes."""
        words = random.WordBlock(self.key, loop.steps, _BLOCK, self.env.num_words + self.learner.num_words)
        if self.lockstep:
            return lax.fori_loop(0, _BLOCK, lambda i, c: self._step(c, words[i], c.episode < end), loop)
        return lax.while_loop(
            lambda carry: (carry[0] < _BLOCK) & (carry[1].episode < end),
            lambda carry: (carry[0] + 1, self._step(carry[1], words[carry[0]], jnp.bool_(True))),
            (jnp.int32(0), loop),
        )[1]

    def _step(self, loop: _Loop, words: tuple[Array, ...], live: Array) -> _Loop:
        """One primitive step, or none if not `live`."""
        own = self.env.num_words
        action = self.learner.action(loop.learner.control)
        next_state, reward, terminated, events = self.transition(loop.state, action, words[:own])
        time = loop.time + 1
        done = terminated | (time >= self.params.max_steps)
        step = Experience(loop.state, action, reward, next_state, terminated)
        moment = Moment(loop.episode, live, self.zero, self.lockstep)
        learned = self.learner.learn(self.prepared, loop.learner, step, words[own:], moment)
        control, state, time = lax.cond(
            done,
            lambda: (*self._begin(learned.tables, loop.episode + 1, live), jnp.int32(0)),
            lambda: (learned.control, next_state, time),
        )
        counts = (jnp.int32(1), *events)
        totals = _Totals(loop.totals.reward + reward, tuple(a + b for a, b in zip(loop.totals.counts, counts, strict=True)))
        episode, steps = loop.episode + done.astype(jnp.int32), loop.steps + 1
        small = (control, state, time, episode, steps, totals)
        if self.lockstep:
            before = (loop.learner.control, loop.state, loop.time, loop.episode, loop.steps, loop.totals)
            small = jax.tree.map(lambda new, old: lax.select(live, new, old), small, before)
        control, *rest = small
        return _Loop(LearnerState(learned.tables, control), *rest)

    def _transition(self, state: Array, action: Array, words: tuple[Array, ...]) -> tuple[Array, Array, Array, list[Array]]:
        after, reward, terminated, info = self.env.transition(self.env.decode(state), action, words, self.params)
        return self.env.encode(after), reward, terminated, [info[name] for name in self.env.metrics]

    def _begin(self, tables: Any, episode: Array, live: Array) -> tuple[Any, Array]:
        """The learner's control and the first state of an episode."""
        own = self.env.num_initial_words
        words = random.words(self.key, episode.astype(jnp.uint32), own + self.learner.num_begin_words, _BEGIN_STREAM)
        first = self.env.encode(self.env.initial(words[:own], self.params))
        # The run's last episode is followed by a beginning that no one uses; schedules end with the run.
        moment = Moment(jnp.minimum(episode, self.num_episodes - 1), live, self.zero, self.lockstep)
        return self.learner.begin(self.prepared, tables, first, words[own:], moment), first
