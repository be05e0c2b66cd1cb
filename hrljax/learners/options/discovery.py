"""Options that nobody gives: bottlenecks and eigen-purposes of the graph that an environment's moves make."""

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import eigsh

from hrljax.core import checks
from hrljax.envs.base import AnyTabularEnvironment, TabularEnvironment
from hrljax.learners.options.definition import Options, first_best, within
from hrljax.solvers.dynamic_programming import value_iteration
from hrljax.solvers.model import Model

_ROUNDING = 1e-9
"""Numbers that differ by no more, relative to the greatest of their kind, are taken to be equal."""
_WORTHLESS = 1e-4
"""A value of an eigen-option that is not greater, relative to the greatest entry of its vector, is rounding."""


def bottleneck_options(
    env: AnyTabularEnvironment,
    count: int = 4,
    *,
    radius: int = 2,
    num_initiation_states: int | None = None,
    primitives: bool = True,
    discount: float = 0.99,
    params: Any = None,
) -> Options:
    """Options to bottlenecks: the local maxima of betweenness (Simsek and Barto 2009).

    The betweenness of a state v is ``sum_{s, t} sigma_st(v) / sigma_st`` over all other states s and t, where sigma_st
    counts the shortest ways from s to t, and sigma_st(v) those through v. It is computed on the graph of all states
    that an episode can come by, with an edge for every step that may happen, whatever its probability. A state is a
    bottleneck if no other within a radius has more: the two cells beside a door have more than the door, and are
    one bottleneck with a radius of 2.

    An option, named after the number of its bottleneck's state, can be initiated in the states that are nearest to
    it, and terminates there and outside of these states. Its policy maximises ``E[discount ** steps]`` of coming to
    the bottleneck. Ties go to the first action.

    Args:
        env: its exact model is looked at.
        count: bottlenecks, those of the greatest betweenness; fewer if there are no more.
        radius: in steps, forwards or backwards, at least 1.
        num_initiation_states: of an option, those with the fewest steps to the bottleneck, and all that have no more
            than the last of them; all from which it can be reached if None.
        primitives: whether the primitive actions are options as well.
        discount: in (0, 1).
        params: numbers of the environment, `env.default_params` if None.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: a number is out of range, or the environment has no bottleneck.
    """
    model, graph = _graph(env, params)
    checks.integer("count", count, 1)
    checks.integer("radius", radius, 1)
    if num_initiation_states is not None:
        checks.integer("num_initiation_states", num_initiation_states, 1)
    discount = checks.number("discount", discount, checks.PROPER_SHARE)
    options = []
    for goal in _local_maxima(graph, betweenness(graph), radius)[:count].tolist():
        steps = dijkstra(graph.T, indices=goal, unweighted=True)
        active = np.isfinite(steps)
        if num_initiation_states is not None and active.sum() > num_initiation_states + 1:
            active &= steps <= np.sort(steps)[num_initiation_states]
        is_goal = np.arange(env.num_states) == goal
        active &= ~is_goal
        unpaid = model._replace(reward=np.zeros_like(model.reward))
        q = value_iteration(within(unpaid, np.arange(env.num_actions), active, is_goal), discount, tolerance=1e-12).q
        options.append((f"to-{goal}", first_best(np.asarray(q), 0.0), active))
    if not options:
        raise ValueError(f"{env.name} has no state that lies between others")
    return _options(env, options, primitives)


def eigen_options(
    env: AnyTabularEnvironment,
    count: int = 4,
    *,
    primitives: bool = True,
    discount: float = 0.9,
    params: Any = None,
) -> Options:
    """Eigen-options: ways along the slowest modes of a random walk (Machado, Bellemare and Bowling 2017).

    With the symmetric adjacency A of the states that an episode can come by, and its degrees D, the eigenvectors of
    the normalised Laplacian ``L = D^(-1/2) (D - A) D^(-1/2)`` with the smallest eigenvalues, the constant one aside,
    are the directions in which a random walk moves slowest. Each of them, and its opposite, makes an option that
    earns ``e[s'] - e[s]`` for a step from s to s'. It terminates where no action is worth anything to it, and can be
    initiated everywhere else. (A step that ends the episode earns nothing.)

    Where several eigenvectors have one eigenvalue, as in symmetric maps, any basis of them would do; which one
    comes is fixed, but may differ between versions of SciPy.

    Args:
        env: its exact model is looked at.
        count: eigenvectors; each makes two options.
        primitives: whether the primitive actions are options as well.
        discount: of the option's own rewards, in [0, 1).
        params: numbers of the environment, `env.default_params` if None.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: a number is out of range, or the graph has fewer eigenvectors.
    """
    model, graph = _graph(env, params)
    checks.integer("count", count, 1)
    discount = checks.number("discount", discount, checks.Interval(0, 1, high_open=True))
    is_in_graph = graph.sum(1) + graph.sum(0) > 0
    options = []
    for number, vector in enumerate(eigen_purposes(graph, count)):
        for sign, name in ((1, "+"), (-1, "-")):
            gain = sign * (vector[model.next_state] - vector[:, None, None])
            process = model._replace(reward=np.where(model.terminated, 0, gain))
            q = np.asarray(value_iteration(process, discount, tolerance=1e-7).q)
            goes_on = (q.max(-1) > _WORTHLESS * np.abs(vector).max()) & is_in_graph
            options.append((f"eigen{number + 1}{name}", first_best(q, 0.0), goes_on))
    return _options(env, options, primitives)


def betweenness(graph: sparse.csr_array) -> np.ndarray:
    """How many shortest ways between other states lead through each state, as shares: ``[S]`` float64.

    Ways are counted forwards and shares summed backwards, as Brandes (2001) does, but for all S first states side by
    side: one product with the graph for every distance. Needs three arrays of ``S * S`` numbers.

    Args:
        graph: ``[S, S]``, not zero where a step leads from the row to the column.
    """
    size = len(graph.indptr) - 1
    steps = _ones(graph)
    distance = np.where(np.eye(size, dtype=np.bool_), np.int32(0), np.int32(-1))  # row: from that state
    ways = np.eye(size)
    frontier, length = ways, 0
    while frontier.any():
        length += 1
        frontier = np.where(distance < 0, frontier @ steps, 0.0)
        distance[frontier > 0] = length
        ways += frontier
    share = np.zeros((size, size))  # of the ways from the row to all that lie behind the column
    for far in range(length - 1, 0, -1):
        onwards = np.divide(1 + share, ways, out=np.zeros_like(share), where=distance == far)
        share += np.where(distance == far - 1, ways * (onwards @ steps.T), 0.0)
    np.fill_diagonal(share, 0.0)
    return share.sum(0)


def eigen_purposes(graph: sparse.csr_array, count: int) -> np.ndarray:
    """The slowest modes of a random walk on the graph, both ways of every edge: ``[count, S]`` float64.

    Each has length one; its first entry of the greatest size is positive. 0 for states without neighbours.

    Raises:
        ValueError: the graph has fewer.
    """
    near = _ones(graph + graph.T)
    inside = np.flatnonzero(near.sum(1))
    near = sparse.csr_array(near[inside][:, inside])
    still = connected_components(near, directed=False)[0]  # as many modes do not move at all
    if count > len(inside) - still - 1:
        raise ValueError(f"count must be at most {max(len(inside) - still - 1, 0)} here, got {count}")
    scale = sparse.diags_array(1 / np.sqrt(near.sum(1)))
    begin = np.random.default_rng(0).standard_normal(len(inside))
    value, mode = eigsh(scale @ near @ scale, k=still + count, which="LA", v0=begin)
    slowest = mode[:, np.argsort(-value, kind="stable")[still:]].T
    size = np.abs(slowest)
    first = np.argmax(size >= (1 - _ROUNDING) * size.max(1, keepdims=True), axis=1)
    purposes = np.zeros((count, len(graph.indptr) - 1))
    purposes[:, inside] = slowest * np.sign(slowest[np.arange(count), first])[:, None]
    return purposes


def _ones(graph: sparse.csr_array) -> sparse.csr_array:
    """The same edges, each with 1."""
    return sparse.csr_array((np.ones(len(graph.data)), graph.indices, graph.indptr), graph.shape)


def _graph(env: AnyTabularEnvironment, params: Any) -> tuple[Model, sparse.csr_array]:
    """The model, and the steps between different states that an episode can come by."""
    checks.instance("env", env, TabularEnvironment, "a tabular environment such as hrljax.make('Bus')")
    model = env.model(params)
    after = model.successors()
    before = np.broadcast_to(np.arange(env.num_states)[:, None, None], after.shape)
    moves = (after >= 0) & (after != before)
    shape = (env.num_states, env.num_states)
    steps = sparse.csr_array((np.ones(moves.sum()), (before[moves], after[moves])), shape)
    first = np.flatnonzero(env.initial_distribution(params))
    reached = np.isfinite(dijkstra(steps, indices=first, unweighted=True, min_only=True))
    kept = sparse.diags_array(reached.astype(np.float64))
    graph = sparse.csr_array(kept @ steps @ kept)
    graph.eliminate_zeros()
    return model, graph


def _local_maxima(graph: sparse.csr_array, value: np.ndarray, radius: int) -> np.ndarray:
    """States with more than all within a radius, and more than 0: the greatest first, of equal ones the first."""
    rank = np.argsort(np.argsort(-np.round(value / max(value.max(), 1.0), 9), kind="stable"))
    near = sparse.coo_array(graph + graph.T)
    best = rank.copy()
    for _ in range(radius):
        within_one_more = best.copy()
        np.minimum.at(within_one_more, near.row, best[near.col])
        best = within_one_more
    maxima = np.flatnonzero((value > 0) & (best == rank))
    return maxima[np.argsort(rank[maxima])]


def _options(
    env: AnyTabularEnvironment, options: list[tuple[str, np.ndarray, np.ndarray]], primitives: bool
) -> Options:
    """From names, policies and the states in which an option goes on."""
    names, policies, active = zip(*options, strict=True)
    initiation = np.stack(active)
    policy = np.where(initiation, np.stack(policies), 0)
    return Options(env.action_names, names, policy, ~initiation, initiation, primitives)
