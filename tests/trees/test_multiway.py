"""Multiway trees: hand-computed ones in Orange's four readings, a plain program, weights, mappings, bad input."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.engine import batch
from hrljax.trees.multiway import READINGS, MultiwayTree, MultiwayTrees, predict

F = np.float32


def as_dict(trees: MultiwayTrees, categories: tuple[int, ...], node: int = 0) -> Any:
    """A tree as nested tuples: means alone for a leaf, else (means, input, what it is parted by, children)."""
    k = len(trees.means) // len(trees.words)
    word, number, means = int(trees.words[node]), trees.numbers[node], list(map(float, trees.means[node * k :][:k]))
    if word == 0:
        return means
    which, first = word & 127, word >> 8
    if word & 128:
        parts: Any = float(np.asarray(number).view(F))
        assert not categories[which]
        count = 2
    else:
        parts = [value for value in range(32) if int(number) >> value & 1]
        assert parts[-1] < categories[which]
        count = len(parts)
    return means, which, parts, [as_dict(trees, categories, first + i) for i in range(count)]


def fit(tree: MultiwayTree, inputs: Any, targets: Any, weights: Any = None, **more: Any) -> MultiwayTrees:
    targets = np.array(targets, F)
    targets = targets[:, None] if targets.ndim == 1 else targets
    weights = None if weights is None else np.array(weights, F)
    return jax.jit(lambda *rows: tree.fit(*rows, **more))(np.array(inputs, F), targets, weights)


def predictions(trees: MultiwayTrees, inputs: Any, group: int = 0) -> np.ndarray:
    rows = jnp.asarray(np.array(inputs, F))
    return np.asarray(jax.jit(jax.vmap(lambda row: predict(trees, row, group)))(rows))


KINDS_AND_NUMBERS = [[0, 1], [0, 2], [1, 1], [1, 2], [3, 3], [3, 4], [3, 9], [3, 10]]
VALUES = [0, 0, -20, -20, 10, 10, 20, 24]
# Branches for the kinds leave an error of 152 (kind 3: 36 + 36 + 16 + 64), the best cut, at 6.5, one of 941. Within
# kind 3 a cut at 6.5 leaves 8 of 152, one at 3.5 104.
HAND: dict[str, Any] = {
    "A": ([3.0], 0, [0, 1, 3], [[0.0], [-20.0], ([16.0], 1, 6.5, [[10.0], ([22.0], 1, 9.5, [[20.0], [24.0]])])]),
    # Five rows on either side of a cut.
    "B": ([3.0], 0, [0, 1, 3], [[0.0], [-20.0], [16.0]]),
    # Two rows on either side.
    "C": ([3.0], 0, [0, 1, 3], [[0.0], [-20.0], ([16.0], 1, 6.5, [[10.0], [22.0]])]),
    # Fewer than 20 rows.
    "D": [3.0],
}


@pytest.mark.parametrize("reading", HAND)
def test_hand_computed_trees(reading: str):
    tree = MultiwayTree((4, 0), **READINGS[reading])
    assert as_dict(fit(tree, KINDS_AND_NUMBERS, VALUES), tree.categories) == HAND[reading]


def test_a_lone_row_in_a_branch():
    """Kind 1 alone: allowed in A, in B and C the number has to do, in B with five rows on either side."""
    inputs = [[0, 1], [0, 2], [0, 3], [0, 4], [0, 6], [1, 5], [2, 5], [2, 8], [2, 9], [2, 9]]
    values = [0, 0, 0, 0, 0, 9, 5, 5, 5, 5]
    trees = {
        name: as_dict(fit(MultiwayTree((3, 0), **READINGS[name]), inputs, values), (3, 0)) for name in ("A", "B", "C")
    }
    assert trees["A"] == ([2.9000000953674316], 0, [0, 1, 2], [[0.0], [9.0], [5.0]])
    # Below 4.5 are four rows, below 5.5 six.
    assert trees["B"] == [2.9000000953674316]
    # Below 4.5 all are 0; of the rest, 0, 9, 5, 5, 5 and 5, no cut with two rows on either side is at 5.5.
    assert trees["C"][1:3] == (1, 4.5)


def test_pruning_of_the_tutorials_call():
    """Ten rows of each: the root's standard error is sqrt(16947 / 79 / 80) = 1.64.

    Of the two last rows it is sqrt(1.25 / 19 / 20) = 0.057, so with m = 2 their error is (20 0.057 + 2 1.64) / 22 =
    0.20, and that of leaves of ten equal rows 2 1.64 / 12 = 0.27: they are not parted. Elsewhere branches are better.
    """
    tree = MultiwayTree((4, 0), **READINGS["D"])
    values = [*VALUES[:-1], 20.5]
    trees = fit(tree, KINDS_AND_NUMBERS, values, [10] * 8)
    kind_3 = ([15.125], 1, 6.5, [[10.0], [20.25]])
    assert as_dict(trees, (4, 0)) == ([2.5625], 0, [0, 1, 3], [[0.0], [-20.0], kind_3])
    whole = fit(MultiwayTree((4, 0), min_split=20), KINDS_AND_NUMBERS, values, [10] * 8)
    assert as_dict(whole, (4, 0))[3][2][3][1] == ([20.25], 1, 9.5, [[20.0], [20.5]])


def test_equal_targets_and_small_variances_are_not_parted():
    for values, reading, mean in (([0.1] * 4, "A", 0.1), ([0, 0, 0.004, 0.004], "C", 0.002)):
        trees = fit(MultiwayTree((4, 0), **READINGS[reading]), KINDS_AND_NUMBERS[:4], values)
        assert as_dict(trees, (4, 0)) == [pytest.approx(mean)]
    assert len(as_dict(fit(MultiwayTree((4, 0)), KINDS_AND_NUMBERS[:4], [0, 0, 0.004, 0.004]), (4, 0))) == 4


def test_a_kind_without_a_branch_is_answered_by_the_nodes_mean():
    tree = MultiwayTree((4, 0))
    trees = fit(tree, KINDS_AND_NUMBERS, VALUES)
    asked = [[2, 5], [0, 5], [1, 99], [3, 6.5], [3, 6.6], [3, 9.5], [3, 9.6]]
    np.testing.assert_array_equal(predictions(trees, asked)[:, 0], [3, 0, -20, 10, 20, 20, 24])


def test_several_targets_are_weighed_by_their_variances():
    """The kind tells the first target, the number the second; in units of variances the number explains a bit more."""
    inputs = [[0, 1], [0, 2], [1, 3], [1, 4]]
    targets = np.array([[0, 0], [0, 0], [1000, 0], [1010, 7]], F)
    trees = fit(MultiwayTree((2, 0)), inputs, targets)
    means, which, parts, children = as_dict(trees, (2, 0))
    # By kinds, or at 2.5: 0.9999 of the first and 1/3 of the second; at 3.5: 1/3 and all of the second.
    assert (means, which, parts) == ([502.5, 1.75], 1, 3.5)
    assert children[1] == [1010, 7]
    assert as_dict(fit(MultiwayTree((2, 0)), inputs, targets[:, :1]), (2, 0))[1:3] == (0, [0, 1])


def plain(tree: MultiwayTree, inputs: np.ndarray, targets: np.ndarray, scale: np.ndarray, depth: int = 0) -> Any:
    """Trees without pruning in plain Python and double precision."""
    means, n = targets.mean(0), len(targets)
    sse = ((targets - means) ** 2).sum(0)
    best, chosen = 1e-6 * (sse * scale).sum(), None
    if n >= max(2, tree.min_split) and (sse / n).max() >= max(tree.min_variance, 1e-12) and depth < tree.max_depth:
        for i, size in enumerate(tree.categories):
            values = np.unique(inputs[:, i])
            parts = [[inputs[:, i] == value for value in values]] if size else []
            cuts = [] if size else [(low + high) / 2 for low, high in zip(values, values[1:], strict=False)]
            parts += [[inputs[:, i] <= cut, inputs[:, i] > cut] for cut in cuts]
            least = tree.min_branch if size else tree.min_side
            labels = [[int(value) for value in values]] if size else cuts
            for rows, label in zip(parts, labels, strict=True):
                if len(rows) < 2 or min(map(sum, rows)) < least:
                    continue
                left = sum(((targets[r] - targets[r].mean(0)) ** 2).sum(0) for r in rows)
                if ((sse - left) * scale).sum() * (1 - 2**-14) > best:
                    best, chosen = ((sse - left) * scale).sum(), (i, label, rows)
    if chosen is None:
        return list(means)
    i, label, rows = chosen
    return list(means), i, label, [plain(tree, inputs[r], targets[r], scale, depth + 1) for r in rows]


def assert_same(actual: Any, expected: Any) -> None:
    assert isinstance(actual, tuple) == isinstance(expected, tuple)
    if not isinstance(actual, tuple):
        assert actual == pytest.approx(expected, abs=1e-5)
        return
    assert actual[0] == pytest.approx(expected[0], abs=1e-5)
    assert actual[1] == expected[1]
    assert actual[2] == pytest.approx(expected[2], abs=1e-5)
    assert len(actual[3]) == len(expected[3])
    for ours, theirs in zip(actual[3], expected[3], strict=True):
        assert_same(ours, theirs)


MIXED = (3, 0, 5, 0, 2)
TWINS = {name: MultiwayTree(MIXED, **{**READINGS[name], "pruning": 0.0}) for name in "ABCD"} | {
    "depth": MultiwayTree(MIXED, max_depth=2)
}
FITS = {name: jax.jit(tree.fit) for name, tree in TWINS.items()}


def mixed(seed: int, rows: int, targets: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers with ties; targets that depend on kinds and numbers, the second of them ten times as large."""
    rng = np.random.default_rng(seed)
    inputs = np.stack([rng.integers(0, size or 12, rows) for size in MIXED], axis=1).astype(F)
    inputs[:, 3] = rng.normal(size=rows)
    signal = (inputs[:, 0] == 1) * inputs[:, 1] + (inputs[:, 2] > 2) * 3
    values = signal[:, None] * [1, 10, 0.5] + rng.normal(size=(rows, 3)) * [1, 10, 1]
    return inputs, values[:, :targets].astype(F)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(sorted(TWINS)), targets=st.sampled_from([1, 3]))
@settings(deadline=None, max_examples=60, derandomize=True)
def test_equal_to_a_plain_program(seed: int, name: str, targets: int):
    inputs, values = mixed(seed, 40, targets)
    trees = FITS[name](inputs, values)
    scale = 1 / values.astype(float).var(0) if targets > 1 else np.ones(1)
    assert_same(as_dict(trees, MIXED), plain(TWINS[name], inputs, values.astype(float), scale))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(TWINS))
def test_weights_are_repeated_rows(name: str):
    """Bit for bit, with targets whose sums are exact."""
    rng = np.random.default_rng(3)
    inputs, values = mixed(4, 30, 3)
    values, weights = np.round(values * 4), rng.integers(1, 4, 30)
    tree = MultiwayTree(MIXED, **READINGS.get(name, {"max_depth": 2}))
    weighted = fit(tree, inputs, values, weights)
    repeated = fit(tree, np.repeat(inputs, weights, 0), np.repeat(values, weights, 0))
    actual, expected = as_dict(weighted, MIXED), as_dict(repeated, MIXED)
    assert_same(actual, expected)
    assert isinstance(actual, tuple)


def grouped(seed: int) -> tuple[np.ndarray, ...]:
    inputs, values = mixed(seed, 60, 3)
    rng = np.random.default_rng(seed)
    # Groups 0 and 2 are empty, and group 1 is not the first to be met.
    return inputs, values, rng.integers(1, 4, 60).astype(F), rng.choice([1, 3, 4], 60).astype(np.int32)


def fit_groups(data: tuple[Any, ...]) -> Any:
    """All trees, and a prediction of each for the first row."""
    tree = MultiwayTree(MIXED, min_split=5, pruning=1.0)
    trees = tree.fit(*data, num_groups=5, count=55)
    return trees, [predict(trees, data[0][0], g) for g in range(5)]


@pytest.mark.slow
def test_mappings_agree_bit_for_bit():
    data = [grouped(seed) for seed in range(3)]
    stacked = tuple(map(jnp.stack, zip(*data, strict=True)))
    results = [batch.compile_mapped(fit_groups, mapping, nested=True)(stacked) for mapping in ("vmap", "native")]
    jax.tree.map(np.testing.assert_array_equal, *results)
    one = jax.jit(fit_groups)
    for i, each in enumerate(data):
        jax.tree.map(np.testing.assert_array_equal, one(each), jax.tree.map(lambda leaf, i=i: leaf[i], results[0]))


@pytest.mark.slow
def test_groups_are_trees_of_their_own():
    """Rows beyond the count, and those of other groups, are as if they were not there."""
    inputs, values, weights, group = grouped(5)
    tree = MultiwayTree(MIXED)
    together = fit(tree, inputs, values, weights, group=group, num_groups=5, count=40)
    for g in range(5):
        rows = (group == g) & (np.arange(60) < 40)
        actual = as_dict(together, MIXED, g)
        if not rows.any():
            assert actual == [0, 0, 0]
        else:
            assert_same(actual, as_dict(fit(tree, inputs[rows], values[rows], weights[rows]), MIXED))


def test_a_row_for_every_leaf_comes_back_exactly():
    inputs, values = mixed(8, 200, 3)
    tree = MultiwayTree(MIXED)
    trees = fit(tree, inputs, values)
    np.testing.assert_array_equal(predictions(trees, inputs), values)
    assert int(np.max(np.flatnonzero(trees.words))) < tree.capacity(200)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"categories": ()}, "categories must describe 1 to 128 inputs, got 0"),
        ({"categories": (33,)}, r"categories\[0\] must be an integer from 0 to 32, got 33"),
        ({"categories": (2,), "max_depth": -1}, "max_depth must be an integer from 0 to"),
        ({"categories": (2,), "pruning": -1.0}, "pruning must be a finite number in"),
        ({"categories": (2,), "min_side": np.nan}, "min_side must be a finite number in"),
    ],
)
def test_bad_settings(options: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=message):
        MultiwayTree(**options)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inputs": np.zeros((2, 3), F)}, r"inputs must have shape \[N, 2\].*got \[2, 3\]"),
        ({"inputs": np.array([[0, 0], [3, 0]], F)}, r"inputs\[:, 0\] must be whole numbers in 0..2, got 3"),
        ({"weights": np.array([1, 0], F)}, "weights must be above 0, got 0"),
        ({"weights": np.ones(2, np.int32)}, r"weights must be float32 of shape \[2\], got int32"),
        ({"group": np.array([0, 1], np.int32)}, "group must be in 0..0, got 0..1"),
        ({"count": 3}, "count must be in 0..2, got 3"),
    ],
)
def test_bad_data(change: dict[str, Any], message: str):
    good = {"inputs": np.array([[0, 1.5], [2, 2.5]], F), "targets": np.ones((2, 1), F)}
    with pytest.raises(ValueError, match=message):
        MultiwayTree((3, 0)).fit(**(good | change))
