"""Maps drawn by `hrl.plots`."""

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import hrljax as hrl
from tests.pictures import arrows, strings

CORNER = "S..\n..G"


def test_a_policy_is_drawn_as_its_moves():
    env = hrl.make("Gridworld", map=CORNER)
    ax = hrl.plots.policy(env, [1, 1, 2, 1, 1, 0])  # east, east, south; east, east; in the goal nothing
    drawn = arrows(ax)
    np.testing.assert_array_equal(drawn.U > 0.1, [True, True, False, True, True])
    np.testing.assert_array_equal(drawn.V > 0.1, [False, False, True, False, False])


def test_where_a_policy_has_no_action_nothing_is_drawn():
    env = hrl.make("Gridworld", map=CORNER)
    ax = hrl.plots.policy(env, [1, -1, -1, -1, 1, -1])
    np.testing.assert_array_equal(arrows(ax).XY, [[0, 0], [1, 1]])


def test_values_are_written_into_their_cells():
    env = hrl.make("Gridworld", map=CORNER)
    value = hrl.solvers.value_iteration(env.model()).value
    assert {"-3.00", "-2.00", "-1.00"} <= set(strings(hrl.plots.value(env, value)))


def test_a_state_is_drawn_where_it_is():
    env = hrl.make("Gridworld", map=CORNER)
    ax = Figure().subplots()
    assert hrl.plots.state(env, env.decode(1), ax) is ax
    assert "@" in strings(ax)
    assert "@" not in strings(hrl.plots.state(env))


def test_the_rest_of_a_state_is_given_by_name():
    env = hrl.make("Taxi")
    solution = hrl.solvers.value_iteration(env.model())
    assert "pick\nup" in strings(hrl.plots.policy(env, solution.policy, passenger=0, destination=1))
    with pytest.raises(ValueError, match="destination must be"):
        hrl.plots.value(env, solution.value, passenger=0, destination=7)


@pytest.mark.parametrize("draw", [hrl.plots.policy, hrl.plots.value])
def test_what_has_no_map_is_refused(draw: Callable[..., Axes]):
    chain = hrl.make("BoyanChain")
    with pytest.raises(TypeError, match=r"renderer has a function draw_.*BoyanChain"):
        draw(chain, np.zeros(chain.num_states, np.int32))
    with pytest.raises(TypeError, match="draw_"):
        draw(hrl.make("Mario"), [0])
