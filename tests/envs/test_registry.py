"""Environments by name: what is no name, no map, no option, or a number and not an option."""

from collections.abc import Callable

import pytest

import hrljax as hrl


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hrl.make(["Bus"]), r"name must be a string such as 'Bus', got \['Bus'\]"),
        (lambda: hrl.make(None), "name must be a string such as 'Bus', got None"),
        (lambda: hrl.make("Bus", map=5), "map must be a string such as .*, got 5"),
        (lambda: hrl.make("Gridworld", map=None), "map must be a string such as .*, got None"),
        (lambda: hrl.make("Mario", seeds=[5]), r"seeds must be a tuple, got \[5\]"),
        (lambda: hrl.make("Mario", levels=(5,)), r"levels\[0\] must be a string such as .*, got 5"),
        (lambda: hrl.make("Mario", quantum=4.0), r"quantum must be an integer from 1 to 64, got 4\.0"),
        (
            lambda: hrl.make("Bus", sites="edge"),
            "Bus has no option 'sites'; its options are map, site, slip, road_change",
        ),
        (lambda: hrl.make("Maze", map="S"), "Maze has no option 'map'; its options are none"),
        (
            lambda: hrl.make("Taxi", slip_probability=0.1),
            "Taxi has no option 'slip_probability': it is one of its numbers, .*"
            r"params=env.default_params._replace\(slip_probability=0.1\)",
        ),
        (lambda: hrl.make("Taxi", fickle=True, fickle_probability=1), "'fickle_probability': it is one of its numbers"),
        (lambda: hrl.register(5, object), "name must be a string such as 'MyWorld', got 5"),
        (lambda: hrl.register("Nothing", None), "make must be a function that returns an environment.*, got None"),
    ],
)
def test_what_is_of_the_wrong_type_is_refused(make: Callable[[], object], message: str):
    with pytest.raises(TypeError, match=message):
        make()
    assert "Nothing" not in hrl.registered()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hrl.make("bus"), "unknown environment 'bus'; known are BoyanChain, Bus, "),
        (lambda: hrl.make("Taxi", rules=["gymnasium"]), r"rules must be one of 'dietterich', 'gymnasium', got \['gym"),
        (
            lambda: hrl.make("Mario", preset=["thesis"]),
            r"preset must be one of 'competition', 'thesis', got \['thesis'\]",
        ),
        (lambda: hrl.make("Mario", level_type=5), r"level_type must be an integer from 0 to 2 \(overground.*, got 5"),
    ],
)
def test_a_wrong_value_is_refused(make: Callable[[], object], message: str):
    with pytest.raises(ValueError, match=message):
        make()
