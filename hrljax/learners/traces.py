"""Learners with eligibility traces: SARSA(lambda) and Watkins's Q(lambda).

A trace depends only on how long ago its pair was visited, so the learner keeps a ring of the pairs
visited last and walks it from the newest to the oldest, instead of decaying a table of all pairs.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.numerics import put_row, take, take_row
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.flat import StepSizeLearner, row_of
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.updates import traced_increment

_NO_PAIR = -1
_LONGEST = 1 << 24
"""Visits that a ring may hold."""
_Kind = Literal["accumulating", "replacing"]


class TraceTables(NamedTuple):
    """What a learner with traces has learned, and where it has been."""

    values: Array  # [S * A] float32 action values
    visited: Array  # [ring] int32 pairs ``state * A + action``; -1 where a later visit replaced the trace


class TraceControl(NamedTuple):
    """What a learner with traces is doing; int32 scalars."""

    action: Array  # next action
    visits: Array  # pairs visited since the traces were cleared


class _Walk(NamedTuple):
    """Where a walk through the traces is."""

    age: Array  # int32 steps since the visit
    trace: Array  # float32: (discount * trace_decay) ** age
    tables: TraceTables


@dataclass(frozen=True)
class _Traced(StepSizeLearner):
    trace_decay: Hyperparameter = hyperparameter(0.9, 0, 1, schedule=True)
    trace_cutoff: Hyperparameter = hyperparameter(1e-3, 0, 1)
    trace_length: int = 64
    trace: _Kind = "replacing"

    _on_policy = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("trace_length", 1, _LONGEST)
        self._check_choice("trace", _Kind)

    @property
    def _ring(self) -> int:
        """Length of the ring: a power of two, so that positions wrap by a mask."""
        return 1 << (self.trace_length - 1).bit_length()

    def init(self, env: AnyTabularEnvironment, prepared: int) -> LearnerState:
        visited = jnp.full(self._ring, _NO_PAIR, jnp.int32)
        return LearnerState(TraceTables(self.initial_values(env), visited), TraceControl(jnp.int32(0), jnp.int32(0)))

    def begin(self, prepared: int, tables: TraceTables, first: Array, words: Words, context: Context) -> TraceControl:
        return TraceControl(super().begin(prepared, tables, first, words, context), jnp.int32(0))

    def action(self, control: TraceControl) -> Array:
        return control.action

    def learn(
        self, prepared: int, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        tables, control = state
        row = row_of(tables.values, transition.next_state, prepared)
        if self._on_policy:
            action = self.choose(row, words[0], context)
            bootstrap = take(tables.values, transition.next_state * prepared + action)
        else:
            action, bootstrap = choices.greedy(row)
        target = self.target(transition.reward, bootstrap, transition.terminated, context)
        pair = transition.state * prepared + transition.action
        error = target - take(tables.values, pair)
        change = context.product(at_episode(self.step_size, context.episode), error)
        tables, visits = self._all_moved(tables, pair, control.visits, change, context), control.visits + 1
        if not self._on_policy:
            row = row_of(tables.values, transition.next_state, prepared)
            action = self.choose(row, words[0], context)
            explores = choices.pick(row, action) < choices.greedy(row)[1]
            visits = lax.select(explores, jnp.int32(0), visits)
        return LearnerState(tables, TraceControl(action, visits))

    def _all_moved(
        self, tables: TraceTables, pair: Array, visits: Array, change: Array, context: Context
    ) -> TraceTables:
        """The tables after every pair with a trace has moved, `pair`, which is visited now, by `change`."""
        newest = visits & (self._ring - 1)
        entry = lax.select(context.learns, pair, take(tables.visited, newest))
        tables = tables._replace(visited=put_row(tables.visited, newest, entry[None]))
        length = lax.min(visits + 1, jnp.int32(self.trace_length))
        cutoff = jnp.asarray(self.trace_cutoff, jnp.float32)
        discount, decay = (
            jnp.asarray(at_episode(value, context.episode)) for value in (self.discount, self.trace_decay)
        )
        decay = context.product(discount, decay)

        def goes_on(walk: _Walk) -> Array:
            return (walk.age < length) & (walk.trace >= cutoff)

        def further(walk: _Walk) -> _Walk:
            # A run may have come to its end before the others of its batch.
            learns = context.learns & goes_on(walk) if context.vmapped else context.learns
            moved = self._one_moved(walk, pair, newest, change, context._replace(learns=learns))
            return _Walk(walk.age + 1, context.product(decay, walk.trace), moved)

        walk = _Walk(jnp.int32(0), jnp.float32(1), tables)
        return lax.while_loop(lambda walk: context.any_run(context.learns & goes_on(walk)), further, walk).tables

    def _one_moved(self, walk: _Walk, pair: Array, newest: Array, change: Array, context: Context) -> TraceTables:
        """The tables after the pair that a walk has come to has moved."""
        values, visited = walk.tables
        place = (newest - walk.age) & (self._ring - 1)
        earlier = take(visited, place)
        old = take_row(values, earlier, 1)
        has_trace = context.learns
        if self.trace == "replacing":
            # The visit now replaces the trace of an earlier one, for good.
            replaced = (earlier == pair) & (walk.age > 0)
            has_trace = context.learns & ~replaced & (earlier != _NO_PAIR)
            entry = lax.select(context.learns & replaced, jnp.int32(_NO_PAIR), earlier)
            visited = put_row(visited, place, entry[None])
        new = traced_increment(old, change[None], walk.trace[None], has_trace[None], context.zero)
        return TraceTables(put_row(values, earlier, new), visited)


@dataclass(frozen=True)
class SARSALambda(_Traced):
    """SARSA(lambda) (Rummery and Niranjan 1994; Sutton and Barto 1998, Fig. 7.11), backward view.

    Every step moves all pairs visited in this episode by their traces: ``(discount * trace_decay) ** k``
    for a visit k steps ago. Traces below `trace_cutoff`, and visits `trace_length` or more steps ago,
    are dropped. Of each update that leaves out at most ``x / (1 - discount * trace_decay)`` times
    its step size and TD error, all pairs together, where x is the greater of `trace_cutoff` and
    ``(discount * trace_decay) ** trace_length``.

    Attributes:
        step_size: in (0, 1], or a schedule of the episode.
        epsilon: probability of a uniformly random action, or a schedule of the episode. Else it takes the best one.
        discount: in [0, 1].
        initial_value: of every state and action.
        trace_decay: lambda in [0, 1], or a schedule of the episode; 0 gives SARSA(0) bit for bit.
        trace_cutoff: in [0, 1]; a walk stops at the first trace below it, so that a smaller
            `trace_decay` costs less time.
        trace_length: visits kept, from 1 to 2**24.
        trace: whether visits of a pair in one episode add their traces (``"accumulating"``) or the
            last one counts (``"replacing"``; Singh and Sutton 1996, without reset of other actions).
        ties: as of `QLearning`.
    """

    name = "SARSA(lambda)"


@dataclass(frozen=True)
class QLambda(_Traced):
    """Watkins's Q(lambda) (Watkins 1989; Sutton and Barto 1998, Fig. 7.14).

    Bootstraps on the greedy action, and clears all traces when the next action is not greedy. An
    action as good as the greedy one is greedy too. As in `QLearning`, which it is bit for bit with a
    `trace_decay` of 0, the next action is chosen after the update.

    Attributes: as `SARSALambda`.
    """

    name = "Q(lambda)"
    _on_policy = False
