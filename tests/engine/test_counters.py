"""Counts packed into fields, against counting."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.engine import counters
from hrljax.engine.counters import BLOCK, Amounts, Flags


@st.composite
def stretches(draw: st.DrawFn) -> tuple[int, int, np.ndarray]:
    """Events, first position, and flags ``[steps, 1 + events]`` of which only the last ones may end the episode."""
    num_events, first = draw(st.integers(0, 12)), draw(st.integers(0, BLOCK - 1))
    num_steps = draw(st.integers(1, BLOCK - first))
    row = st.lists(st.booleans(), min_size=num_events, max_size=num_events)
    happened = np.array(draw(st.lists(row, min_size=num_steps, max_size=num_steps)), bool).reshape(
        num_steps, num_events
    )
    terminated = np.zeros((num_steps, 1), bool)
    terminated[-1] = draw(st.booleans())
    return num_events, first, np.hstack([terminated, happened])


@settings(deadline=None, max_examples=50)
@given(stretches())
def test_flags_are_counted_one_by_one(stretch: tuple[int, int, np.ndarray]):
    num_events, first, flags = stretch
    counter = Flags(num_events)
    before = np.arange(num_events, dtype=np.float32)
    now = counter.start(jnp.int32(first), jnp.int32(BLOCK - first), jnp.asarray(before))
    for i, row in enumerate(flags):
        assert counters.goes_on(now)
        assert counters.position(now) == first + i
        now = counters.add(now, counter.change(jnp.int32(sum(1 << j for j, flag in enumerate(row) if flag))))
    position, terminated, events = counter.read(now, jnp.asarray(before))
    assert position == first + len(flags)
    assert terminated == flags[-1, 0]
    np.testing.assert_array_equal(events, before + flags[:, 1:].sum(0))
    assert counters.goes_on(now) == (not flags[-1, 0] and first + len(flags) < BLOCK)


@pytest.mark.parametrize("left", [1, 7, BLOCK])
@pytest.mark.parametrize("counter", [Flags(2), Amounts()])
def test_a_stretch_ends_when_no_steps_are_left(counter: Flags | Amounts, left: int):
    now, steps = counter.start(jnp.int32(0), jnp.int32(left), jnp.zeros(2, jnp.float32)), 0
    no = jnp.bool_(False)
    change = counter.change(jnp.int32(0)) if isinstance(counter, Flags) else counter.change(no, [no, no])
    while counters.goes_on(now):
        now, steps = counters.add(now, change), steps + 1
    assert steps == left
    assert not counter.read(now, jnp.zeros(2, jnp.float32))[1]


@pytest.mark.parametrize("first", [0, BLOCK - 1])
def test_a_termination_ends_a_stretch_wherever_it_happens(first: int):
    counter, empty = Flags(4), jnp.zeros(4, jnp.float32)
    now = counter.start(jnp.int32(first), jnp.int32(BLOCK - first), empty)
    now = counters.add(now, counter.change(jnp.int32(0b11111)))
    assert not counters.goes_on(now)
    position, terminated, events = counter.read(now, empty)
    assert (position, bool(terminated)) == (first + 1, True)
    np.testing.assert_array_equal(events, np.ones(4))


def test_all_events_in_every_step_of_a_block_do_not_run_over():
    counter = Flags(9)
    now = counter.start(jnp.int32(0), jnp.int32(BLOCK), jnp.zeros(9, jnp.float32))
    for _ in range(BLOCK):
        now = counters.add(now, counter.change(jnp.int32(0b1111111110)))
    position, terminated, events = counter.read(now, jnp.zeros(9, jnp.float32))
    assert (position, bool(terminated)) == (BLOCK, False)
    np.testing.assert_array_equal(events, np.full(9, BLOCK))


def test_amounts_are_summed_and_the_clock_runs():
    counter = Amounts()
    now = counter.start(jnp.int32(3), jnp.int32(9), jnp.asarray([1.0, 2.0], jnp.float32))
    for end, amounts in ((False, (0.5, 1.0)), (True, (0.25, 0.0))):
        assert counters.goes_on(now)
        now = counters.add(now, counter.change(jnp.bool_(end), [jnp.float32(a) for a in amounts]))
    position, terminated, events = counter.read(now, jnp.zeros(2, jnp.float32))
    assert (position, bool(terminated)) == (5, True)
    np.testing.assert_array_equal(events, [1.75, 3.0])
    assert not counters.goes_on(now)
