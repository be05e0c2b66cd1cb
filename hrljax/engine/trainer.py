"""The training loop of one run, as nested loops: bins, plans, blocks of random words, stretches, steps."""

from functools import partial
from typing import Any, ClassVar, NamedTuple, TypeAlias

import chex
import jax
import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import contract, random
from hrljax.core.counting import Count, Total, count, total
from hrljax.core.environment import EpisodeState, Numbers
from hrljax.core.flags import Flag, choose
from hrljax.core.lockstep import once_if
from hrljax.core.numerics import opaque_zero
from hrljax.engine import counters
from hrljax.engine.borders import check_given_back, check_learned
from hrljax.engine.counters import BLOCK
from hrljax.engine.evaluate import greedy_return
from hrljax.engine.run import Run, bin_sizes, metric_names
from hrljax.engine.simulator import simulator
from hrljax.engine.start import Start
from hrljax.envs.base import AnyEnvironment, TabularEnvironment
from hrljax.learners.base import AnyLearner, Context, LearnerState, Transition

_BEGIN_STREAM = 2


class Loop(NamedTuple):
    """What changes from stretch to stretch."""

    learner: LearnerState
    state: EpisodeState | Array  # the environment's state; its number (int32) if it is tabular
    time: Array  # int32 steps taken in this episode
    episode: Array  # int32 episodes finished
    reward: Array  # float32, over a block of random words
    events: Array  # [events] float32, over a block of random words
    reports: tuple[Array, ...]  # float32 each, over a block of random words
    truncated: Array  # int32 truncated episodes, over the bin
    is_over: Array  # bool: the episode has just ended


class Progress(NamedTuple):
    """What changes from block to block of random words."""

    loop: Loop
    steps: Count  # of the whole run
    sums: Total  # [1 + events + reports] reward, events and what the learner reports, over the bin


class Stretch(NamedTuple):
    """What changes from step to step. A native loop pays for every entry, so there are few."""

    learner: LearnerState
    state: EpisodeState | Array
    reward: Array
    reports: tuple[Array, ...]
    tally: counters.Tally  # see `hrljax.engine.counters`


OfBin: TypeAlias = tuple[Array, Array, Array]
"""What is recorded of a bin, and of bins with a leading axis: its sums, its steps (float32), its truncated episodes."""


def _like(leaf: Array, value: chex.Array) -> Array:
    """A table that a run starts from; `checked_start` has seen that it has the shape and the dtype of `leaf`."""
    return jnp.asarray(value, leaf.dtype)


def zero_of(loop: Loop) -> Array:
    """A zero that no compiler folds, even where the key is a constant: it knows nothing of the state."""
    if isinstance(loop.state, Array):
        return opaque_zero(loop.state.astype(jnp.uint32))
    return opaque_zero(lax.bitcast_convert_type(loop.reward, jnp.uint32))


def small_parts(loop: Loop) -> tuple[Any, ...]:
    return (loop.learner.control, *loop[1:])


def with_small(loop: Loop, small: tuple[Any, ...]) -> Loop:
    return Loop(LearnerState(loop.learner.tables, small[0]), *small[1:])


class Trainer:
    """The training loop of one run."""

    in_lockstep: ClassVar[bool] = False

    def __init__(
        self,
        env: AnyEnvironment,
        learner: AnyLearner,
        key: Array,
        params: Numbers,
        num_episodes: int,
        start: Start | None = None,
        num_steps: int | None = None,
    ):
        self.env, self.learner, self.params = env, learner, params
        self.num_episodes, self.num_steps = num_episodes, num_steps
        self.start, self.first_episode = start, 0 if start is None else start.episodes
        self.key = random.key_words(key)
        self.prepared = learner.prepare(env)
        self.simulator = simulator(env, params, learner.num_words)

    def run(self, bin_size: int, evaluate_every: int | None) -> Run:
        sizes = bin_sizes(self.num_episodes, bin_size)
        start = self._start()
        run_bins = partial(self._bins, bin_size)

        def run_stretch(progress: Progress, numbers: Array) -> tuple[Progress, Any]:
            progress, of_bins = run_bins(progress, numbers)
            return progress, (of_bins, self._evaluate(progress.loop))

        numbers = jnp.arange(len(sizes), dtype=jnp.int32)
        values = jnp.zeros(0, jnp.float32)
        if evaluate_every is None:
            last, of_bins = run_bins(start, numbers)
        else:
            whole = len(sizes) // evaluate_every * evaluate_every
            last, (of_bins, values) = lax.scan(run_stretch, start, numbers[:whole].reshape(-1, evaluate_every))
            last, rest = run_bins(last, numbers[whole:])
            of_bins = jax.tree.map(lambda a, b: jnp.concatenate([lax.collapse(a, 0, 2), b]), of_bins, rest)
        # Opaque, because XLA would multiply by the rounded reciprocal of a constant.
        episodes = (jnp.asarray(sizes, jnp.int32) + zero_of(last.loop).astype(jnp.int32)).astype(jnp.float32)
        sums, length, truncated = of_bins
        reward, *others = sums.T
        events, reports = others[: len(self.env.metrics)], others[len(self.env.metrics) :]
        per_episode = [reward, length, *events, truncated.astype(jnp.float32)]
        are_per_episode = (name in self.learner.reports_per_episode for name in self.learner.reports)
        of_reports = (c / (episodes if is_so else length) for c, is_so in zip(reports, are_per_episode, strict=True))
        columns = [*(column / episodes for column in per_episode), *of_reports]
        if self.num_steps is not None:
            columns = [jnp.where(length > 0, column, jnp.float32(jnp.nan)) for column in columns]
        metrics = dict(zip(metric_names(self.env, self.learner), columns, strict=True))
        return Run(last.loop.learner.tables, metrics, values, last.loop.episode, jnp.stack(last.steps))

    def _bins(self, bin_size: int, start: Progress, numbers: Array) -> tuple[Progress, OfBin]:
        """Successive bins, and what is recorded of each."""

        def run_bin(before: Progress, number: Array) -> tuple[Progress, OfBin]:
            end = self._unless_stopped(before, self._end_of_bin(bin_size, number))
            now = lax.while_loop(lambda p: p.loop.episode < end, lambda p: self._between_plans(p, end), before)
            return self._cleared_if(True, now), self._of_bin(now, before.steps)

        return lax.scan(run_bin, start, numbers)

    def _of_bin(self, progress: Progress, steps_before: Count) -> OfBin:
        """What is recorded of a bin at its end, before which the run had taken so many steps."""
        return progress.sums.rounded(), progress.steps.minus(steps_before).as_float(), progress.loop.truncated

    def _cleared_if(self, is_over: Flag, progress: Progress) -> Progress:
        """The progress at the begin of the next bin, where one is over."""
        truncated = choose(is_over, jnp.int32(0), progress.loop.truncated)
        sums = choose(is_over, self._no_sums(), progress.sums)
        return progress._replace(loop=progress.loop._replace(truncated=truncated), sums=sums)

    def _end_of_bin(self, bin_size: int, number: Array) -> Array:
        """The episode (int32) before which a bin ends."""
        return jnp.minimum((number + 1) * bin_size, self.num_episodes) + self.first_episode

    def _is_stopped(self, steps: Count) -> Flag:
        """Whether a run that has taken so many steps takes no more."""
        return False if self.num_steps is None else steps.reaches(self.num_steps)

    def _unless_stopped(self, progress: Progress, end: Array) -> Array:
        """The episode before which a bin ends; 0 of a run that takes no more steps."""
        return end if self.num_steps is None else choose(self._is_stopped(progress.steps), jnp.int32(0), end)

    def _start(self) -> Progress:
        """Before the first step."""
        state = self.learner.init(self.env, self.prepared)
        steps = count()
        if self.start is not None:
            state = state._replace(tables=jax.tree.map(_like, state.tables, self.start.learned))
            steps = Count(*self.start.step_words)
        episode = jnp.int32(self.first_episode)
        context = Context(episode, jnp.bool_(True), opaque_zero(self.key[0]), self.in_lockstep)
        control, first = self._begin(state.tables, episode, context)
        none = jnp.int32(0)
        state = state._replace(control=control)
        loop = Loop(state, first, none, episode, *self._no_block(), none, jnp.bool_(False))
        return Progress(loop, steps, self._no_sums())

    def _no_block(self) -> tuple[Array, Array, tuple[Array, ...]]:
        """Reward, events and reports of a block before its first step."""
        events = jnp.zeros(len(self.env.metrics), jnp.float32)
        return jnp.float32(0), events, (jnp.float32(0),) * len(self.learner.reports)

    def _evaluate(self, loop: Loop) -> Array:
        assert isinstance(self.env, TabularEnvironment)  # `check_arguments` has seen to it
        tables, episode = loop.learner.tables, self._last_if_over(loop.episode)
        return greedy_return(self.learner, self.env, self.prepared, tables, self.params, zero_of(loop), episode)

    def _no_sums(self) -> Total:
        """The reward, the events and the reports of a bin before its first step."""
        return total((1 + len(self.env.metrics) + len(self.learner.reports),))

    def _between_plans(self, progress: Progress, end: Array) -> Progress:
        """Plans if it is time to, and runs episodes until it is time again or `end` is reached."""
        progress, end = self._planned_if_due(progress, end)
        return lax.while_loop(lambda p: p.loop.episode < end, lambda p: self._block(p, end), progress)

    def _planned_if_due(self, progress: Progress, end: Array) -> tuple[Progress, Array]:
        """Plans if it is time to, and `end` is not reached; with the episode before which to ask again."""
        loop, interval = progress.loop, self.learner.planning_interval
        if not interval:
            return progress, end
        context = Context(loop.episode, jnp.bool_(True), zero_of(loop), self.in_lockstep)
        is_due = (loop.episode < end) & (loop.episode % interval == 0) & (loop.time == 0)
        tables = once_if(is_due, lambda tables: self._planned(tables, context), loop.learner.tables)
        loop = loop._replace(learner=loop.learner._replace(tables=tables))
        return progress._replace(loop=loop), jnp.minimum(end, (loop.episode // interval + 1) * interval)

    def _planned(self, tables: chex.ArrayTree, context: Context) -> chex.ArrayTree:
        planned = self.learner.plan(self.prepared, tables, context)
        check_given_back(f"{type(self.learner).__name__}: plan", tables, planned)
        return planned

    def _block(self, progress: Progress, end: Array) -> Progress:
        """Up to a block of steps, none after `end` episodes."""
        words, most = self.simulator.block(self.key, progress.steps), progress.steps.room(BLOCK)

        def alone(carry: tuple[Loop, Array]) -> tuple[Loop, Array]:
            """Steps to the end of the episode or of the block."""
            loop, taken = self._stretch(*carry, most, words)
            small = lax.cond(loop.is_over, lambda: small_parts(self._next_episode(loop)), lambda: small_parts(loop))
            return with_small(loop, small), taken

        reward, events, reports = self._no_block()
        start = (progress.loop._replace(reward=reward, events=events, reports=reports), jnp.int32(0))
        loop, taken = lax.while_loop(lambda c: (c[1] < most) & (c[0].episode < end), alone, start)
        return self._after_block(progress, loop, taken)

    def _after_block(self, progress: Progress, loop: Loop, taken: Array) -> Progress:
        """The progress after so many steps (int32) more."""
        amounts = jnp.concatenate([loop.reward[None], loop.events, *(report[None] for report in loop.reports)])
        sums = progress.sums.plus(amounts)
        return Progress(loop, progress.steps.plus(taken.astype(jnp.uint32)), sums)

    def _stretch(self, loop: Loop, taken: Array, most: Array, words: Any) -> tuple[Loop, Array]:
        """Steps to the end of the episode or of the block.

        `taken` counts those of the block, of at most `most`.
        """
        counter, left = self.simulator.counter, jnp.minimum(most - taken, self.params.max_steps - loop.time)
        context = Context(loop.episode, jnp.bool_(True), zero_of(loop))
        tally = counter.start(taken, left, loop.events)
        start = Stretch(loop.learner, loop.state, loop.reward, loop.reports, tally)

        def step(now: Stretch) -> Stretch:
            return self._step(now, words, counters.position(now.tally), context)[0]

        after = lax.while_loop(lambda s: counters.goes_on(s.tally), step, start)
        now, terminated, events = counter.read(after.tally, loop.events)
        return self._stepped(loop, after, now - taken, terminated)._replace(events=events), now

    def _stepped(self, loop: Loop, after: Stretch, steps: Array | int, terminated: Array) -> Loop:
        """The loop after so many steps, the last of which may have ended the episode; events aside."""
        time = loop.time + steps
        truncated = ~terminated & (time >= self.params.max_steps)
        return loop._replace(
            learner=after.learner,
            state=after.state,
            time=time,
            reward=after.reward,
            reports=after.reports,
            truncated=loop.truncated + truncated.astype(jnp.int32),
            is_over=terminated | truncated,
        )

    def _next_episode(self, loop: Loop) -> Loop:
        episode = loop.episode + 1
        context = Context(episode, jnp.bool_(True), zero_of(loop), self.in_lockstep)
        control, first = self._begin(loop.learner.tables, episode, context)
        return loop._replace(
            learner=loop.learner._replace(control=control),
            state=first,
            time=jnp.int32(0),
            episode=episode,
            is_over=jnp.bool_(False),
        )

    def _step(self, now: Stretch, block: Any, position: Array, context: Context) -> tuple[Stretch, Array]:
        """One primitive step with the words of a block's position, and whether it terminated the episode."""
        action = self.learner.action(now.learner.control)
        step = self.simulator.step(now.state, action, block, position)
        transition = Transition(now.state, action, step.reward, step.next_state, step.terminated)
        words = self.simulator.learner_words(block, position)
        learned = self.learner.learn(self.prepared, now.learner, transition, words, context)
        state, report = check_learned(self.learner, now.learner, learned)
        reports = tuple(total + new for total, new in zip(now.reports, report, strict=True))
        tally = counters.add(now.tally, step.change)
        return Stretch(state, step.next_state, now.reward + step.reward, reports, tally), step.terminated

    def _begin(
        self, tables: chex.ArrayTree, episode: Array, context: Context
    ) -> tuple[chex.ArrayTree, EpisodeState | Array]:
        """The learner's control and the first state of an episode."""
        num_first = self.env.num_initial_words
        words = random.words(
            self.key, episode.astype(jnp.uint32), num_first + self.learner.num_begin_words, _BEGIN_STREAM
        )
        first = contract.initial(self.env, words[:num_first], self.params)
        if isinstance(self.env, TabularEnvironment):
            first = contract.encode(self.env, first)
        # The last episode is followed by a beginning that no one uses.
        context = context._replace(episode=self._last_if_over(episode))
        return self.learner.begin(self.prepared, tables, first, words[num_first:], context), first

    def _last_if_over(self, episode: Array) -> Array:
        """The episode; after the end of the run, with which schedules end, its last one."""
        return jnp.minimum(episode, self.first_episode + self.num_episodes - 1)
