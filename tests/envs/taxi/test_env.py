"""The Taxi domain: steps by hand, its published optima, and Gymnasium's own transition table."""

from functools import cache, partial
from types import SimpleNamespace

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.core.random import WORD_RANGE
from hrljax.envs.taxi.env import ABOARD, FickleTaxiParams, Taxi, TaxiParams, TaxiState, taxi_layout
from hrljax.solvers import Model, value_iteration
from tests.words import CALM

SOUTH, NORTH, EAST, WEST, PICKUP, PUTDOWN = range(6)
RED, GREEN, YELLOW, BLUE = range(4)
AT = dict(zip((RED, GREEN, YELLOW, BLUE), (0, 4, 20, 23), strict=True))
MIDDLE = 12


def state_of(cell: int, passenger: int = RED, destination: int = GREEN, fickle: int = 0) -> TaxiState:
    return TaxiState(*(jnp.int32(x) for x in (cell, passenger, destination, fickle, 0)))


@partial(jax.jit, static_argnums=0)
def transition(env: Taxi, state: TaxiState, action: jax.Array, words: tuple[jax.Array, ...]):
    return env.transition(state, action, words, env.default_params)


def move(env: Taxi, state: TaxiState, action: int, slip: int = CALM, mind: int = CALM) -> SimpleNamespace:
    words = jnp.uint32(slip), jnp.uint32(mind)
    after, reward, ended, info = transition(env, state, jnp.int32(action), words)
    fields = {name: int(value) for name, value in after._asdict().items()}
    return SimpleNamespace(**fields, reward=float(reward), ended=bool(ended), illegal=bool(info["illegal"]))


with_gymnasiums_taxi = pytest.mark.skipif(
    "Taxi-v4" not in gymnasium.registry, reason="this Gymnasium is too old for Taxi-v4"
)


@cache
def solved(env: Taxi) -> tuple[Model, np.ndarray]:
    model = env.model()
    return model, np.asarray(value_iteration(model).value, np.float64)


@with_gymnasiums_taxi
def test_states_have_gymnasiums_numbers_and_a_fickle_taxi_as_many_again():
    original = gymnasium.make("Taxi-v4").unwrapped
    for number in range(500):
        row, column, passenger, destination = original.decode(number)
        state = state_of(5 * row + column, passenger, destination)
        assert int(Taxi().encode(state)) == int(Taxi(fickle=True).encode(state)) == number
    assert int(Taxi(fickle=True).encode(state_of(24, ABOARD, BLUE, fickle=1))) == 999
    assert (Taxi().num_states, Taxi(fickle=True).num_states) == (500, 1000)


@with_gymnasiums_taxi
def test_the_map_is_gymnasiums():
    original = gymnasium.make("Taxi-v4").unwrapped
    assert [divmod(cell, 5) for cell in taxi_layout().depots] == original.locs
    for action, name in enumerate(("south", "north", "east", "west", "pickup", "putdown")):
        assert Taxi.action_names[action] == name


@with_gymnasiums_taxi
@pytest.mark.parametrize("stochastic", [False, True])
def test_the_model_under_gymnasiums_rules_is_gymnasiums_table(stochastic: bool):
    table = gymnasium.make("Taxi-v4", is_rainy=stochastic).unwrapped.P
    model, value = solved(Taxi(stochastic=stochastic, rules="gymnasium"))
    for state, action in np.ndindex(500, 6):
        theirs: dict[tuple[int, float, bool], float] = {}
        for probability, *outcome in table[state][action]:
            key = int(outcome[0]), float(outcome[1]), bool(outcome[2])
            theirs[key] = theirs.get(key, 0.0) + probability
        columns = zip(*(field[state, action].tolist() for field in model), strict=True)
        ours = {(after, reward, ended): p for after, p, reward, ended in columns if p > 0}
        assert ours == pytest.approx(theirs, abs=1e-7)
    np.testing.assert_allclose(value, solved_by_hand(table), atol=1e-4)


def solved_by_hand(table: dict) -> np.ndarray:
    """Value iteration on a table in Gymnasium's form, ``[S]``."""
    outcomes = [(s, a, *o) for s, actions in table.items() for a, rows in actions.items() for o in rows]
    state, action, probability, after, reward, ended = (np.array(column) for column in zip(*outcomes, strict=True))
    value, change = np.zeros(500), 1.0
    while change > 1e-9:
        q = np.bincount(6 * state + action, probability * (reward + ~ended * value[after])).reshape(500, 6)
        value, change = q.max(-1), np.abs(q.max(-1) - value).max()
    return value


@with_gymnasiums_taxi
def test_starts_under_gymnasiums_rules_are_gymnasiums():
    distribution = gymnasium.make("Taxi-v4").unwrapped.initial_state_distrib
    ours = Taxi(rules="gymnasium").initial_distribution()
    np.testing.assert_allclose(ours, distribution, atol=1e-7)
    fickle = Taxi(fickle=True, rules="gymnasium").initial_distribution()
    np.testing.assert_array_equal(fickle, np.concatenate([np.zeros(500), ours]))
    assert np.count_nonzero(Taxi().initial_distribution()) == 400
    np.testing.assert_allclose(Taxi().initial_distribution()[Taxi().initial_distribution() > 0], 1 / 400, rtol=1e-5)


OPTIMA = [
    (False, False, 8.555, 6.930, 7.930),
    (True, False, 5.149, 2.955, 3.955),
    (False, True, 8.893, 7.380, 8.380),
    (True, True, 5.614, 3.576, 4.576),
]


@pytest.mark.parametrize(("stochastic", "fickle", "all_starts", "distinct", "gym"), OPTIMA)
def test_optimal_expected_returns(stochastic: bool, fickle: bool, all_starts: float, distinct: float, gym: float):
    env, gym_env = Taxi(stochastic, fickle), Taxi(stochastic, fickle, rules="gymnasium")
    start, gym_start = env.initial_distribution(), gym_env.initial_distribution()
    (_, value), (_, gym_value) = solved(env), solved(gym_env)
    assert start @ value == pytest.approx(all_starts, abs=6e-4)
    assert gym_start @ value == pytest.approx(distinct, abs=6e-4)
    assert gym_start @ gym_value == pytest.approx(gym, abs=6e-4)


def test_a_ride_from_red_to_blue_is_worth_ten_one_move_away_from_the_passenger():
    """20 for the delivery; one move, the pickup, seven moves around the walls and the putdown cost 1 each."""
    start = int(Taxi().encode(state_of(5, RED, BLUE)))
    assert solved(Taxi())[1][start] == pytest.approx(20 - 1 - 1 - 7 - 1)


def test_moves_stop_at_walls_and_nothing_else_changes():
    for action, cell, after in (
        (SOUTH, 12, 17), (NORTH, 12, 7), (EAST, 12, 13), (WEST, 12, 11),
        (EAST, 1, 1), (EAST, 6, 6), (EAST, 11, 12), (WEST, 2, 2), (EAST, 15, 15), (EAST, 20, 20), (WEST, 23, 23),
        (NORTH, 4, 4), (SOUTH, 24, 24),
    ):  # fmt: skip
        result = move(Taxi(), state_of(cell, GREEN, BLUE), action)
        assert (result.cell, result.reward, result.ended, result.illegal) == (after, -1, False, False)
        assert (result.passenger, result.destination, result.time) == (GREEN, BLUE, 1)


@pytest.mark.parametrize("rules", ["dietterich", "gymnasium"])
def test_a_pickup_is_allowed_where_the_passenger_waits(rules: str):
    env = Taxi(rules=rules)
    for waits in range(4):
        for cell in range(25):
            result = move(env, state_of(cell, waits, (waits + 1) % 4), PICKUP)
            may_board = cell == AT[waits]
            assert (result.passenger, result.cell, result.illegal) == (
                ABOARD if may_board else waits,
                cell,
                not may_board,
            )
            assert (result.reward, result.ended) == (-1 if may_board else -10, False)
    for cell in (AT[RED], MIDDLE):
        again = move(env, state_of(cell, ABOARD), PICKUP)
        assert (again.reward, again.passenger, again.illegal) == (-10, ABOARD, True)


@pytest.mark.parametrize(("rules", "delivery"), [("dietterich", 19), ("gymnasium", 20)])
def test_a_putdown_delivers_at_the_destination(rules: str, delivery: float):
    env = Taxi(rules=rules)
    done = move(env, state_of(AT[GREEN], ABOARD, GREEN), PUTDOWN)
    assert (done.reward, done.ended, done.passenger, done.illegal) == (delivery, True, GREEN, False)
    for state in (state_of(MIDDLE, ABOARD), state_of(AT[GREEN], RED), state_of(AT[GREEN], GREEN)):
        result = move(env, state, PUTDOWN)
        assert (result.reward, result.ended, result.illegal) == (-10, False, True)
        assert result.passenger == int(state.passenger)


def test_a_putdown_at_another_depot_is_allowed_by_gymnasium_only():
    state = state_of(AT[BLUE], ABOARD, GREEN)
    ours, theirs = move(Taxi(), state, PUTDOWN), move(Taxi(rules="gymnasium"), state, PUTDOWN)
    assert (ours.reward, ours.passenger, ours.illegal, ours.ended) == (-10, ABOARD, True, False)
    assert (theirs.reward, theirs.passenger, theirs.illegal, theirs.ended) == (-1, BLUE, False, False)


def test_a_stochastic_taxi_slips_to_either_side():
    env, right, left = Taxi(stochastic=True), WORD_RANGE // 10 + 1, WORD_RANGE // 10
    ways = {SOUTH: (17, 11, 13), NORTH: (7, 13, 11), EAST: (13, 17, 7), WEST: (11, 7, 17)}
    for action, expected in ways.items():
        cells = tuple(move(env, state_of(MIDDLE), action, slip=word).cell for word in (CALM, right, left))
        assert cells == expected
        assert move(Taxi(), state_of(MIDDLE), action, slip=0).cell == expected[0]
    model, _ = solved(env)
    row = int(env.encode(state_of(MIDDLE))), EAST
    chances = dict(zip((model.next_state[row] // 20).tolist(), model.probability[row].tolist(), strict=True))
    assert chances == pytest.approx({13: 0.8, 17: 0.1, 7: 0.1}, abs=1e-7)
    assert move(env, state_of(AT[RED]), PICKUP, slip=0).passenger == ABOARD


def test_a_move_against_a_wall_slips_unless_by_gymnasiums_rules():
    against = state_of(6), EAST
    assert move(Taxi(stochastic=True), *against, slip=0).cell == 1
    assert move(Taxi(stochastic=True, rules="gymnasium"), *against, slip=0).cell == 6
    assert move(Taxi(stochastic=True, rules="gymnasium"), state_of(6), WEST, slip=0).cell == 11


def test_a_fickle_passenger_changes_the_destination_on_the_first_move_and_then_never():
    env = Taxi(fickle=True)
    third = WORD_RANGE * 3 // 10 // 3
    at_source = state_of(AT[RED], ABOARD, GREEN, fickle=1)
    for word, destination in ((0, RED), (third + 9, BLUE), (2 * third + 9, YELLOW), (3 * third + 9, GREEN)):
        left = move(env, at_source, SOUTH, mind=word)
        assert (left.destination, left.fickle, left.cell) == (destination, 0, 5)
    bump = move(env, at_source, NORTH, mind=0)
    assert (bump.destination, bump.fickle) == (GREEN, 1)
    still = move(env, at_source, PUTDOWN, mind=0)
    assert (still.destination, still.fickle) == (GREEN, 1)
    settled = move(env, at_source._replace(fickle=jnp.int32(0)), SOUTH, mind=0)
    assert (settled.destination, settled.fickle) == (GREEN, 0)
    empty = move(env, state_of(AT[RED], GREEN, YELLOW, fickle=1), SOUTH, mind=0)
    assert (empty.destination, empty.fickle) == (YELLOW, 1)
    assert move(env, state_of(AT[RED], RED, GREEN, fickle=1), PICKUP, mind=0).fickle == 1


def test_the_settled_half_of_a_fickle_taxi_is_the_taxi():
    plain, fickle = solved(Taxi(stochastic=True))[0], solved(Taxi(stochastic=True, fickle=True))[0]
    for ours, theirs in zip(plain, fickle, strict=True):
        np.testing.assert_array_equal(ours, theirs[:500, :, : ours.shape[-1]])


def test_numbers_are_those_of_the_kind_of_taxi():
    assert Taxi().default_params == TaxiParams(0.0, -1.0, 19.0, -10.0, 1000)
    assert Taxi(stochastic=True, rules="gymnasium").default_params == TaxiParams(0.2, delivery_reward=20.0)
    assert Taxi(fickle=True).default_params == FickleTaxiParams(fickle_probability=0.3)
    with pytest.raises(ValueError, match=r"'env\.fickle_probability' cannot be swept"):
        hrl.sweep(Taxi(), hrl.QLearning(), seeds=1, num_episodes=1, axes={"env.fickle_probability": [0.1]})


@pytest.mark.parametrize("option", ["stochastic", "fickle", "rules"])
def test_unknown_options_are_refused(option: str):
    with pytest.raises(ValueError, match=f"{option} must be one of .+, .+, got 'nonsense'"):
        hrl.make("Taxi", **{option: "nonsense"})


def test_the_hierarchy_has_three_levels_and_dietterichs_terminations():
    graph = Taxi().hierarchy()
    navigate = tuple(f"Navigate({name})" for name in "RGYB")
    assert [task.name for task in graph.subtasks] == ["Root", "Get", "Put", *navigate]
    assert graph.root.children == ("Get", "Put")
    assert graph["Get"].children == ("pickup", *navigate)
    assert graph["Put"].children == ("putdown", *navigate)
    assert graph.depth == 3
    assert graph.leaf_cover() == ("Get", "Put", *navigate)
    assert not graph.is_total_leaf_cover()
    states = jax.vmap(Taxi().decode)(jnp.arange(500, dtype=jnp.int32))
    aboard = np.asarray(states.passenger) == ABOARD
    expected = {"Root": (np.zeros(500, bool), None), "Get": (aboard, aboard)}
    expected["Put"] = ~aboard, np.asarray(states.passenger == states.destination)
    expected |= {name: (np.asarray(states.cell) == AT[i],) * 2 for i, name in enumerate(navigate)}
    for name, (ended, goal) in expected.items():
        assert graph[name].children
        np.testing.assert_array_equal(jax.vmap(graph[name].termination)(states), ended)
        if goal is not None:
            np.testing.assert_array_equal(jax.vmap(graph[name].goal)(states), goal)
