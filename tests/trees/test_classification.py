"""Classification trees against a program in plain Python, and against tables computed by hand."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats.contingency import chi2_contingency

from hrljax.core.random import words
from hrljax.engine.compiler import NESTED_OPTIONS
from hrljax.trees.classification import LEAF, Chance, ClassificationTrees, Data, Forest
from hrljax.trees.scores import chi_squared, gain_ratio, n_log_n
from tests.trees.python_trees import grown, leaves, log_of

F = np.float32
ZERO = jnp.uint32(0)


def nodes_of(spec: ClassificationTrees, forest: Forest, tree: int, kind: int) -> list[tuple[Any, list[int], list[int]]]:
    n, c = spec.max_nodes, spec.most_classes
    tests, children = (np.asarray(a).reshape(-1, n)[tree] for a in (forest.tests, forest.children))
    counts = np.asarray(forest.counts).reshape(-1, n, c)[tree]
    nodes, last = [], 1
    while len(nodes) < last:
        test, first = int(tests[len(nodes)]), int(children[len(nodes)])
        row = counts[len(nodes)].tolist()
        assert sum(row[spec.num_classes[kind] :]) == 0
        if test == LEAF:
            nodes.append((None, [], row[: spec.num_classes[kind]]))
            continue
        which = int(np.searchsorted(np.cumsum(spec.sizes), test >> 1, side="right"))
        value = (test >> 1) - sum(spec.sizes[:which])
        nodes.append(((which, value, bool(test & 1)), [first, first + 1], row[: spec.num_classes[kind]]))
        last = max(last, first + 2)
    return nodes


def data_of(spec: ClassificationTrees, values: np.ndarray, counts: np.ndarray, rows: list[int]) -> Data:
    flat = np.concatenate([counts.ravel(), np.zeros(spec.most_classes, np.int64)]).astype(np.int32)
    order = rows + [r for r in range(len(values)) if r not in rows]
    return Data(
        jnp.asarray(spec.cells(values)), jnp.asarray(flat), jnp.asarray(order, dtype=jnp.int32), jnp.int32(len(rows))
    )


def fitted(spec: ClassificationTrees, data: Data, least: float, chance: Chance | None = None) -> Forest:
    fit = jax.jit(spec.fit, compiler_options=dict(NESTED_OPTIONS))
    return fit(data, jnp.float32(least), ZERO, chance)


def some_data(seed: int, spec: ClassificationTrees, num_rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Random inputs; counts of classes that depend on the first two of them, with noise."""
    generator = np.random.default_rng(seed)
    values = np.stack([generator.integers(size, size=num_rows) for size in spec.sizes], -1)
    counts = []
    for classes in spec.num_classes:
        of_kind = generator.poisson(0.2, (num_rows, classes))
        of_kind[np.arange(num_rows), (values[:, 0] + 2 * (values[:, 1] > 1)) % classes] += 3
        counts.append(of_kind)
    return values, np.concatenate(counts, 1)


@pytest.mark.parametrize("score", ["gain_ratio", "chi_squared"])
@pytest.mark.parametrize("max_nodes", [255, 12, 1])
def test_trees_are_those_of_plain_python(score: Any, max_nodes: int):
    spec = ClassificationTrees((4, 5, 3), (True, True, False), (3, 5, 2), score, max_nodes)
    values, counts = some_data(0, spec, 60)
    rows = np.random.default_rng(1).permutation(60)[:45].tolist()
    least = 1e-4 if score == "gain_ratio" else 3.0
    forest = fitted(spec, data_of(spec, values, counts, rows), least)
    for kind, first in enumerate(spec.first_class):
        of_kind = counts[:, first : first + spec.num_classes[kind]]
        expected = grown(spec, values[rows], of_kind[rows], least)
        assert nodes_of(spec, forest, kind, kind) == expected
        assert len(expected) > 3 or max_nodes == 1
        reached = spec.leaves(forest, kind, jnp.asarray(spec.cells(values).reshape(60, 3)))
        np.testing.assert_array_equal(reached, kind * max_nodes + leaves(expected, values))
        shares = np.asarray(spec.shares(forest, ZERO)).reshape(-1, spec.most_classes)[kind * max_nodes :]
        for share, (_, _, row) in zip(shares, expected, strict=False):
            np.testing.assert_array_equal(share[: len(row)], np.array(row, F) * (F(1) / F(sum(row))))


def test_nodes_leave_inputs_out_by_chance():
    spec = ClassificationTrees((4, 5, 3), (True, True, False), (3,), num_trees=3)
    values, counts = some_data(2, spec, 40)
    key = jnp.uint32(5), jnp.uint32(6)
    forest = fitted(spec, data_of(spec, values, counts, list(range(40))), 1e-4, Chance(key, jnp.float32(0.5)))
    trees = []
    for tree in range(3):
        number = jnp.arange(255, dtype=jnp.uint32) + np.uint32(tree * 255)
        drawn = np.asarray(jax.vmap(lambda i: jnp.stack(words(key, i, 3)))(number))
        trees.append(nodes_of(spec, forest, tree, 0))
        assert trees[-1] == grown(spec, values, counts, 1e-4, drawn >= 2**23)
    assert trees[0] != trees[1]


def test_a_tree_without_rows_is_a_leaf_without_counts():
    spec = ClassificationTrees((2,), (True,), (2,))
    forest = fitted(spec, data_of(spec, np.array([[0], [1]]), np.zeros((2, 2), int), []), 1e-4)
    assert nodes_of(spec, forest, 0, 0) == [(None, [], [0, 0])]
    assert not spec.shares(forest, ZERO).any()


@pytest.mark.slow
def test_trees_of_vmap_are_the_same():
    spec = ClassificationTrees((4, 5, 3), (True, True, False), (3, 2))
    many = [data_of(spec, *some_data(seed, spec, 30), list(range(30))) for seed in range(3)]
    stacked = jax.tree.map(lambda *a: jnp.stack(a), *many)
    together = jax.jit(jax.vmap(lambda data, zero: spec.fit(data, jnp.float32(1e-4), zero), (0, None)))(stacked, ZERO)
    for i, data in enumerate(many):
        alone = fitted(spec, data, 1e-4)
        jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[i], b), together, alone)  # noqa: B023


jitted_chi, jitted_gain = jax.jit(chi_squared), jax.jit(gain_ratio)


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40)), min_size=2, max_size=5))
@settings(max_examples=50, deadline=None)
def test_scores_are_those_of_their_definitions(table: list[tuple[int, int]]):
    passing, failing = np.array(table).T
    if not (passing.sum() and failing.sum()):
        return
    everything = passing + failing
    unused = np.zeros(5 - len(passing), int)
    counts = [np.r_[a, unused] for a in (passing, everything)]
    arguments = [jnp.asarray(a, jnp.int32) for a in (*counts, passing.sum(), everything.sum())]
    used = np.array([passing, failing])[:, everything > 0]
    expected: Any = chi2_contingency(used, correction=False)[0] if used.shape[1] > 1 else 0
    assert float(jitted_chi(*arguments, ZERO)) == pytest.approx(expected, abs=1e-4, rel=1e-4)

    def bits(counts: np.ndarray) -> float:
        shares = counts[counts > 0] / counts.sum()
        return float(-counts.sum() * (shares * np.log2(shares)).sum())

    gain = bits(everything) - bits(passing) - bits(failing)
    own = bits(np.array([passing.sum(), failing.sum()]))
    assert float(jitted_gain(*arguments, ZERO)) == pytest.approx(gain / own, abs=1e-4)


def test_n_log_n():
    n = np.unique(np.r_[np.arange(3000), np.geomspace(3000, 2**30, 2000).astype(int)]).astype(np.int32)
    expected = n * np.log2(np.maximum(n, 1).astype(np.float64))
    np.testing.assert_allclose(n_log_n(jnp.asarray(n), ZERO), expected, rtol=4e-7)
    powers = 2 ** np.arange(20)
    np.testing.assert_array_equal(n_log_n(jnp.asarray(powers, dtype=jnp.int32), ZERO), powers * np.arange(20))
    few = partial(n_log_n, zero=ZERO)
    np.testing.assert_array_equal(few(jnp.arange(500, dtype=jnp.int32)), [log_of(i) for i in range(500)])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sizes": (0, 2)}, r"sizes\[0\] must be an integer from 1"),
        ({"num_classes": (0,)}, r"num_classes\[0\] must be an integer from 1"),
        ({"ordered": (True,)}, "ordered must say it of each of 2 inputs, got 1"),
        ({"score": "gini"}, "score must be one of 'gain_ratio', 'chi_squared'"),
        ({"max_nodes": 0}, "max_nodes must be an integer from 1"),
        ({"num_trees": 0}, "num_trees must be an integer from 1"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=message):
        ClassificationTrees(**{"sizes": (2, 2), "ordered": (True, True), "num_classes": (2,)} | options)
