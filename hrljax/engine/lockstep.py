"""The training loop of one run of a batch whose runs take their steps together, for `vmap`.

A block of random words is a loop of a fixed number of turns, in each of which every run takes a step, or none if it
waits for the others: it writes what was there. So tables are changed in place, and none is ever selected. Runs wait
at the end of a block alone: each has bins and plans at times of its own.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from hrljax.core.counting import Count
from hrljax.core.flags import choose
from hrljax.core.lockstep import any_run, once_if
from hrljax.core.numerics import put_row
from hrljax.engine.counters import BLOCK, Tally
from hrljax.engine.trainer import Loop, OfBin, Progress, Stretch, Trainer, small_parts, with_small, zero_of
from hrljax.learners.base import Context


class _Bins(NamedTuple):
    """What changes from block to block of random words."""

    progress: Progress
    number: Array  # int32: the bin that the run is in, of those that are to run
    steps_before: Count  # of the whole run before that bin
    records: OfBin  # of each bin so far, ``[bins + 1]`` of each: the last place is for runs that wait


class _Turn(NamedTuple):
    """What changes from turn to turn within a block of random words."""

    loop: Loop
    tally: Tally  # since the block began


class Lockstep(Trainer):
    """The training loop of one run of a batch."""

    in_lockstep = True

    def _bins(self, bin_size: int, start: Progress, numbers: Array) -> tuple[Progress, OfBin]:
        count = len(numbers)
        first = numbers[0] if count else jnp.int32(0)
        before_any: OfBin = (self._no_sums().value, jnp.float32(0), jnp.int32(0))

        def turn(now: _Bins) -> _Bins:
            goes_on = self._goes_on(now, count)
            # Of a run that only waits for others no episode is left.
            end = lax.select(goes_on, self._end_of_bin(bin_size, first + now.number), jnp.int32(0))
            progress = self._block(*self._planned_if_due(now.progress, end))
            row = self._of_bin(progress, now.steps_before)
            is_over = goes_on & (progress.loop.episode >= end)
            return _Bins(
                self._cleared_if(is_over, progress),
                now.number + is_over.astype(jnp.int32),
                choose(is_over, progress.steps, now.steps_before),
                jax.tree.map(lambda all, one: put_row(all, now.number * one.size, one.ravel()), now.records, row),
            )

        records = jax.tree.map(lambda one: jnp.zeros((count + 1) * one.size, one.dtype), before_any)
        begin = _Bins(start, jnp.int32(0), start.steps, records)
        last = lax.while_loop(lambda now: any_run(self._goes_on(now, count)), turn, begin)
        shaped = jax.tree.map(lambda all, one: all.reshape(-1, *one.shape)[:count], last.records, before_any)
        return last.progress, shaped

    def _goes_on(self, now: _Bins, count: int) -> Array:
        """Whether the run has bins left: a run that takes no more steps finishes the bin that it is in."""
        has_bins = now.number < count
        if self.num_steps is None:
            return has_bins
        is_in_bin = now.progress.steps.minus(now.steps_before).reaches(1)
        return has_bins & (is_in_bin | ~jnp.asarray(self._is_stopped(now.progress.steps)))

    def _block(self, progress: Progress, end: Array) -> Progress:
        words, most = self.simulator.block(self.key, progress.steps), progress.steps.room(BLOCK)
        reward, events, reports = self._no_block()
        counter = self.simulator.counter

        def turn(now: _Turn, drawn: Any) -> tuple[_Turn, None]:
            taken, _, _ = counter.read(now.tally, events)
            return self._turn(now, drawn, (now.loop.episode < end) & (taken < most)), None

        loop = progress.loop._replace(reward=reward, events=events, reports=reports)
        begin = _Turn(loop, counter.start(jnp.int32(0), jnp.int32(BLOCK), events))
        (loop, tally), _ = lax.scan(turn, begin, self.simulator.positions(words))
        taken, _, events_of_block = counter.read(tally, events)
        return self._after_block(progress, loop._replace(events=events_of_block), taken)

    def _turn(self, now: _Turn, drawn: Any, live: Array) -> _Turn:
        """One step with the words of one position, if the run is live, and then perhaps the next beginning."""
        loop = now.loop
        context = Context(loop.episode, live, zero_of(loop), self.in_lockstep)
        before = Stretch(loop.learner, loop.state, loop.reward, loop.reports, now.tally)
        after, terminated = self._step(before, drawn, jnp.int32(0), context)
        stepped = self._stepped(loop, after, 1, terminated)
        small, tally = choose(live, (small_parts(stepped), after.tally), (small_parts(loop), now.tally))
        small = once_if(
            live & stepped.is_over,
            lambda small: small_parts(self._next_episode(with_small(stepped, small))),
            small,
        )
        return _Turn(with_small(stepped, small), tally)
