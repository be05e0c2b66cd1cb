"""Pictures that are drawn from an exact model and from variables: the same cells and walls as those of a known map."""

from collections.abc import Mapping

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

import hrljax as hrl
from hrljax.envs.grid import cell_render, variable_render
from hrljax.envs.grid.gridworld import Gridworld
from hrljax.envs.grid.maze import Maze
from hrljax.envs.table import Table, TableEnvironment, TableState
from hrljax.envs.taxi.env import ABOARD, SIZE, Taxi, TaxiState, taxi_layout
from hrljax.interop.gymnasium import from_table
from hrljax.solvers import Model
from tests.pictures import arrows, image_of, strings

LAKE = from_table(gymnasium.make("FrozenLake-v1"))
HOUSE = Gridworld(map="S.P\n#a#\n..G\n")


class Corridor(TableEnvironment):
    """Five cells in a row: left and right; a lever in the third one opens the last one, where the episode ends."""

    renderer = "hrljax.envs.grid.variable_render"

    def variables(self, state: TableState) -> Mapping[str, Array]:
        return {"column": state.number % 5, "is_open": state.number // 5}


def corridor() -> Corridor:
    state = np.arange(10)
    column, is_open = state % 5, state // 5
    after = np.stack([np.maximum(column - 1, 0), np.minimum(column + 1, 4 - (is_open == 0)), column], 1)
    pulled = np.maximum(is_open[:, None], (column[:, None] == 2) & (np.arange(3) == 2))
    next_state = (after + 5 * pulled)[..., None].astype(np.int32)
    model = Model(next_state, np.ones((10, 3, 1)), -np.ones((10, 3, 1)), next_state == 9)
    return Corridor(Table(model, np.eye(10)[0]), action_names=("left", "RIGHT", "pull the lever"))


@pytest.mark.parametrize("env", [Maze(), Gridworld(), HOUSE], ids=["Maze", "four rooms", "house"])
def test_walls_and_ends_are_those_of_the_map(env: Maze | Gridworld):
    layout, plan = env.layout, variable_render._plan(env)
    goes_on = ~layout.ends
    np.testing.assert_array_equal(plan.ground.neighbour[goes_on], layout.neighbour[goes_on])
    np.testing.assert_array_equal(plan.goes_on, goes_on)
    assert set(plan.ends) == set(np.flatnonzero(layout.ends & ~layout.wall).tolist())


def test_walls_of_the_taxi_are_those_of_its_map():
    np.testing.assert_array_equal(variable_render._plan(Taxi()).ground.neighbour, taxi_layout().neighbour)


def test_arrows_and_values_are_those_that_the_map_draws():
    env = HOUSE
    policy, value = np.arange(9) % env.num_actions, np.linspace(-9, -1, 9)
    ours, theirs = (module.draw_policy(env, policy) for module in (variable_render, cell_render))
    np.testing.assert_array_equal(arrows(ours).get_offsets(), arrows(theirs).get_offsets())
    np.testing.assert_array_equal((arrows(ours).U, arrows(ours).V), (arrows(theirs).U, arrows(theirs).V))
    ours, theirs = (image_of(module.draw_value(env, value)) for module in (variable_render, cell_render))
    np.testing.assert_array_equal(np.ma.getmaskarray(ours), np.ma.getmaskarray(theirs))
    np.testing.assert_array_equal(ours.compressed(), theirs.compressed())


def test_a_frozen_lake_has_pictures():
    assert LAKE.render(TableState(jnp.int32(4), jnp.int32(0))) == "....\n@E.E\n...E\nE..E\n"
    policy = hrl.solvers.value_iteration(LAKE.model()).policy
    axes = hrl.plots.policy(LAKE, policy)
    assert strings(axes) == ["end\n0"] * 4 + ["end\n1"]
    assert len(arrows(axes).get_offsets()) == 11
    walls = axes.collections[2].get_paths()  # type: ignore[attr-defined]
    assert len(walls) == 16  # the border alone
    picture = LAKE.render(TableState(jnp.int32(15), jnp.int32(0)), "rgb_array")
    assert picture.shape == LAKE.render(TableState(jnp.int32(0), jnp.int32(0)), "rgb_array").shape


def test_the_rest_of_a_state_is_given_by_name():
    env = corridor()
    hrl.check(env)
    assert env.render(TableState(jnp.int32(7), jnp.int32(0))) == "..@.E\nis_open 1\n"
    policy = np.array([1, 1, 2, 0, 0, 1, 1, 1, 1, 0])
    closed, is_open = hrl.plots.policy(env, policy), hrl.plots.policy(env, policy, is_open=1)
    assert (closed.get_title(), is_open.get_title()) == ("is_open 0", "is_open 1")
    assert strings(closed) == ["end\n-1", "pull the lever"]
    assert arrows(closed).U.tolist() == pytest.approx([0.56, 0.56, -0.56])
    assert arrows(is_open).U.tolist() == pytest.approx([0.56] * 4)
    assert image_of(hrl.plots.value(env, np.arange(10.0), is_open=1)).compressed().tolist() == [5, 6, 7, 8]


def test_the_state_of_a_taxi_stands_above():
    state = TaxiState(*(jnp.int32(x) for x in (SIZE + 2, ABOARD, 1, 0, 0)))
    axes = variable_render.draw_map(Taxi(), state=state)
    assert axes.get_title() == "passenger 4, destination 1"
    assert [patch.get_center() for patch in axes.patches] == [(2, 1)]  # type: ignore[attr-defined]
    assert variable_render.text(Taxi(), state).splitlines()[1:] == [
        "..@..",
        *["....."] * 3,
        "passenger 4, destination 1",
    ]


def test_what_cannot_be_drawn_is_refused():
    env, policy = corridor(), np.zeros(10, np.int32)
    with pytest.raises(TypeError, match="'lever' is no variable beside the cell, only 'is_open'"):
        hrl.plots.policy(env, policy, lever=1)
    with pytest.raises(ValueError, match=r"is_open must be .* 0 to 1.*got 2"):
        hrl.plots.policy(env, policy, is_open=2)
    with pytest.raises(ValueError, match=r"policy must be integers of shape \(10,\)"):
        hrl.plots.policy(env, policy[:3])
    with pytest.raises(TypeError, match=r"variables must have a 'column'.*there are number"):
        variable_render.draw_map(TableEnvironment(env.table))
    with pytest.raises(ValueError, match=r"shape must be rows and columns of 10 cells, got \(3, 3\)"):
        TableEnvironment(env.table, shape=(3, 3))
    with pytest.raises(ValueError, match=r"shape must be rows and columns of 10 cells, got \(-2, -5\)"):
        TableEnvironment(env.table, shape=(-2, -5))
    with pytest.raises(TypeError, match="shape must be a sequence of integers, got 10"):
        TableEnvironment(env.table, shape=10)  # type: ignore[arg-type]
