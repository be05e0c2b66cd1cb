"""Pictures of Maze, Gridworld and Taxi: what they show, where, and in which words they refuse."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from hrljax.envs.grid import cell_render
from hrljax.envs.grid.cell_world import CellState
from hrljax.envs.grid.gridworld import Gridworld
from hrljax.envs.grid.map import FOUR_ROOMS
from hrljax.envs.grid.maze import Maze
from hrljax.envs.taxi import render
from hrljax.envs.taxi.env import ABOARD, MAP, Taxi, TaxiState
from tests.pictures import arrows, image_of, strings

RED, GREEN, YELLOW, BLUE = range(4)
HOUSE = Gridworld(map="S.P\n#a#\n..G\n")
WORLDS = {"Maze": Maze(), "four rooms": Gridworld(), "house": HOUSE}
each_world = pytest.mark.parametrize("env", WORLDS.values(), ids=WORLDS)


def at(cell: int) -> CellState:
    return CellState(jnp.int32(cell), jnp.int32(0))


def taxi_at(cell: int, passenger: int, destination: int = GREEN, fickle: int = 0) -> TaxiState:
    return TaxiState(*(jnp.int32(x) for x in (cell, passenger, destination, fickle, 0)))


def directions(axes: Axes, width: int) -> dict[int, tuple[int, int]]:
    """The direction (down, right) of the arrow in each cell that has one."""
    quiver = arrows(axes)
    cells = np.asarray(quiver.get_offsets(), int) @ (1, width)
    signs = np.sign([quiver.V, quiver.U]).T.astype(int)
    return {cell: tuple(sign) for cell, sign in zip(cells.tolist(), signs.tolist(), strict=True)}


def coloured(axes: Axes) -> np.ndarray:
    """Cells that a value colours."""
    return np.flatnonzero(~np.ma.getmaskarray(image_of(axes)))


def test_text_of_a_gridworld_is_its_source_and_the_agent_stands_in_it():
    assert cell_render.text(Gridworld()) == FOUR_ROOMS
    assert cell_render.text(HOUSE, at(7)) == "S.P\n#a#\n.@G\n"
    lines = cell_render.text(Maze(), at(2 * 6 + 3)).splitlines()
    assert lines[5] == "|             @ |       |"
    assert "".join(lines).count("@") == 1
    assert "G" in lines[1]


@each_world
def test_map_names_what_is_marked_and_fills_the_walls(env):
    axes = cell_render.draw_map(env)
    assert sorted(strings(axes)) == sorted(env.layout.marks.values())
    solid = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    assert {tuple(round(x + 0.5) for x in patch.get_xy()) for patch in solid} == {
        divmod(cell, env.layout.width)[::-1] for cell in np.flatnonzero(env.layout.wall).tolist()
    }
    assert "@" in strings(cell_render.draw_map(env, state=at(0)))


def test_map_of_the_maze_draws_the_wall_with_two_doors():
    walls = cell_render.draw_map(Maze()).collections[2]
    middles = {tuple(np.mean(np.asarray(path.vertices), 0).tolist()) for path in walls.get_paths()}
    assert {row for row in range(7) if (3.5, float(row)) in middles} == {0, 2, 3, 4, 6}


@each_world
def test_policy_and_value_are_drawn_where_an_episode_goes_on(env):
    generator = np.random.default_rng(0)
    policy = generator.integers(0, env.num_actions, env.num_states)
    value = generator.uniform(-50, -10, env.num_states)
    drawn = directions(cell_render.draw_policy(env, policy), env.layout.width)
    steps = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
    goes_on = np.flatnonzero(~env.layout.ends).tolist()
    assert drawn == {cell: steps[env.action_names[policy[cell]]] for cell in goes_on}
    axes = cell_render.draw_value(env, value)
    assert coloured(axes).tolist() == goes_on
    numbers = sorted(s for s in strings(axes) if "." in s)
    assert numbers == sorted(f"{value[cell]:.1f}" for cell in goes_on)
    (bar,) = (child for child in axes.child_axes if isinstance(child, Axes))
    assert bar.get_ylabel() == "expected return"


def test_text_of_a_taxi_tells_its_state():
    assert render.text(Taxi()) == MAP
    *lines, status = render.text(Taxi(), taxi_at(5, YELLOW)).splitlines()
    assert (lines[3], lines[9]) == ("|@      |           |", "| Yp|       | B     |")
    assert status == "passenger: Y | destination: G"
    *lines, status = render.text(Taxi(fickle=True), taxi_at(0, ABOARD, BLUE, fickle=1)).splitlines()
    assert lines[1] == "|&R     |         G |"
    assert "p" not in "".join(lines)
    assert status == "passenger: in the taxi | destination: B | may change"


def test_map_of_a_taxi_shows_its_depots_and_its_state():
    plain = render.draw_map(Taxi())
    assert strings(plain) == list("RGYB")
    assert not plain.patches
    waiting = render.draw_map(Taxi(), state=taxi_at(12, RED, BLUE))
    assert strings(waiting) == [*"RGYB", "P"]
    assert waiting.get_title() == "passenger: R | destination: B"
    (ring,) = (patch for patch in waiting.patches if not patch.get_fill())
    assert ring.get_center() == (3, 4)  # type: ignore[attr-defined]


def test_policy_of_a_taxi_has_arrows_for_moves_and_words_for_the_rest():
    env, policy = Taxi(), np.arange(500) // 20 % 6
    axes = render.draw_policy(env, policy, passenger=ABOARD, destination=RED)
    steps = ((1, 0), (-1, 0), (0, 1), (0, -1))
    assert directions(axes, 5) == {cell: steps[cell % 6] for cell in range(25) if cell % 6 < 4}
    assert strings(axes).count("pick\nup") == strings(axes).count("put\ndown") == 4
    assert coloured(render.draw_value(env, policy, passenger=RED, destination=RED)).tolist() == list(range(25))


def test_value_of_a_taxi_is_drawn_where_the_state_occurs():
    env = Taxi(fickle=True, rules="gymnasium")
    value = np.arange(1000.0)
    before = render.draw_value(env, value, passenger=ABOARD, destination=GREEN, fickle=1)
    assert coloured(before).tolist() == [0, 20, 23]  # nobody waits at the destination
    assert str(500 + (20 * 5 + ABOARD) * 4 + GREEN) in strings(before)
    after = render.draw_value(env, value, passenger=ABOARD, destination=GREEN)
    assert coloured(after).tolist() == list(range(25))
    assert not coloured(render.draw_value(env, value, passenger=GREEN, destination=GREEN)).size


def test_drawing_on_given_axes_and_pixels_of_one_size():
    axes = Figure().subplots(1, 2)
    assert cell_render.draw_policy(HOUSE, np.zeros(9, np.int32), axes[0]) is axes[0]
    assert render.draw_value(Taxi(), np.zeros(500), axes[1], passenger=0, destination=1) is axes[1]
    for pictures in (
        [cell_render.rgb_array(HOUSE, at(cell)) for cell in (0, 1, 4)],
        [render.rgb_array(Taxi(), s) for s in (taxi_at(3, RED), taxi_at(3, ABOARD), taxi_at(4, RED))],
    ):
        assert {(p.shape, p.dtype) for p in pictures} == {(pictures[0].shape, np.dtype(np.uint8))}
        assert all((a != b).any() for i, a in enumerate(pictures) for b in pictures[:i])


TAXI_POLICY, TAXI_VALUE = np.zeros(500, np.int32), np.zeros(500)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: cell_render.draw_policy(HOUSE, np.full(9, 4)),
            "policy must have actions 0 to 3, or -1 for none, got 4 to 4",
        ),
        (lambda: cell_render.draw_policy(HOUSE, np.zeros(9)), r"policy must be integers of shape \(9,\), got float64"),
        (lambda: cell_render.draw_value(Maze(), np.zeros(9)), r"value must be real numbers of shape \(42,\)"),
        (lambda: cell_render.text(HOUSE, at(9)), r"state.cell must be an integer from 0 to 8 \(row .*\), got 9"),
        (lambda: render.draw_policy(Taxi(), TAXI_POLICY[1:], passenger=0, destination=0), r"shape \(500,\)"),
        (
            lambda: render.draw_value(Taxi(), TAXI_VALUE, passenger=5, destination=0),
            "passenger must be an integer from 0 to 4 .*4: in the taxi.*, got 5",
        ),
        (
            lambda: render.draw_value(Taxi(), TAXI_VALUE, passenger=0, destination=4),
            "destination must be an integer from 0 to 3 .0: R, 1: G, 2: Y, 3: B., got 4",
        ),
        (lambda: render.text(Taxi(), taxi_at(0, 0, fickle=1)), "state.fickle must be an integer from 0 to 0 .*"),
        (
            lambda: render.rgb_array(Taxi(), taxi_at(25, 0)),
            "state.cell must be .* from 0 to 24 .*, got 25",
        ),
    ],
)
def test_errors_name_the_argument_the_value_and_what_is_allowed(call: Callable[[], object], message: str):
    with pytest.raises(ValueError, match=message):
        call()
