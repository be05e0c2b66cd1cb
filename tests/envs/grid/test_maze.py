"""Dietterich's maze: its moves by hand, its values, and what its hierarchy can and cannot do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.core.random import WORD_RANGE
from hrljax.envs.grid.cell_world import CellState
from hrljax.envs.grid.maze import Maze, MazeParams
from hrljax.hierarchy.definition import Hierarchy
from hrljax.solvers import Model, value_iteration
from tests.words import CALM

NORTH, SOUTH, EAST = range(3)
RIGHT, LEFT = WORD_RANGE // 8, 0  # words of a slip to either side, at slip_probability 1/4
SLIPPERY = MazeParams(slip_probability=0.25)


def cell(column: int, row: int) -> int:
    return row * 6 + column


LEFT_ROOM = [cell(column, row) for row in range(7) for column in range(4)]
GOAL = cell(5, 0)


@pytest.fixture(scope="module")
def maze() -> Maze:
    return Maze()


@pytest.fixture(scope="module")
def model(maze: Maze) -> Model:
    return maze.model()


def move(maze: Maze, column: int, row: int, action: int, word: int = CALM, params: MazeParams = SLIPPERY):
    state = CellState(jnp.int32(cell(column, row)), jnp.int32(3))
    after, reward, ended, _ = maze.transition(state, jnp.int32(action), (jnp.uint32(word),), params)
    assert after.time == 4
    return divmod(int(after.cell), 6)[::-1], float(reward), bool(ended)


def test_moves_lead_through_the_doors_and_not_through_the_wall(maze: Maze):
    assert move(maze, 1, 2, NORTH) == ((1, 1), -1, False)
    assert move(maze, 1, 2, SOUTH) == ((1, 3), -1, False)
    assert move(maze, 1, 2, EAST) == ((2, 2), -1, False)
    for row in range(7):
        assert move(maze, 3, row, EAST) == ((4 if row in (1, 5) else 3, row), -1, False)
    assert move(maze, 2, 0, NORTH) == ((2, 0), -1, False)
    assert move(maze, 2, 6, SOUTH) == ((2, 6), -1, False)
    assert move(maze, 5, 3, EAST) == ((5, 3), -1, False)


def test_the_episode_ends_at_the_goal(maze: Maze):
    assert move(maze, 4, 0, EAST) == ((5, 0), -1, True)
    assert move(maze, 5, 1, NORTH) == ((5, 0), -1, True)
    assert move(maze, 4, 1, NORTH) == ((4, 0), -1, False)


def test_a_slip_goes_to_either_side_and_even_west(maze: Maze):
    assert [move(maze, 1, 2, NORTH, word)[0] for word in (LEFT, RIGHT, CALM)] == [(0, 2), (2, 2), (1, 1)]
    assert [move(maze, 1, 2, SOUTH, word)[0] for word in (LEFT, RIGHT, CALM)] == [(2, 2), (0, 2), (1, 3)]
    assert [move(maze, 1, 2, EAST, word)[0] for word in (LEFT, RIGHT, CALM)] == [(1, 1), (1, 3), (2, 2)]
    assert move(maze, 4, 1, NORTH, LEFT)[0] == (3, 1)
    assert move(maze, 1, 2, NORTH, LEFT, MazeParams())[0] == (1, 1)


def test_episodes_start_in_the_left_room(maze: Maze):
    distribution = maze.initial_distribution()
    assert np.flatnonzero(distribution).tolist() == LEFT_ROOM
    np.testing.assert_allclose(distribution[LEFT_ROOM], 1 / 28, atol=1e-6)


def test_the_optimum_is_the_distance_to_the_goal(maze: Maze, model: Model):
    value = np.asarray(value_iteration(model).value).reshape(7, 6)
    upper, lower = -6.0, -10.0
    expected = [max(upper - abs(row - 1), lower - abs(row - 5)) + column for row in range(7) for column in range(4)]
    np.testing.assert_array_equal(value[:, :4].ravel(), expected)
    assert (value[1, 4], value[5, 4], value[6, 5]) == (-2, -6, -6)
    assert value[:, :4].mean() == pytest.approx(-6.7857, abs=5e-5)
    assert maze.initial_distribution() @ value.ravel().astype(float) == pytest.approx(-6.7857, abs=5e-5)


@pytest.mark.parametrize(("preferred", "figure"), [("upper", -7.0714), ("lower", -7.6429)])
def test_leaving_the_left_room_as_fast_as_possible_is_not_optimal(maze: Maze, model: Model, preferred, figure):
    """The recursively optimal policy of Exit, with either way to break ties; the loss is that of the long way."""
    ends = exited(maze, model)
    outside = Model(model.next_state, model.probability, model.reward, model.terminated | ends)
    solution = value_iteration(outside)
    order = [EAST, NORTH, SOUTH] if preferred == "upper" else [EAST, SOUTH, NORTH]
    fastest = np.asarray(solution.q) >= np.asarray(solution.value)[:, None] - 1e-6
    policy = np.array(order)[np.argmax(fastest[:, order], -1)]
    beyond = np.asarray(value_iteration(model).value)
    returns = []
    for start in LEFT_ROOM:
        place, total = start, 0.0
        while place in LEFT_ROOM:
            place, total = int(model.next_state[place, policy[place], 0]), total - 1
        returns.append(total + float(beyond[place]))
    assert np.mean(returns) == pytest.approx(figure, abs=5e-5)


def exited(maze: Maze, model: Model) -> np.ndarray:
    states = jax.vmap(maze.decode)(jnp.asarray(model.next_state.ravel()))
    return np.asarray(jax.vmap(maze.hierarchy()["Exit"].termination)(states)).reshape(model.next_state.shape)


def where(graph: Hierarchy, predicate) -> set[int]:
    cells = jnp.arange(42, dtype=jnp.int32)
    return set(np.flatnonzero(jax.vmap(predicate)(CellState(cells, cells * 0))).tolist())


def test_exit_is_active_in_the_left_room_and_goto_goal_in_the_right_one(maze: Maze):
    graph = maze.hierarchy()
    assert (graph.root.name, graph.root.children, graph.depth) == ("Root", ("Exit", "GotoGoal"), 2)
    assert graph.is_total_leaf_cover()
    everywhere, left = set(range(42)), set(LEFT_ROOM)
    assert where(graph, graph["Exit"].termination) == where(graph, graph["Exit"].goal) == everywhere - left
    assert where(graph, graph["GotoGoal"].termination) == left | {GOAL}
    assert where(graph, graph["GotoGoal"].goal) == where(graph, graph.root.termination) == {GOAL}
    assert maze.hierarchy() is Maze().hierarchy()
