"""Options that are found: the graph's numbers against plain programs, and what the options do in the end."""

from collections import deque
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

import hrljax
from hrljax.learners.options import discovery
from hrljax.learners.options.discovery import betweenness, eigen_purposes

ROOMS = hrljax.make("Gridworld")


def edges_of(size: int, bits: int) -> np.ndarray:
    """``[size, size]`` bool without loops, from the bits of a number."""
    pairs = [(i, j) for i in range(size) for j in range(size) if i != j]
    graph = np.zeros((size, size), np.bool_)
    for number, pair in enumerate(pairs):
        graph[pair] = bits >> number & 1
    return graph


def shortest_ways(graph: np.ndarray, start: int) -> tuple[list[float], list[int]]:
    """Steps from `start` to every state, and the number of ways that are no longer."""
    steps, ways = [np.inf] * len(graph), [0] * len(graph)
    steps[start], ways[start] = 0, 1
    queue = deque([start])
    while queue:
        state = queue.popleft()
        for after in np.flatnonzero(graph[state]):
            if steps[after] == np.inf:
                steps[after] = steps[state] + 1
                queue.append(after)
            if steps[after] == steps[state] + 1:
                ways[after] += ways[state]
    return steps, ways


def plain_betweenness(graph: np.ndarray) -> list[Fraction]:
    """By its definition."""
    size = len(graph)
    steps, ways = zip(*(shortest_ways(graph, start) for start in range(size)), strict=True)
    return [
        sum(
            (
                Fraction(ways[s][v] * ways[v][t], ways[s][t])
                for s, t in product(range(size), repeat=2)
                if len({s, t, v}) == 3 and steps[s][t] < np.inf and steps[s][v] + steps[v][t] == steps[s][t]
            ),
            Fraction(0),
        )
        for v in range(size)
    ]


@given(st.integers(2, 7).flatmap(lambda n: st.tuples(st.just(n), st.integers(0, 2 ** (n * (n - 1)) - 1))))
def test_betweenness_is_that_of_its_definition(drawn: tuple[int, int]):
    graph = edges_of(*drawn)
    expected = [float(share) for share in plain_betweenness(graph)]
    np.testing.assert_allclose(betweenness(sparse.csr_array(graph.astype(float))), expected, rtol=1e-12)


def test_betweenness_of_a_corridor():
    corridor = np.eye(5, k=1) + np.eye(5, k=-1)
    np.testing.assert_array_equal(betweenness(sparse.csr_array(corridor)), [0, 6, 8, 6, 0])


def test_modes_of_a_corridor_are_cosines():
    """With loops at both ends every state has two neighbours, and mode k is ``cos(pi k (i + 1/2) / n)``."""
    corridor = np.eye(6, k=1) + np.eye(6, k=-1)
    corridor[0, 0] = corridor[5, 5] = 1
    modes = eigen_purposes(sparse.csr_array(corridor), 3)
    expected = np.array([np.cos(np.pi * k * (np.arange(6) + 0.5) / 6) for k in (1, 2, 3)])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(modes, expected, atol=1e-9)


@given(st.integers(0, 2**42 - 1))
def test_modes_are_the_slowest_of_the_normalised_laplacian(bits: int):
    """Of any directed graph with seven states, connected or not, as a dense solver has them."""
    graph = edges_of(7, bits)
    near = (graph | graph.T).astype(float)
    inside = np.flatnonzero(near.sum(1))
    near = near[inside][:, inside]
    scale = np.diag(near.sum(1) ** -0.5)
    laplacian = scale @ (np.diag(near.sum(1)) - near) @ scale
    value = np.sort(np.linalg.eigvalsh(laplacian))
    still = int((value < 1e-9).sum())
    count = min(len(inside) - still - 1, 3)
    if count < 1:
        with pytest.raises(ValueError, match="count must be at most 0"):
            eigen_purposes(sparse.csr_array(graph.astype(float)), 1)
        return
    modes = eigen_purposes(sparse.csr_array(graph.astype(float)), count)
    assert not np.delete(modes, inside, axis=1).any()
    modes = modes[:, inside]
    np.testing.assert_allclose(modes @ modes.T, np.eye(count), atol=1e-7)
    np.testing.assert_allclose(laplacian @ modes.T, modes.T * value[still : still + count], atol=1e-7)


def test_four_rooms_have_a_bottleneck_at_every_hallway():
    options = hrljax.bottleneck_options(ROOMS, 10)
    cells = [int(name.removeprefix("to-")) for name in options.names[:4]]
    hallways = [row * 13 + column for row, column in ((3, 6), (6, 2), (7, 9), (10, 6))]
    beside = [{hall, hall + 1, hall - 1, hall + 13, hall - 13} for hall in hallways]
    assert all(len(near.intersection(cells)) == 1 for near in beside)


@pytest.mark.parametrize("num_initiation_states", [None, 20])
def test_an_option_goes_to_its_bottleneck_by_the_shortest_way(num_initiation_states: int | None):
    after = ROOMS.model().successors()[:, :, 0]
    graph = np.zeros((169, 169), np.bool_)
    for action in range(4):
        states = np.flatnonzero(after[:, action] >= 0)
        graph[states, after[states, action]] = True
    options = hrljax.bottleneck_options(ROOMS, num_initiation_states=num_initiation_states, primitives=False)
    for number, name in enumerate(options.names):
        goal = int(name.removeprefix("to-"))
        back, _ = shortest_ways(graph.T, goal)
        can_begin = np.flatnonzero(options.initiation[number])
        near = np.sort(back)[1:]
        if num_initiation_states is None:
            assert set(can_begin) == set(np.flatnonzero(np.isfinite(back))) - {
                goal,
                154,
            }  # 154: the goal, from where no episode goes on
        else:
            assert len(can_begin) <= 20 or near[19] == near[20]
            assert {back[state] for state in can_begin} == {s for s in near if s <= near[19]}
        for begin in can_begin:
            state, steps = int(begin), 0
            while not options.termination[number, state]:
                state, steps = int(after[state, options.policy[number, state]]), steps + 1
            assert (state, steps) == (goal, back[begin])


def test_an_eigen_option_climbs_its_vector_and_stops_where_nothing_is_higher():
    options = hrljax.eigen_options(ROOMS, 2, primitives=False)
    assert options.names == ("eigen1+", "eigen1-", "eigen2+", "eigen2-")
    after = ROOMS.model().successors()[:, :, 0]
    moves = np.where(after >= 0, after, np.arange(169)[:, None])
    near = np.zeros((169, 169))
    for action in range(4):
        near[np.arange(169), moves[:, action]] = 1
    _, graph = discovery._graph(ROOMS, None)
    vectors = eigen_purposes(graph, 2)
    for number in range(4):
        vector = vectors[number // 2] * (1, -1)[number % 2]
        value = np.zeros(169)
        for _ in range(300):  # value iteration in float64
            gain = np.where(after >= 0, vector[moves] - vector[:, None], 0)
            q = gain + 0.9 * np.where(after >= 0, value[moves], 0)
            value = q.max(1)
        inside = np.asarray(graph.sum(1)) > 0
        unclear = (np.abs(value) > 1e-9) & (value < 2e-4 * np.abs(vector).max())
        assert unclear.sum() <= 2
        np.testing.assert_array_equal(options.initiation[number][~unclear], ((value > 1e-9) & inside)[~unclear])
        goes_on = np.flatnonzero(options.initiation[number])
        chosen = q[goes_on, options.policy[number, goes_on]]
        np.testing.assert_allclose(chosen, value[goes_on], rtol=1e-3, atol=1e-6)


def test_found_options_are_learned_over():
    for options in (hrljax.bottleneck_options(ROOMS), hrljax.eigen_options(ROOMS)):
        learner = hrljax.OptionQ(options, step_size=0.5)
        curves = hrljax.sweep(ROOMS, learner, seeds=20, num_episodes=200, bin_size=100, progress=False)
        first, last = curves["length"].mean("seed").values
        assert last < 0.75 * first


@pytest.mark.parametrize("discover", [hrljax.bottleneck_options, hrljax.eigen_options])
def test_bad_arguments(discover: object):
    with pytest.raises(TypeError, match="env must be a tabular environment"):
        discover(3)
    with pytest.raises(ValueError, match="count must be an integer from 1"):
        discover(ROOMS, 0)
    with pytest.raises(ValueError, match="discount"):
        discover(ROOMS, discount=1.0)
    empty = hrljax.make("Gridworld", map="SG")
    with pytest.raises(ValueError, match=r"no state that lies between|count must be at most 0"):
        discover(empty)
