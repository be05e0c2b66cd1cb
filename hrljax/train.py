"""One run: an environment, a learner and a key give what was learned and its curve."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax import random
from hrljax.envs.base import Environment, TabularEnvironment, concrete_params
from hrljax.learners.base import Experience, Learner, LearnerState, Moment, tabulated
from hrljax.numerics import opaque_zero, stage

_BEGIN_STREAM = 2
_BLOCK = 16
"""Steps whose random words are computed at once."""

Env = Environment[Any, Any]
Evaluate = Callable[[Any], Array]


class Run(NamedTuple):
    """Result of one run."""

    learned: Any  # the learner's tables after the last episode
    metrics: dict[str, Array]  # each [bins] float32: mean per episode, in bins of episodes
    greedy_return: Array  # [checkpoints] float32: exact value of the greedy policy
    steps: Array  # int32: primitive steps of the whole run


_TERMINATED, _TRUNCATED = np.int32(-1), np.int32(-2)


class _Loop(NamedTuple):
    """What changes from step to step. A native loop pays for every entry, so there are few."""

    learner: LearnerState
    state: Any  # the environment's state; its number (int32) if it is tabular
    time: Array  # int32 steps taken in this episode; when it is over, why
    episode: Any  # int32 episodes finished
    sums: Array  # [1 + events + 1] float32, over the bin: reward, events, truncated episodes


def _select(condition: Array, these: Any, those: Any) -> Any:
    return jax.tree.map(lambda a, b: lax.select(jnp.broadcast_to(condition, a.shape), a, b), these, those)


def _zero(loop: _Loop) -> Array:
    """A zero that no compiler folds, even where the key is a constant: it knows nothing of the state."""
    if isinstance(loop.state, Array):
        return opaque_zero(loop.state.astype(jnp.uint32))
    return opaque_zero(lax.bitcast_convert_type(loop.sums[0], jnp.uint32))


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
    """The training loop of one run, as nested loops: bins, plans, blocks of random words, steps."""

    def __init__(self, env: Env, learner: Learner, key: Array, params: Any, num_episodes: int, lockstep: bool):
        self.env, self.learner, self.params = env, learner, params
        self.num_episodes, self.lockstep = num_episodes, lockstep
        self.key = random.key_words(key)
        self.prepared = learner.prepare(env)
        self.tabular = env if isinstance(env, TabularEnvironment) else None
        self.packed_transition = stage(self._packed_transition)

    def run(self, bin_size: int, evaluate_every: int | None) -> Run:
        sizes = bin_sizes(self.num_episodes, bin_size)
        state = self.learner.init(self.env, self.prepared)
        zero = jnp.int32(0)
        control, first = self._begin(
            state.tables, zero, Moment(zero, jnp.bool_(True), opaque_zero(self.key[0]), self.lockstep)
        )
        start = (_Loop(state._replace(control=control), first, zero, zero, self._nothing()), zero)

        def run_bin(carry: tuple[_Loop, Array], number: Array) -> tuple[tuple[_Loop, Array], tuple[Array, Array]]:
            end = jnp.minimum((number + 1) * bin_size, self.num_episodes)
            before = carry[1]
            loop, steps = lax.while_loop(lambda c: c[0].episode < end, lambda c: self._between_plans(*c, end), carry)
            return (loop._replace(sums=self._nothing()), steps), (loop.sums, steps - before)

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
            sums = jax.tree.map(lambda a, b: jnp.concatenate([a.reshape(-1, *b.shape[1:]), b]), sums, rest)
        # Opaque, because XLA would multiply by the rounded reciprocal of a constant.
        episodes = (jnp.asarray(sizes, jnp.int32) + _zero(loop).astype(jnp.int32)).astype(jnp.float32)
        rewards_and_events, length = sums
        reward, *events = rewards_and_events.T
        columns = [reward, length.astype(jnp.float32), *events]
        metrics = {name: column / episodes for name, column in zip(metric_names(self.env), columns, strict=True)}
        return Run(loop.learner.tables, metrics, values, steps)

    def _evaluate(self, loop: _Loop) -> Array:
        return self.learner.greedy_return(self.env, self.prepared, loop.learner.tables, self.params, _zero(loop))

    def _nothing(self) -> Array:
        """The sums of a bin before its first step."""
        return jnp.zeros(2 + len(self.env.metrics), jnp.float32)

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
        """Up to `_BLOCK` steps, none after `end` episodes; `steps` counts those of the whole run."""
        num_words = self.env.num_words + self.learner.num_words
        words = random.WordBlock(self.key, steps.astype(jnp.uint32), _BLOCK, num_words)

        def step(carry: tuple[_Loop, Array], live: Array) -> tuple[_Loop, Array]:
            return self._step(carry[0], words[carry[1]], live), carry[1] + live.astype(jnp.int32)

        def alone(carry: tuple[_Loop, Array]) -> tuple[_Loop, Array]:
            """Steps to the end of the episode or of the block."""
            episode = carry[0].episode

            def one(carry: tuple[_Loop, Array]) -> tuple[_Loop, Array]:
                loop, taken = step((carry[0]._replace(episode=episode), carry[1]), jnp.bool_(True))
                return loop._replace(episode=()), taken

            # The number of the episode does not change here, so it is not carried.
            start = (carry[0]._replace(episode=()), carry[1])
            loop, taken = lax.while_loop(lambda c: (c[1] < _BLOCK) & (c[0].time >= 0), one, start)
            loop = loop._replace(episode=episode)
            small = lax.cond(loop.time < 0, lambda: _small(self._next_episode(loop)), lambda: _small(loop))
            return _with(loop, small), taken

        def in_lockstep(_: Array, carry: tuple[_Loop, Array]) -> tuple[_Loop, Array]:
            """One step, which other runs take at the same time, and then perhaps the next beginning."""
            live = carry[0].episode < end
            loop, taken = step(carry, live)
            small = _select(loop.time < 0, _small(self._next_episode(loop)), _small(loop))
            return _with(loop, _select(live, small, _small(carry[0]))), taken

        start = (loop, jnp.int32(0))
        if self.lockstep:
            loop, taken = lax.fori_loop(0, _BLOCK, in_lockstep, start)
        else:
            loop, taken = lax.while_loop(lambda c: (c[1] < _BLOCK) & (c[0].episode < end), alone, start)
        return loop, steps + taken

    def _next_episode(self, loop: _Loop) -> _Loop:
        episode = loop.episode + 1
        moment = Moment(episode, jnp.bool_(True), _zero(loop), self.lockstep)
        control, first = self._begin(loop.learner.tables, episode, moment)
        truncated = (loop.time == _TRUNCATED).astype(jnp.float32)
        return _Loop(
            learner=loop.learner._replace(control=control),
            state=first,
            time=jnp.int32(0),
            episode=episode,
            sums=loop.sums.at[-1].add(truncated),
        )

    def _step(self, loop: _Loop, words: tuple[Array, ...], live: Array) -> _Loop:
        """One primitive step, or none if not `live`."""
        own = self.env.num_words
        action = self.learner.action(loop.learner.control)
        next_state, reward, terminated, *events = self._transition(loop.state, action, words[:own])
        time = loop.time + 1
        step = Experience(loop.state, action, reward, next_state, terminated)
        moment = Moment(loop.episode, live, _zero(loop), self.lockstep)
        learned = self.learner.learn(self.prepared, loop.learner, step, words[own:], moment)
        time = lax.select(time >= self.params.max_steps, jnp.int32(_TRUNCATED), time)
        time = lax.select(terminated, jnp.int32(_TERMINATED), time)
        counted = jnp.stack([reward, *(event.astype(jnp.float32) for event in events), jnp.float32(0)])
        return _Loop(learned, next_state, time, loop.episode, loop.sums + counted)

    def _transition(self, state: Any, action: Array, words: tuple[Array, ...]) -> tuple[Any, ...]:
        """Next state, reward, whether the episode terminated, and the events."""
        if self.tabular is None:
            after, reward, terminated, info = self.env.transition(state, action, words, self.params)
            return after, reward, terminated, *(info[name] for name in self.env.metrics)
        packed, reward = self.packed_transition(state, action, words)
        flags = 1 + len(self.env.metrics)
        terminated, *events = (((packed >> i) & 1) == 1 for i in reversed(range(flags)))
        return packed >> flags, reward, terminated, *events

    def _packed_transition(self, state: Array, action: Array, words: tuple[Array, ...]) -> tuple[Array, Array]:
        """A tabular environment's step, all but the reward in one int32: what is one result is computed once."""
        env: TabularEnvironment[Any, Any] = self.tabular  # type: ignore[assignment]
        after, reward, terminated, info = env.transition(env.decode(state), action, words, self.params)
        packed = env.encode(after)
        for flag in (terminated, *(info[name] for name in env.metrics)):
            packed = (packed << 1) | flag.astype(jnp.int32)
        return packed, reward

    def _begin(self, tables: Any, episode: Array, moment: Moment) -> tuple[Any, Array]:
        """The learner's control and the first state of an episode."""
        own = self.env.num_initial_words
        words = random.words(self.key, episode.astype(jnp.uint32), own + self.learner.num_begin_words, _BEGIN_STREAM)
        first = self.env.initial(words[:own], self.params)
        if self.tabular is not None:
            first = self.tabular.encode(first)
        # The last episode is followed by a beginning that no one uses; schedules end with the run.
        moment = moment._replace(episode=jnp.minimum(episode, self.num_episodes - 1))
        return self.learner.begin(self.prepared, tables, first, words[own:], moment), first
