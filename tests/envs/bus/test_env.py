"""The Bus domain: its numbering, one step by hand, its options and the contract of environments."""

from functools import partial
from types import SimpleNamespace

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.core import random
from hrljax.core.random import WORD_RANGE
from hrljax.envs.bus.env import Bus, BusParams, BusState
from hrljax.envs.bus.map import KAO_V1, MapError
from hrljax.solvers.model import Model
from tests.words import CALM

NORTH, EAST, SOUTH, WEST = range(4)
NO_ROAD, ROAD_A, ROAD_B = range(3)
START, FIRST_PASSENGER, BESIDE_START = 3 * 6 + 1, 1 * 6 + 5, 3 * 6 + 2
WEST_OF_A, EAST_OF_A, NORTH_OF_B, SOUTH_OF_B = 14, 15, 23, 29


def state_of(cell: int, damaged: int = 0, picked: int = 0, road: int = NO_ROAD, time: int = 0) -> BusState:
    return BusState(*(jnp.int32(x) for x in (cell, damaged, picked, road, time)))


@partial(jax.jit, static_argnums=(0, 1))
def transition(env: Bus, params: BusParams, state: BusState, action: jax.Array, words: tuple[jax.Array, ...]):
    return env.transition(state, action, words, params)


def move(env: Bus, state: BusState, action: int, slip: int = CALM, mishap: int = CALM, road: int = CALM):
    """One transition in plain numbers: next state, reward, terminated, and the two counts of events."""
    words = tuple(jnp.uint32(w) for w in (slip, mishap, road))
    after, reward, terminated, info = transition(env, env.default_params, state, jnp.int32(action), words)
    counts = {f"num_{event}": int(count) for event, count in info.items()}
    fields = {field: int(value) for field, value in after._asdict().items()}
    return SimpleNamespace(reward=float(reward), terminated=bool(terminated), **fields, **counts)


def shares(env: Bus, model: Model, state: BusState, action: int, field: str) -> dict[int, float]:
    """Probability, by the model, of each value of one field of the next state."""
    index = int(env.encode(state))
    values = getattr(jax.vmap(env.decode)(jnp.asarray(model.next_state[index, action])), field)
    totals = np.bincount(np.asarray(values), weights=model.probability[index, action])
    return {int(v): pytest.approx(float(totals[v]), abs=1e-6) for v in np.flatnonzero(totals)}


def test_numbers_and_states_are_one_to_one(bus: Bus):
    assert bus.num_states == 2304
    numbers = jnp.arange(2304, dtype=jnp.int32)
    states = jax.vmap(bus.decode)(numbers)
    np.testing.assert_array_equal(jax.vmap(bus.encode)(states), numbers)
    assert [int(field.max()) for field in states] == [35, 1, 7, 3, 0]
    assert bus.encode(state_of(3, 1, 5, 2, time=77)) == bus.encode(state_of(3, 1, 5, 2))


def test_1656_states_are_reachable(bus: Bus, bus_model: Model):
    successors = bus_model.successors()
    frontier = set(np.flatnonzero(bus.initial_distribution()).tolist())
    acted_in, entered = set(), set()
    while frontier:
        rows = sorted(frontier)
        acted_in |= frontier
        entered |= set(bus_model.next_state[rows][bus_model.probability[rows] > 0].tolist())
        frontier = set(successors[rows].ravel().tolist()) - acted_in - {-1}
    assert len(acted_in | entered) == 1656  # the states in which episodes end included


def test_episodes_begin_at_the_start_on_every_road_equally(bus: Bus):
    starts = [int(bus.encode(state_of(START, road=road))) for road in range(3)]
    np.testing.assert_allclose(bus.initial_distribution()[starts], 1 / 3, atol=1e-6)


def test_probabilities_of_the_model_sum_to_one(bus_model: Model):
    assert bus_model.probability.min() >= 0
    np.testing.assert_allclose(bus_model.probability.sum(-1), 1, atol=1e-12)


def test_a_bump_into_a_wall_costs_a_step_and_moves_nothing(bus: Bus):
    after = move(bus, state_of(WEST_OF_A - 1), NORTH)  # the wall between areas 1 and 3
    assert (after.cell, after.reward, after.terminated, after.time) == (WEST_OF_A - 1, -1, False, 1)


def test_a_passenger_boards_when_the_bus_enters_its_cell(bus: Bus):
    assert move(bus, state_of(FIRST_PASSENGER - 1), EAST).picked == 0b001
    assert move(bus, state_of(16 + 6), NORTH).picked == 0b010
    assert move(bus, state_of(28 + 6, picked=0b011), NORTH).picked == 0b111
    assert move(bus, state_of(FIRST_PASSENGER, picked=0b100), WEST).picked == 0b100


def test_crossing_a_site_damages_the_bus_only_while_it_is_under_construction(bus: Bus):
    sites = [(WEST_OF_A, EAST, EAST_OF_A, ROAD_A), (NORTH_OF_B, SOUTH, SOUTH_OF_B, ROAD_B)]
    for cell, action, beyond, road in sites + [(b, (a + 2) % 4, c, r) for c, a, b, r in sites]:
        for now in range(3):
            after = move(bus, state_of(cell, road=now), action)
            assert (after.cell, after.reward, after.terminated) == (beyond, -1, False)
            assert after.damaged == after.num_damage == (now == road)
        again = move(bus, state_of(cell, damaged=1, road=road), action)
        assert (again.damaged, again.num_damage) == (1, 0)


def test_a_damaged_bus_breaks_down_before_it_moves(bus: Bus):
    damaged = state_of(FIRST_PASSENGER - 1, damaged=1)
    broken = move(bus, damaged, EAST, mishap=WORD_RANGE // 4 - 1)
    assert (broken.cell, broken.picked, broken.reward, broken.terminated) == (FIRST_PASSENGER - 1, 0, -51, True)
    assert (broken.num_breakdown, broken.time) == (1, 1)
    lucky = move(bus, damaged, EAST, mishap=WORD_RANGE // 4)
    assert (lucky.cell, lucky.picked, lucky.damaged, lucky.reward) == (FIRST_PASSENGER, 1, 1, -1)
    assert (lucky.terminated, lucky.num_breakdown) == (False, 0)
    assert not move(bus, damaged._replace(damaged=jnp.int32(0)), EAST, mishap=0).terminated


def test_delivery_ends_the_episode_with_all_passengers_only(bus: Bus):
    for picked in range(8):
        after = move(bus, state_of(BESIDE_START, picked=picked), WEST)
        assert (after.cell, after.reward, after.terminated) == (START, -1, picked == 0b111)


def test_the_road_goes_round_to_each_other_status(bus: Bus):
    one, other = WORD_RANGE // 40 + 1, 0  # a change has probability 1/20, half of it for each status
    for road in range(3):
        reached = [move(bus, state_of(START, road=road), WEST, road=word).road for word in (CALM, one, other)]
        assert reached == [road, (road + 1) % 3, (road + 2) % 3]
    crossing = move(bus, state_of(WEST_OF_A, road=NO_ROAD), EAST, road=one)
    assert (crossing.road, crossing.damaged) == (ROAD_A, 0)  # a change takes effect on the next step


CROSSROADS = 8
WAYS = {NORTH: 2, EAST: 9, SOUTH: 14, WEST: 7}
"""Where the four moves lead from the crossroads."""


def test_a_slip_takes_any_or_another_direction(bus: Bus, bus_model: Model):
    other = Bus(slip="other")
    other_model = other.model()
    for action in range(4):
        shares_of_cells = {WAYS[a]: 0.925 if a == action else 0.025 for a in range(4)}
        assert shares(bus, bus_model, state_of(CROSSROADS), action, "cell") == shares_of_cells
        shares_of_cells = {WAYS[a]: 0.9 if a == action else 0.1 / 3 for a in range(4)}
        assert shares(other, other_model, state_of(CROSSROADS), action, "cell") == shares_of_cells


def test_a_road_changes_to_another_or_to_any_status(bus: Bus, bus_model: Model):
    redraw = Bus(road_change="any")
    redraw_model = redraw.model()
    for road in range(3):
        state = state_of(CROSSROADS, road=road)
        shares_of_roads = {r: 0.95 if r == road else 0.025 for r in range(3)}
        assert shares(bus, bus_model, state, EAST, "road") == shares_of_roads
        shares_of_roads = {r: 0.95 + 0.05 / 3 if r == road else 0.05 / 3 for r in range(3)}
        assert shares(redraw, redraw_model, state, EAST, "road") == shares_of_roads


def test_a_site_may_be_the_cell_behind_its_edge(bus: Bus):
    cell_bus = Bus(site="cell")
    south_of_it, inside = state_of(EAST_OF_A + 6, road=ROAD_A), state_of(EAST_OF_A, road=ROAD_A)
    assert [move(env, south_of_it, NORTH).damaged for env in (cell_bus, bus)] == [1, 0]
    assert [move(env, inside, WEST).damaged for env in (cell_bus, bus)] == [0, 1]
    assert move(cell_bus, state_of(WEST_OF_A, road=ROAD_A), EAST).damaged == 1
    assert move(cell_bus, state_of(NORTH_OF_B, road=ROAD_B), SOUTH).damaged == 1
    assert move(cell_bus, state_of(NORTH_OF_B, road=ROAD_A), SOUTH).damaged == 0
    bump = move(cell_bus, inside, NORTH)
    assert (bump.cell, bump.damaged) == (EAST_OF_A, 0)


def test_a_breakdown_may_come_after_the_move_and_the_damage(bus: Bus):
    after_bus, crossing = Bus(breakdown="after"), state_of(WEST_OF_A, road=ROAD_A)
    broken = move(after_bus, crossing, EAST, mishap=WORD_RANGE // 4 - 1)
    assert (broken.cell, broken.damaged, broken.reward, broken.terminated) == (EAST_OF_A, 1, -51, True)
    assert not move(after_bus, crossing, EAST, mishap=WORD_RANGE // 4).terminated
    assert not move(bus, crossing, EAST, mishap=0).terminated
    moved = move(after_bus, state_of(FIRST_PASSENGER - 1, damaged=1), EAST, mishap=0)
    assert (moved.cell, moved.picked, moved.reward, moved.terminated) == (FIRST_PASSENGER, 1, -51, True)


def test_parameters_set_the_shares_and_the_rewards(bus: Bus):
    params = BusParams(0.4, 0.5, 0.2, 0.2, -2.0, -30.0)
    model = bus.model(params)
    assert shares(bus, model, state_of(CROSSROADS), EAST, "cell")[9] == 0.7
    assert shares(bus, model, state_of(CROSSROADS), EAST, "road") == {0: 0.8, 1: 0.1, 2: 0.1}
    assert shares(bus, model, state_of(WEST_OF_A, road=ROAD_A), EAST, "damaged") == {0: 1 - 0.7 * 0.5, 1: 0.7 * 0.5}
    row = int(bus.encode(state_of(CROSSROADS, damaged=1))), EAST
    for reward, share in ((-2, 0.8), (-30, 0.2)):
        assert model.probability[row][model.reward[row] == reward].sum() == pytest.approx(share)


VARIANTS = [
    (Bus(), BusParams()),
    (Bus(site="cell", slip="other", road_change="any", breakdown="after"), BusParams(damage_probability=0.6)),
    (Bus(), BusParams(0.3, 0.2, 0.7, 0.5)),
]


@partial(jax.jit, static_argnums=(0, 1))
def all_outcomes(env: Bus, params: BusParams, words: tuple[jax.Array, ...]):
    """What the words do to every state under every action."""
    states = jax.vmap(env.decode)(jnp.arange(env.num_states, dtype=jnp.int32))
    over_actions = jax.vmap(env.transition, (None, 0, None, None))
    return jax.vmap(over_actions, (0, None, None, None))(states, jnp.arange(4, dtype=jnp.int32), words, params)


@given(variant=st.sampled_from(VARIANTS), words=st.tuples(*[st.integers(0, CALM)] * 3))
@settings(deadline=None, max_examples=60)
def test_words_on_the_same_side_of_all_cuts_have_one_outcome(variant: tuple[Bus, BusParams], words: tuple[int, ...]):
    env, params = variant
    edges = [[0, *(int(random.threshold(c)) for c in cuts)] for cuts in env.word_cuts(params)]
    lowest = [max(e for e in those if e <= word) for word, those in zip(words, edges, strict=True)]
    these, those = (tuple(jnp.uint32(w) for w in kind) for kind in (words, lowest))
    chex.assert_trees_all_equal(all_outcomes(env, params, these), all_outcomes(env, params, those))


@pytest.mark.parametrize("place", [(WEST_OF_A, 0, 0, ROAD_A), (NORTH_OF_B, 1, 5, NO_ROAD)])
def test_steps_happen_as_often_as_the_model_says(bus: Bus, bus_model: Model, place: tuple[int, ...]):
    state, keys = state_of(*place), jax.random.split(jax.random.key(3), 20_000)
    observed, _, reward, terminated, _, _ = jax.jit(jax.vmap(bus.step, (0, None, None)))(keys, state, jnp.int32(EAST))
    row = int(bus.encode(state)), EAST
    seen = np.stack([np.asarray(x, np.float64) for x in (observed, reward, terminated)])
    kinds = np.stack([bus_model.next_state[row], bus_model.reward[row], bus_model.terminated[row]])
    likely = bus_model.probability[row] > 0
    matches = np.all(kinds[:, likely, None] == seen[:, None], 0)
    assert np.all(matches.sum(0) == 1)
    expected = bus_model.probability[row][likely] * len(keys)
    statistic, freedom = np.sum((matches.sum(1) - expected) ** 2 / expected), likely.sum() - 1
    assert statistic < freedom + 4 * np.sqrt(2 * freedom)


def test_dtypes_are_those_of_reset_in_every_step(bus: Bus):
    def described(tree) -> list[tuple]:
        return [(x.shape, x.dtype.name, x.weak_type) for x in jax.tree.leaves(tree)]

    integer, real, boolean = (((), name, False) for name in ("int32", "float32", "bool"))
    for wrap in (lambda f: f, jax.jit):
        obs, state = wrap(bus.reset)(jax.random.key(0))
        assert described((obs, state)) == [integer] * 6
        after = wrap(bus.step)(jax.random.key(1), state, EAST)
        assert described(after[:2]) == described((obs, state))
        assert described(after[2:]) == [real, boolean, boolean, boolean, boolean]
        assert obs == bus.encode(state)
        assert bus.observation_space.contains(np.asarray(obs)[()])
        for action in (np.int64(EAST), jnp.uint8(EAST)):
            assert described(wrap(bus.step)(jax.random.key(1), state, action)) == described(after)


def test_resets_draw_every_road_and_refuse_old_keys(bus: Bus):
    _, states = jax.jit(jax.vmap(bus.reset))(jax.random.split(jax.random.key(0), 300))
    np.testing.assert_allclose(np.bincount(states.road) / 300, 1 / 3, atol=0.1)
    with pytest.raises(TypeError, match="new-style key"):
        bus.reset(jax.random.PRNGKey(0))


def test_swept_parameters_give_the_same_step(bus: Bus):
    keys = jax.random.split(jax.random.key(5), 500)
    state = state_of(WEST_OF_A, road=ROAD_A)
    fixed = jax.jit(jax.vmap(lambda k: bus.step(k, state, EAST)))(keys)
    swept = jax.jit(jax.vmap(bus.step, (0, None, None, None)))(keys, state, jnp.int32(EAST), BusParams())
    chex.assert_trees_all_equal(fixed, swept)


def test_step_truncates_at_the_limit_and_not_before(bus: Bus):
    key, wall = jax.random.key(0), WEST_OF_A - 1
    for time, expected in ((0, False), (998, False), (999, True)):
        *_, terminated, truncated, _ = bus.step(key, state_of(wall, time=time), NORTH)
        assert (bool(terminated), bool(truncated)) == (False, expected)
    assert bus.step(key, state_of(wall, time=4), NORTH, BusParams(max_steps=5))[4]
    calm = BusParams(slip_probability=0.0, max_steps=5)
    *_, terminated, truncated, _ = bus.step(key, state_of(BESIDE_START, picked=0b111, time=4), WEST, calm)
    assert (bool(terminated), bool(truncated)) == (True, False)


def test_equal_buses_share_compiled_code():
    assert Bus() == Bus(map=KAO_V1)
    assert hash(Bus()) == hash(Bus(map=KAO_V1))
    assert len({Bus(), Bus(), Bus(slip="other"), Bus(map=KAO_V1.replace("A", " "))}) == 3
    traced = []
    count = jax.jit(lambda env: traced.append(env) or jnp.int32(env.num_states), static_argnums=0)
    assert count(Bus()) == count(Bus()) == 2304
    assert len(traced) == 1


@pytest.mark.parametrize("option", ["site", "slip", "road_change", "breakdown"])
def test_unknown_options_are_refused(option: str):
    with pytest.raises(ValueError, match=f"{option} must be one of '.+', '.+', got 'nonsense'"):
        Bus(**{option: "nonsense"})


@pytest.mark.parametrize(
    "cells", [[" 1S", *["  1P"] * 9], [" 1S", *(f"{x} 1P" for x in "ABCDE")], [" 1S", *["  1 "] * 4095, "  1P"]]
)
def test_maps_that_cannot_be_read_or_numbered_are_refused(cells: list[str]):
    border = "+---" * len(cells) + "+"
    with pytest.raises(ValueError, match=r"map has \d+ (cells|passengers|construction sites); at most \d+ are allowed"):
        Bus(map="\n".join([border, f"|{''.join(cells)}|", border]))
    with pytest.raises(MapError, match="row 6, column 15"):
        Bus(map=KAO_V1[:144] + "?" + KAO_V1[145:])
