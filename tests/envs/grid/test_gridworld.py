"""Gridworlds: maps and their errors, steps by hand, and hierarchies of rooms and hallways."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hrljax as hrl
from hrljax.core.random import WORD_RANGE
from hrljax.envs.grid.ascii_map import MapError
from hrljax.envs.grid.cell_world import CellMap, CellState
from hrljax.envs.grid.gridworld import GridParams, Gridworld
from hrljax.envs.grid.map import CLIFF, FOUR_ROOMS, parse
from hrljax.solvers import value_iteration
from tests.words import CALM

NORTH, EAST, SOUTH, WEST = range(4)
SMALL = """\
S.#.
..aG
P.#.
"""


def move(env: Gridworld, row: int, column: int, action: int, word: int = CALM, **numbers: float):
    state = CellState(jnp.int32(row * env.layout.width + column), jnp.int32(0))
    params = GridParams(**numbers)
    after, reward, ended, info = env.transition(state, jnp.int32(action), (jnp.uint32(word),), params)
    return divmod(int(after.cell), env.layout.width), float(reward), bool(ended), bool(info["pit"])


def drawn(cells: np.ndarray, layout: CellMap) -> list[str]:
    """A mask as rows of x and dots."""
    return ["".join(".x"[int(c)] for c in row) for row in cells.reshape(layout.height, layout.width)]


def test_a_map_is_read_as_it_is_drawn():
    layout = parse(SMALL)
    assert (layout.height, layout.width, layout.num_cells, layout.text) == (3, 4, 12, SMALL)
    assert drawn(layout.wall, layout) == ["..x.", "....", "..x."]
    assert drawn(layout.starts, layout) == ["x...", "....", "...."]
    assert drawn(layout.goal, layout) == ["....", "...x", "...."]
    assert drawn(layout.pit, layout) == ["....", "....", "x..."]
    assert layout.region.reshape(3, 4).tolist() == [[0, 0, -1, 1], [0, 0, 2, 1], [0, 0, -1, 1]]
    assert layout.marks == {0: "S", 6: "a", 7: "G", 8: "P"}
    assert layout.neighbour.dtype == layout.region.dtype == np.int32


@given(st.lists(st.text("#.SGPab", min_size=4, max_size=4), min_size=1, max_size=4))
@settings(deadline=None, max_examples=100, derandomize=True)
def test_moves_join_the_cells_that_are_not_walls(rows: list[str]):
    try:
        layout = parse("\n".join(rows))
    except MapError:
        return
    inside = {(r, c) for r, row in enumerate(rows) for c, mark in enumerate(row) if mark != "#"}
    for (row, column), reached in zip(np.ndindex(len(rows), 4), layout.neighbour.tolist(), strict=True):
        for (down, right), cell in zip(((-1, 0), (0, 1), (1, 0), (0, -1)), reached, strict=True):
            beyond = row + down, column + right
            opened = (row, column) in inside and beyond in inside
            assert divmod(cell, 4) == (beyond if opened else (row, column))


@pytest.mark.parametrize(
    ("text", "row", "column", "problem"),
    [
        pytest.param(SMALL.replace("a", "?"), 2, 3, "unknown character '?'; a cell is # (wall)", id="unknown"),
        pytest.param(SMALL.replace("a", " "), 2, 3, "unknown character ' '", id="blank"),
        pytest.param(SMALL.replace("a", "é"), 2, 3, "unknown character 'é'", id="not-ascii"),
        pytest.param("S.G\n..\n", 2, 3, "wrong size: 2 characters; the first line has 3", id="short"),
        pytest.param("S.G\n....\n", 2, 4, "wrong size: 4 characters; the first line has 3", id="long"),
        pytest.param("S.G\n\n...\n", 2, 1, "wrong size: 0 characters", id="gap"),
        pytest.param("", 1, 1, "an empty map", id="empty"),
        pytest.param("..G", 1, 1, "no start; mark at least one cell with S", id="no-start"),
        pytest.param("S..", 1, 1, "no goal; mark at least one cell with G", id="no-goal"),
        pytest.param("S#.\n##G", 1, 1, "a start from which no goal can be reached", id="walled-off"),
        pytest.param("S.G\n###\n.S.", 3, 2, "a start from which no goal can be reached", id="second-start"),
        pytest.param("SPG", 1, 1, "a start from which no goal can be reached", id="behind-a-pit"),
        pytest.param("SG\n##\n.G", 3, 2, "a goal that cannot be reached from any start", id="goal-apart"),
        pytest.param("SGG", 1, 3, "a goal that cannot be reached from any start", id="goal-behind-a-goal"),
        pytest.param("SaGa", 1, 4, "a second hallway 'a'", id="hallway-twice"),
    ],
)
def test_errors_name_the_row_and_the_column(text: str, row: int, column: int, problem: str):
    with pytest.raises(MapError, match=re.escape(f"map, row {row}, column {column}: {problem}")):
        Gridworld(map=text)


def test_a_map_may_begin_with_a_newline():
    """As a text between triple quotes does that begins in a line of its own."""
    env = hrl.make("Gridworld", map="\n  \nS.#\n..G\n")
    assert env.layout.text == Gridworld(map="S.#\n..G").layout.text
    assert env.render(env.decode(jnp.int32(1))) == Gridworld(map="S.#\n..G").render(env.decode(jnp.int32(1)))
    with pytest.raises(MapError, match="map, row 2, column 2: unknown character"):
        Gridworld(map="\nS.G\n.?.")


def test_maps_have_names():
    assert hrl.make("Gridworld", map="four_rooms") == Gridworld() == Gridworld(map=FOUR_ROOMS)
    assert hrl.make("Gridworld", map="cliff") == Gridworld(map=CLIFF) != Gridworld()
    with pytest.raises(
        ValueError, match="map must be a drawing or one of 'four_rooms', 'cliff', 'barrier', got 'five_rooms'"
    ):
        hrl.make("Gridworld", map="five_rooms")
    with pytest.raises(ValueError, match="map has 256 starts; at most 255 are allowed"):
        Gridworld(map="S" * 256 + "G")


def test_steps_by_hand():
    env, numbers = Gridworld(map=SMALL), {"step_reward": -0.5, "goal_reward": 2.0, "pit_reward": -3.0}
    assert move(env, 0, 0, SOUTH, **numbers) == ((1, 0), -0.5, False, False)
    assert move(env, 0, 0, NORTH, **numbers) == ((0, 0), -0.5, False, False)
    assert move(env, 0, 1, EAST, **numbers) == ((0, 1), -0.5, False, False)
    assert move(env, 1, 0, SOUTH, **numbers) == ((2, 0), -3, True, True)
    assert move(env, 1, 2, EAST, **numbers) == ((1, 3), 2, True, False)
    assert move(env, 1, 2, NORTH, **numbers) == ((1, 2), -0.5, False, False)


def test_a_move_slips_to_either_side_with_half_the_probability():
    env, share = Gridworld(), {"slip_probability": 0.25}
    eighth = WORD_RANGE // 8
    for action, left, right in ((NORTH, (2, 1), (2, 3)), (EAST, (1, 2), (3, 2)), (WEST, (3, 2), (1, 2))):
        assert move(env, 2, 2, action, eighth - 1, **share)[0] == left
        assert (
            move(env, 2, 2, action, eighth, **share)[0] == move(env, 2, 2, action, 2 * eighth - 1, **share)[0] == right
        )
        assert move(env, 2, 2, action, 2 * eighth, **share)[0] == move(env, 2, 2, action)[0]


def test_episodes_begin_in_any_start():
    env = Gridworld(map="SS.\n.SG")
    np.testing.assert_allclose(env.initial_distribution(), [1 / 3, 1 / 3, 0, 0, 1 / 3, 0], atol=1e-6)


def test_the_safe_way_around_the_cliff_is_the_shortest_unless_moves_slip():
    env = Gridworld(map="cliff")
    start = int(np.argmax(env.layout.starts))
    solution = value_iteration(env.model())
    assert float(solution.value[start]) == -13
    slippery = value_iteration(env.model(GridParams(slip_probability=0.2)))
    row_above = np.arange(2 * 12 + 1, 2 * 12 + 11)
    assert (np.asarray(solution.policy)[row_above] == EAST).all()
    assert (np.asarray(slippery.policy)[row_above] == NORTH).all()


def test_closed_cells_end_an_episode_and_nothing_leads_there():
    env = Gridworld(map="S.#.\n..#.\n#G##\n..#P")
    assert drawn(env.layout.closed, env.layout) == ["..xx", "..xx", "x.xx", "xxxx"]
    model = env.model()
    assert model.terminated[env.layout.closed].all()
    reachable = ~env.layout.ends
    assert not env.layout.closed[model.next_state[reachable]].any()


def active_cells(env: Gridworld, name: str) -> list[str]:
    cells = jnp.arange(env.num_states, dtype=jnp.int32)
    ended = jax.vmap(env.hierarchy()[name].termination)(CellState(cells, cells * 0))
    return drawn(~np.asarray(ended), env.layout)


def test_four_rooms_have_a_subtask_for_each_hallway_and_one_for_the_goal():
    env = Gridworld()
    graph = env.hierarchy()
    assert graph.root.children == ("Goto(e)", "Goto(n)", "Goto(s)", "Goto(w)", "Goto(G)")
    assert graph.is_total_leaf_cover()
    assert graph.depth == 2
    assert active_cells(env, "Goto(n)") == [
        ".............",
        ".xxxxx.xxxxx.",
        ".xxxxx.xxxxx.",
        ".xxxxx.xxxxx.",
        ".xxxxx.xxxxx.",
        ".xxxxx.xxxxx.",
        "..x....xxxxx.",
        ".........x...",
        *["............."] * 5,
    ]
    assert active_cells(env, "Goto(G)") == [
        *["............."] * 7,
        ".........x...",
        ".......xxxxx.",
        ".......xxxxx.",
        "......xxxxxx.",
        ".......xxxx..",
        ".............",
    ]
    goal = jax.vmap(graph["Goto(n)"].goal)(CellState(jnp.arange(169, dtype=jnp.int32), jnp.zeros(169, jnp.int32)))
    assert np.flatnonzero(goal).tolist() == [3 * 13 + 6]


def test_a_map_without_hallways_has_the_goal_as_its_only_subtask():
    env = Gridworld(map="S.#.\n..P.\n#.G#")
    assert env.hierarchy().root.children == ("Goto(G)",)
    assert active_cells(env, "Root") == active_cells(env, "Goto(G)") == ["xx..", "xx..", ".x.."]


def test_hallways_in_a_row_lead_on():
    env = Gridworld(map="SabG")
    assert active_cells(env, "Goto(a)") == ["x.x."]
    assert active_cells(env, "Goto(b)") == [".x.."]
    assert active_cells(env, "Goto(G)") == ["..x."]
