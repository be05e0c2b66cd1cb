"""One run: an environment, a learner and a key give what was learned and its curve."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax import forks, random, tally
from hrljax.envs.base import Environment, TabularEnvironment, concrete_params
from hrljax.learners.base import Experience, Learner, LearnerState, Moment, tabulated
from hrljax.numerics import opaque_zero
from hrljax.simulation import simulator
from hrljax.tally import BLOCK

_BEGIN_STREAM = 2

Env = Environment[Any, Any]
Evaluate = Callable[[Any], Array]


class Run(NamedTuple):
    """Result of one run."""

    learned: Any  # the learner's tables after the last episode
    metrics: dict[str, Array]  # each [bins] float32: mean per episode, in bins of episodes
    greedy_return: Array  # [checkpoints] float32: exact value of the greedy policy
    steps: Array  # int32: primitive steps of the whole run


class _Loop(NamedTuple):
    """What changes from stretch to stretch."""

    learner: LearnerState
    state: Any  # the environment's state; its number (int32) if it is tabular
    time: Array  # int32 steps taken in this episode
    episode: Array  # int32 episodes finished
    reward: Array  # float32, over the bin
    events: Array  # [events] float32, over the bin
    truncated: Array  # int32 truncated episodes, over the bin
    is_over: Array  # bool: the episode has just ended


class _Stretch(NamedTuple):
    """What changes from step to step. A native loop pays for every entry, so there are few."""

    learner: LearnerState
    state: Any
    reward: Array
    tally: Any  # see `hrljax.tally`


def _select(condition: Array, these: Any, those: Any) -> Any:
    return jax.tree.map(lambda a, b: lax.select(jnp.broadcast_to(condition, a.shape), a, b), these, those)


def _zero(loop: _Loop) -> Array:
    """A zero that no compiler folds, even where the key is a constant: it knows nothing of the state."""
    if isinstance(loop.state, Array):
        return opaque_zero(loop.state.astype(jnp.uint32))
    return opaque_zero(lax.bitcast_convert_type(loop.reward, jnp.uint32))


def _small(loop: _Loop) -> tuple[Any, ...]:
    return (loop.learner.control, *loop[1:])


def _with(loop: _Loop, small: tuple[Any, ...]) -> _Loop:
    return _Loop(LearnerState(loop.learner.tables, small[0]), *small[1:])


def metric_names(env: Env) -> tuple[str, ...]:
    """Names of the entries of `Run.metrics`, per episode.

    Return, length (steps), the environment's events, and truncated: 1 if the episode was cut off by
    the limit of steps.
    """
    return ("return", "length", *env.metrics, "truncated")


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
        env: an environment; a tabular one if the learner is.
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
    params = concrete_params(env.default_params if params is None else params)
    return _Trainer(env, tabulated(learner, num_episodes), key, params, num_episodes, lockstep).run(
        bin_size or default_bin_size(num_episodes), evaluate_every
    )


def check_arguments(
    env: object, learner: object, num_episodes: object, bin_size: object, evaluate_every: object
) -> None:
    """Raises for what `train` could not run, naming the argument, the value and what is allowed."""
    forks.check_not_forked()
    if not isinstance(env, Environment):
        raise TypeError(f"env must be an environment such as hrljax.make('Bus'), got {env!r}")
    if not isinstance(learner, Learner):
        raise TypeError(f"learner must be a learner such as hrljax.QLearning(), got {learner!r}")
    if isinstance(env, TabularEnvironment):
        if env.num_states >= 1 << (30 - len(env.metrics)):
            raise ValueError(f"env has {env.num_states} states, too many to number them together with its events")
    elif learner.is_tabular:
        raise TypeError(f"env must be a tabular environment such as hrljax.make('Bus') for {learner.name}, got {env!r}")
    elif evaluate_every is not None:
        raise ValueError(f"evaluate_every needs a tabular environment, got {env!r}")
    check_count("num_episodes", num_episodes)
    if bin_size is not None:
        check_count("bin_size", bin_size)
    if evaluate_every is not None:
        check_count("evaluate_every", evaluate_every)


def check_count(name: str, value: object, least: int = 1) -> None:
    """Raises unless `value` is an integer of at least `least` that fits in 31 bits."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not least <= value < 2**31:
        raise ValueError(f"{name} must be an integer of at least {least}, got {value!r}")


class _Trainer:
    """The training loop of one run, as nested loops: bins, plans, blocks of random words, stretches, steps."""

    def __init__(self, env: Env, learner: Learner, key: Array, params: Any, num_episodes: int, lockstep: bool):
        self.env, self.learner, self.params = env, learner, params
        self.num_episodes, self.lockstep = num_episodes, lockstep
        self.key = random.key_words(key)
        self.prepared = learner.prepare(env)
        self.simulator = simulator(env, params, learner.num_words)

    def run(self, bin_size: int, evaluate_every: int | None) -> Run:
        sizes = bin_sizes(self.num_episodes, bin_size)
        state = self.learner.init(self.env, self.prepared)
        zero = jnp.int32(0)
        control, first = self._begin(
            state.tables, zero, Moment(zero, jnp.bool_(True), opaque_zero(self.key[0]), self.lockstep)
        )
        start = (_Loop(state._replace(control=control), first, zero, zero, *self._nothing(), jnp.bool_(False)), zero)

        def run_bin(carry: tuple[_Loop, Array], number: Array) -> tuple[tuple[_Loop, Array], tuple[Any, Array]]:
            end = jnp.minimum((number + 1) * bin_size, self.num_episodes)
            before = carry[1]
            loop, steps = lax.while_loop(lambda c: c[0].episode < end, lambda c: self._between_plans(*c, end), carry)
            sums = (loop.reward, loop.events, loop.truncated)
            reward, events, truncated = self._nothing()
            loop = loop._replace(reward=reward, events=events, truncated=truncated)
            return (loop, steps), (sums, steps - before)

        def run_stretch(carry: tuple[_Loop, Array], numbers: Array) -> tuple[tuple[_Loop, Array], Any]:
            carry, sums = lax.scan(run_bin, carry, numbers)
            return carry, (sums, self._evaluate(carry[0]))

        numbers = jnp.arange(len(sizes), dtype=jnp.int32)
        values = jnp.zeros(0, jnp.float32)
        if evaluate_every is None:
            (loop, steps), sums = lax.scan(run_bin, start, numbers)
        else:
            whole = len(sizes) // evaluate_every * evaluate_every
            carry, (sums, values) = lax.scan(run_stretch, start, numbers[:whole].reshape(-1, evaluate_every))
            (loop, steps), rest = lax.scan(run_bin, carry, numbers[whole:])
            sums = jax.tree.map(lambda a, b: jnp.concatenate([lax.collapse(a, 0, 2), b]), sums, rest)
        # Opaque, because XLA would multiply by the rounded reciprocal of a constant.
        episodes = (jnp.asarray(sizes, jnp.int32) + _zero(loop).astype(jnp.int32)).astype(jnp.float32)
        (reward, events, truncated), length = sums
        columns = [reward, length.astype(jnp.float32), *events.T, truncated.astype(jnp.float32)]
        metrics = {name: column / episodes for name, column in zip(metric_names(self.env), columns, strict=True)}
        return Run(loop.learner.tables, metrics, values, steps)

    def _evaluate(self, loop: _Loop) -> Array:
        return self.learner.greedy_return(self.env, self.prepared, loop.learner.tables, self.params, _zero(loop))

    def _nothing(self) -> tuple[Array, Array, Array]:
        """Reward, events and truncated episodes of a bin before its first step."""
        return jnp.float32(0), jnp.zeros(len(self.env.metrics), jnp.float32), jnp.int32(0)

    def _between_plans(self, loop: _Loop, steps: Array, end: Array) -> tuple[_Loop, Array]:
        """Plans if it is time to, and runs episodes until it is time again or `end` is reached."""
        interval = self.learner.planning_interval
        if interval:
            moment = Moment(loop.episode, jnp.bool_(True), _zero(loop), self.lockstep)
            tables = moment.when(
                loop.episode % interval == 0,
                lambda tables, now: self.learner.plan(self.prepared, tables, now),
                loop.learner.tables,
            )
            loop = loop._replace(learner=loop.learner._replace(tables=tables))
            end = jnp.minimum(end, (loop.episode // interval + 1) * interval)
        return lax.while_loop(lambda c: c[0].episode < end, lambda c: self._block(*c, end), (loop, steps))

    def _block(self, loop: _Loop, steps: Array, end: Array) -> tuple[_Loop, Array]:
        """Up to a block of steps, none after `end` episodes; `steps` counts those of the whole run."""
        words = self.simulator.block(self.key, steps.astype(jnp.uint32))

        def alone(carry: tuple[_Loop, Array]) -> tuple[_Loop, Array]:
            """Steps to the end of the episode or of the block."""
            loop, taken = self._stretch(*carry, words, jnp.bool_(True))
            small = lax.cond(loop.is_over, lambda: _small(self._next_episode(loop)), lambda: _small(loop))
            return _with(loop, small), taken

        def in_lockstep(_: Array, carry: tuple[_Loop, Array]) -> tuple[_Loop, Array]:
            """One step, which other runs take at the same time, and then perhaps the next beginning."""
            live = carry[0].episode < end
            loop, taken = self._stretch(*carry, words, live)
            small = _select(loop.is_over, _small(self._next_episode(loop)), _small(loop))
            return _with(loop, _select(live, small, _small(carry[0]))), lax.select(live, taken, carry[1])

        start = (loop, jnp.int32(0))
        if self.lockstep:
            loop, taken = lax.fori_loop(0, BLOCK, in_lockstep, start)
        else:
            loop, taken = lax.while_loop(lambda c: (c[1] < BLOCK) & (c[0].episode < end), alone, start)
        return loop, steps + taken

    def _stretch(self, loop: _Loop, taken: Array, words: Any, live: Array) -> tuple[_Loop, Array]:
        """Steps to the end of the episode or of the block; in lockstep one, or none if not `live`.

        `taken` counts those of the block.
        """
        counter, left = self.simulator.counter, jnp.minimum(BLOCK - taken, self.params.max_steps - loop.time)
        moment = Moment(loop.episode, live, _zero(loop), self.lockstep)
        start = _Stretch(loop.learner, loop.state, loop.reward, counter.start(taken, left, loop.events))
        if self.lockstep:
            after = self._step(start, words, moment)
        else:
            after = lax.while_loop(lambda s: tally.goes_on(s.tally), lambda s: self._step(s, words, moment), start)
        now, terminated, events = counter.read(after.tally, loop.events)
        time = loop.time + now - taken
        truncated = ~terminated & (time >= self.params.max_steps)
        loop = loop._replace(
            learner=after.learner,
            state=after.state,
            time=time,
            reward=after.reward,
            events=events,
            truncated=loop.truncated + truncated.astype(jnp.int32),
            is_over=terminated | truncated,
        )
        return loop, now

    def _next_episode(self, loop: _Loop) -> _Loop:
        episode = loop.episode + 1
        moment = Moment(episode, jnp.bool_(True), _zero(loop), self.lockstep)
        control, first = self._begin(loop.learner.tables, episode, moment)
        return loop._replace(
            learner=loop.learner._replace(control=control),
            state=first,
            time=jnp.int32(0),
            episode=episode,
            is_over=jnp.bool_(False),
        )

    def _step(self, now: _Stretch, words: Any, moment: Moment) -> _Stretch:
        """One primitive step, or none if not ``moment.live``."""
        position = tally.position(now.tally)
        action = self.learner.action(now.learner.control)
        step = self.simulator.step(now.state, action, words, position)
        seen = Experience(now.state, action, step.reward, step.next_state, step.terminated)
        own = self.simulator.learner_words(words, position)
        learned = self.learner.learn(self.prepared, now.learner, seen, own, moment)
        return _Stretch(learned, step.next_state, now.reward + step.reward, tally.add(now.tally, step.change))

    def _begin(self, tables: Any, episode: Array, moment: Moment) -> tuple[Any, Array]:
        """The learner's control and the first state of an episode."""
        own = self.env.num_initial_words
        words = random.words(self.key, episode.astype(jnp.uint32), own + self.learner.num_begin_words, _BEGIN_STREAM)
        first = self.env.initial(words[:own], self.params)
        if isinstance(self.env, TabularEnvironment):
            first = self.env.encode(first)
        # The last episode is followed by a beginning that no one uses; schedules end with the run.
        moment = moment._replace(episode=jnp.minimum(episode, self.num_episodes - 1))
        return self.learner.begin(self.prepared, tables, first, words[own:], moment), first
