"""One run: an environment, a learner and a key give what was learned and its curve."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.core import Tracer

from hrljax.core import checks, contract, forks, random
from hrljax.core.counting import Count, Total, count, total
from hrljax.core.numerics import opaque_zero
from hrljax.engine import counters
from hrljax.engine.counters import BLOCK
from hrljax.engine.evaluate import greedy_return
from hrljax.engine.simulator import simulator
from hrljax.engine.start import Start, Startable, checked_start, steps_of
from hrljax.envs.base import AnyEnvironment, Environment, TabularEnvironment, numbers_of
from hrljax.envs.checks import check_before_training, check_declarations
from hrljax.learners.base import AnyLearner, Context, Learner, LearnerState, Transition
from hrljax.learners.hyperparameters import tabulated

_BEGIN_STREAM = 2

Env = AnyEnvironment
Evaluate = Callable[[Any], Array]


class Run(NamedTuple):
    """Result of one run."""

    learned: Any  # the learner's tables after the last episode
    metrics: dict[str, Array]  # each [bins] float32: mean per episode, in bins of episodes
    greedy_return: Array  # [checkpoints] float32: exact value of the greedy policy
    episodes: Array  # int32: episodes that were learned from, those before `start` included
    step_words: Array  # [2] uint32: primitive steps of these episodes, the low and the high half

    @property
    def steps(self) -> Any:
        """Primitive steps of these episodes, int64 ``[...]`` where runs are mapped; outside of compiled code.

        Raises:
            TypeError: the run is traced.
        """
        if isinstance(self.step_words, Tracer):
            raise TypeError("Run.steps has 64 bits, which compiled code does not; use Run.step_words there")
        return steps_of(self.step_words)

    def as_start(self) -> Start:
        """Where a run begins that goes on from this one."""
        return Start(self.learned, self.episodes, self.step_words)


class _Loop(NamedTuple):
    """What changes from stretch to stretch."""

    learner: LearnerState
    state: Any  # the environment's state; its number (int32) if it is tabular
    time: Array  # int32 steps taken in this episode
    episode: Array  # int32 episodes finished
    reward: Array  # float32, over a block of random words
    events: Array  # [events] float32, over a block of random words
    truncated: Array  # int32 truncated episodes, over the bin
    is_over: Array  # bool: the episode has just ended


class _Progress(NamedTuple):
    """What changes from block to block of random words."""

    loop: _Loop
    steps: Count  # of the whole run
    sums: Total  # [1 + events] reward and events, over the bin


class _Stretch(NamedTuple):
    """What changes from step to step. A native loop pays for every entry, so there are few."""

    learner: LearnerState
    state: Any
    reward: Array
    tally: Any  # see `hrljax.engine.counters`


def _like(leaf: Array, value: Any) -> Array:
    """A table that a run starts from; `checked_start` has seen that it has the shape and the dtype of `leaf`."""
    return jnp.asarray(value, leaf.dtype)


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
    learner: AnyLearner,
    key: Array,
    num_episodes: int,
    *,
    params: Any = None,
    bin_size: int | None = None,
    evaluate_every: int | None = None,
    start: Startable | Start | None = None,
) -> Run:
    """Trains a learner for a number of episodes. Pure, for one seed; jit and vmap it.

    Compiled by itself it is correct, but not fast on a CPU: `hrljax.sweep` and `hrljax.engine.batch`
    compile it as a native loop.

    Args:
        env: an environment; a tabular one if the learner is.
        learner: what learns; its numbers may be traced.
        key: a single new-style key; consumed.
        num_episodes: at least 1.
        params: numbers of the environment, `env.default_params` if None; may be traced.
        bin_size: episodes in a bin of the metrics; about a 200th of the run if None.
        evaluate_every: evaluates the greedy policy exactly after every so many bins; never if None.
        start: what training goes on from, a `Run` or a `hrljax.Learned`; from scratch if None. With the
            same key, a run of 500 episodes and 500 more give the same bits as one of 1000; a schedule is
            read on from the episode where the first run ended.

    Raises:
        TypeError, ValueError: a bad argument, or an environment that is not as `hrljax.check` wants it;
            before anything is compiled.
    """
    return run(env, learner, key, num_episodes, params, bin_size, evaluate_every, start)


def run(
    env: Env,
    learner: AnyLearner,
    key: Array,
    num_episodes: int,
    params: Any = None,
    bin_size: int | None = None,
    evaluate_every: int | None = None,
    start: Startable | Start | None = None,
    vmapped: bool = False,
) -> Run:
    """`train`, with its loop built for the mapping.

    Args:
        env, learner, key, num_episodes, params, bin_size, evaluate_every, start: as of `train`.
        vmapped: how the loop is built, not what it computes. True suits `vmap`, where all runs of
            a batch take their steps together; False suits one run.
    """
    num_episodes, bin_size, evaluate_every = check_arguments(env, learner, num_episodes, bin_size, evaluate_every)
    random.check_key(key)
    params = numbers_of(env, params)
    check_before_training(env, params, sample=not isinstance(key, Tracer))
    begin = None if start is None else checked_start(start, env, learner, num_episodes)
    learner = tabulated(learner, num_episodes, 0 if begin is None else begin.episodes)
    trainer = _Trainer(env, learner, key, params, num_episodes, vmapped, begin)
    return trainer.run(bin_size or default_bin_size(num_episodes), evaluate_every)


def check_arguments(
    env: object, learner: object, num_episodes: object, bin_size: object, evaluate_every: object
) -> tuple[int, int | None, int | None]:
    """Raises for what `train` could not run, naming the argument, the value and what is allowed.

    Returns:
        `num_episodes`, `bin_size` and `evaluate_every` as plain integers, or None where they were None.
    """
    forks.check_not_forked()
    env = checks.instance("env", env, Environment, "an environment such as hrljax.make('Bus')")
    learner = checks.instance("learner", learner, Learner, "a learner such as hrljax.QLearning()")
    check_declarations(env)
    if isinstance(env, TabularEnvironment):
        if env.num_states >= 1 << (30 - len(env.metrics)):
            raise ValueError(f"env has {env.num_states} states, too many to number them together with its events")
    elif learner.is_tabular:
        raise TypeError(f"env must be a tabular environment such as hrljax.make('Bus') for {learner.name}, got {env!r}")
    elif evaluate_every is not None:
        raise ValueError(f"evaluate_every needs a tabular environment, got {env!r}")
    return (
        checks.integer("num_episodes", num_episodes, 1),
        None if bin_size is None else checks.integer("bin_size", bin_size, 1),
        None if evaluate_every is None else checks.integer("evaluate_every", evaluate_every, 1),
    )


class _Trainer:
    """The training loop of one run, as nested loops: bins, plans, blocks of random words, stretches, steps."""

    def __init__(
        self,
        env: Env,
        learner: AnyLearner,
        key: Array,
        params: Any,
        num_episodes: int,
        vmapped: bool,
        start: Start | None = None,
    ):
        self.env, self.learner, self.params = env, learner, params
        self.num_episodes, self.vmapped = num_episodes, vmapped
        self.start, self.first_episode = start, 0 if start is None else start.episodes
        self.key = random.key_words(key)
        self.prepared = learner.prepare(env)
        self.simulator = simulator(env, params, learner.num_words)

    def run(self, bin_size: int, evaluate_every: int | None) -> Run:
        sizes = bin_sizes(self.num_episodes, bin_size)
        start = self._start()

        def run_bin(before: _Progress, number: Array) -> tuple[_Progress, tuple[Array, Array, Array]]:
            end = jnp.minimum((number + 1) * bin_size, self.num_episodes) + self.first_episode
            now = lax.while_loop(lambda p: p.loop.episode < end, lambda p: self._between_plans(p, end), before)
            of_bin = (now.sums.rounded(), now.steps.minus(before.steps).as_float(), now.loop.truncated)
            cleared = now._replace(loop=now.loop._replace(truncated=jnp.int32(0)), sums=self._no_sums())
            return cleared, of_bin

        def run_stretch(progress: _Progress, numbers: Array) -> tuple[_Progress, Any]:
            progress, of_bins = lax.scan(run_bin, progress, numbers)
            return progress, (of_bins, self._evaluate(progress.loop))

        numbers = jnp.arange(len(sizes), dtype=jnp.int32)
        values = jnp.zeros(0, jnp.float32)
        if evaluate_every is None:
            last, of_bins = lax.scan(run_bin, start, numbers)
        else:
            whole = len(sizes) // evaluate_every * evaluate_every
            last, (of_bins, values) = lax.scan(run_stretch, start, numbers[:whole].reshape(-1, evaluate_every))
            last, rest = lax.scan(run_bin, last, numbers[whole:])
            of_bins = jax.tree.map(lambda a, b: jnp.concatenate([lax.collapse(a, 0, 2), b]), of_bins, rest)
        # Opaque, because XLA would multiply by the rounded reciprocal of a constant.
        episodes = (jnp.asarray(sizes, jnp.int32) + _zero(last.loop).astype(jnp.int32)).astype(jnp.float32)
        sums, length, truncated = of_bins
        reward, *events = sums.T
        columns = [reward, length, *events, truncated.astype(jnp.float32)]
        metrics = {name: column / episodes for name, column in zip(metric_names(self.env), columns, strict=True)}
        return Run(last.loop.learner.tables, metrics, values, last.loop.episode, jnp.stack(last.steps))

    def _start(self) -> _Progress:
        """Before the first step."""
        state = self.learner.init(self.env, self.prepared)
        steps = count()
        if self.start is not None:
            state = state._replace(tables=jax.tree.map(_like, state.tables, self.start.learned))
            steps = Count(*self.start.step_words)
        episode = jnp.int32(self.first_episode)
        context = Context(episode, jnp.bool_(True), opaque_zero(self.key[0]), self.vmapped)
        control, first = self._begin(state.tables, episode, context)
        events, zero = jnp.zeros(len(self.env.metrics), jnp.float32), jnp.int32(0)
        state = state._replace(control=control)
        loop = _Loop(state, first, zero, episode, jnp.float32(0), events, zero, jnp.bool_(False))
        return _Progress(loop, steps, self._no_sums())

    def _evaluate(self, loop: _Loop) -> Array:
        assert isinstance(self.env, TabularEnvironment)  # `check_arguments` has seen to it
        return greedy_return(self.learner, self.env, self.prepared, loop.learner.tables, self.params, _zero(loop))

    def _no_sums(self) -> Total:
        """The reward and the events of a bin before its first step."""
        return total((1 + len(self.env.metrics),))

    def _between_plans(self, progress: _Progress, end: Array) -> _Progress:
        """Plans if it is time to, and runs episodes until it is time again or `end` is reached."""
        loop = progress.loop
        interval = self.learner.planning_interval
        if interval:
            context = Context(loop.episode, jnp.bool_(True), _zero(loop), self.vmapped)
            tables = context.when(
                loop.episode % interval == 0,
                lambda tables, now: self.learner.plan(self.prepared, tables, now),
                loop.learner.tables,
            )
            loop = loop._replace(learner=loop.learner._replace(tables=tables))
            end = jnp.minimum(end, (loop.episode // interval + 1) * interval)
        progress = progress._replace(loop=loop)
        return lax.while_loop(lambda p: p.loop.episode < end, lambda p: self._block(p, end), progress)

    def _block(self, progress: _Progress, end: Array) -> _Progress:
        """Up to a block of steps, none after `end` episodes."""
        words, most = self.simulator.block(self.key, progress.steps), progress.steps.room(BLOCK)

        def alone(carry: tuple[_Loop, Array]) -> tuple[_Loop, Array]:
            """Steps to the end of the episode or of the block."""
            loop, taken = self._stretch(*carry, most, words, jnp.bool_(True))
            small = lax.cond(loop.is_over, lambda: _small(self._next_episode(loop)), lambda: _small(loop))
            return _with(loop, small), taken

        def together(_: Array, carry: tuple[_Loop, Array]) -> tuple[_Loop, Array]:
            """One step, which other runs take at the same time, and then perhaps the next beginning."""
            live = (carry[0].episode < end) & (carry[1] < most)
            loop, taken = self._stretch(*carry, most, words, live)
            small = _select(loop.is_over, _small(self._next_episode(loop)), _small(loop))
            return _with(loop, _select(live, small, _small(carry[0]))), lax.select(live, taken, carry[1])

        no_events = jnp.zeros(len(self.env.metrics), jnp.float32)
        start = (progress.loop._replace(reward=jnp.float32(0), events=no_events), jnp.int32(0))
        if self.vmapped:
            loop, taken = lax.fori_loop(0, BLOCK, together, start)
        else:
            loop, taken = lax.while_loop(lambda c: (c[1] < most) & (c[0].episode < end), alone, start)
        sums = progress.sums.plus(jnp.concatenate([loop.reward[None], loop.events]))
        return _Progress(loop, progress.steps.plus(taken.astype(jnp.uint32)), sums)

    def _stretch(self, loop: _Loop, taken: Array, most: Array, words: Any, live: Array) -> tuple[_Loop, Array]:
        """Steps to the end of the episode or of the block; under vmap one, or none if it does not learn.

        `taken` counts those of the block, of at most `most`.
        """
        counter, left = self.simulator.counter, jnp.minimum(most - taken, self.params.max_steps - loop.time)
        context = Context(loop.episode, live, _zero(loop), self.vmapped)
        start = _Stretch(loop.learner, loop.state, loop.reward, counter.start(taken, left, loop.events))
        if self.vmapped:
            after = self._step(start, words, context)
        else:
            after = lax.while_loop(lambda s: counters.goes_on(s.tally), lambda s: self._step(s, words, context), start)
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
        context = Context(episode, jnp.bool_(True), _zero(loop), self.vmapped)
        control, first = self._begin(loop.learner.tables, episode, context)
        return loop._replace(
            learner=loop.learner._replace(control=control),
            state=first,
            time=jnp.int32(0),
            episode=episode,
            is_over=jnp.bool_(False),
        )

    def _step(self, now: _Stretch, words: Any, context: Context) -> _Stretch:
        """One primitive step, or none if not ``context.learns``."""
        position = counters.position(now.tally)
        action = self.learner.action(now.learner.control)
        step = self.simulator.step(now.state, action, words, position)
        seen = Transition(now.state, action, step.reward, step.next_state, step.terminated)
        own = self.simulator.learner_words(words, position)
        learned = self.learner.learn(self.prepared, now.learner, seen, own, context)
        return _Stretch(learned, step.next_state, now.reward + step.reward, counters.add(now.tally, step.change))

    def _begin(self, tables: Any, episode: Array, context: Context) -> tuple[Any, Array]:
        """The learner's control and the first state of an episode."""
        own = self.env.num_initial_words
        words = random.words(self.key, episode.astype(jnp.uint32), own + self.learner.num_begin_words, _BEGIN_STREAM)
        first = contract.initial(self.env, words[:own], self.params)
        if isinstance(self.env, TabularEnvironment):
            first = contract.encode(self.env, first)
        # The last episode is followed by a beginning that no one uses; schedules end with the run.
        context = context._replace(episode=jnp.minimum(episode, self.first_episode + self.num_episodes - 1))
        return self.learner.begin(self.prepared, tables, first, words[own:], context), first
