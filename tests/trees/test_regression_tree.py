"""Regression trees: hand-computed splits, an exact independent program, scikit-learn, mappings, bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.tree import DecisionTreeRegressor

from hrljax.engine import batch
from hrljax.envs.mario.recordings import read_episodes
from hrljax.experiments.mario_fidelity.transitions import INPUT_CATEGORIES, Transitions, read_transitions
from hrljax.trees.regression_tree import Descent, RegressionTree, Trees, predict, predict_all
from tests.mario_data import recording


def as_dict(trees: Trees, node: int = 0):
    """A tree as nested tuples: (input, kind of test, number, passes, fails), or the prediction."""
    word, number = int(trees.words[node]), float(trees.numbers[node])
    if word == 0:
        return number
    left = word >> 8
    return word & 127, "==" if word & 128 else "<", number, as_dict(trees, left), as_dict(trees, left + 1)


def fit(tree: RegressionTree, inputs: np.ndarray, targets: np.ndarray, count: int | None = None) -> Trees:
    return jax.jit(tree.fit)(inputs.astype(np.float32), targets.astype(np.float32), count)


def predictions(trees: Trees, inputs: np.ndarray) -> np.ndarray:
    return np.asarray(jax.jit(jax.vmap(lambda row: predict(trees, row)))(inputs.astype(np.float32)))


def one_hot(inputs: np.ndarray, categories: tuple[int, ...]) -> np.ndarray:
    columns = [
        np.eye(size)[inputs[:, i].astype(int)] if size else inputs[:, i : i + 1] for i, size in enumerate(categories)
    ]
    return np.concatenate(columns, axis=1).astype(np.float32)


HAND = {
    # Root: {2, 3} have 6, the rest 0 and 1; then < 1.5 parts 0, 0 from 1, 1.
    "category then number": (
        (4, 0),
        [[0, 1], [0, 2], [1, 1], [1, 2], [2, 1], [2, 2]],
        [0, 1, 0, 1, 6, 6],
        {"max_depth": 3, "min_leaf": 1},
        (0, "==", 2.0, 6.0, (1, "<", 1.5, 0.0, 1.0)),
    ),
    "threshold in the middle of the node's own values": (
        (0,),
        [[-2], [-1], [3], [7]],
        [0, 0, 8, 12],
        {"max_depth": 2, "min_leaf": 1},
        (0, "<", 1.0, 0.0, (0, "<", 5.0, 8.0, 12.0)),
    ),
    # -2 | -1 would reduce the variance most, but leaves one row alone.
    "a leaf keeps its rows": ((0,), [[-2], [-1], [3], [7]], [9, 0, 0, 1], {"min_leaf": 2}, (0, "<", 1.0, 4.5, 0.5)),
    "depth 1": ((0,), [[0], [1], [2], [3]], [0, 1, 8, 9], {"max_depth": 1, "min_leaf": 1}, (0, "<", 1.5, 0.5, 8.5)),
    "depth 0": ((0,), [[0], [1], [2], [3]], [0, 1, 8, 9], {"max_depth": 0, "min_leaf": 1}, 4.5),
    "equal targets": ((3,), [[0], [1], [2]], [0.1, 0.1, 0.1], {"min_leaf": 1}, float(np.float32(0.1))),
    "equal inputs": ((3, 0), [[1, 5], [1, 5]], [0, 1], {"min_leaf": 1}, 0.5),
    "of equal tests the lowest input": (
        (2, 2),
        [[0, 0], [0, 0], [1, 1], [1, 1]],
        [1, 1, 3, 3],
        {"min_leaf": 1},
        (0, "==", 0.0, 1.0, 3.0),
    ),
    # Category 1 against the rest or category 3: the same reduction.
    "of equal tests the lowest value": (
        (4,),
        [[1], [2], [3]],
        [0, 1, 2],
        {"min_leaf": 1, "max_depth": 1},
        (0, "==", 1.0, 0.0, 1.5),
    ),
    "minus zero is zero": ((0,), [[-0.0], [0.0], [1]], [1, 3, 8], {"min_leaf": 1}, (0, "<", 0.5, 2.0, 8.0)),
}


@pytest.mark.parametrize("case", HAND)
def test_hand_computed_trees(case: str):
    categories, inputs, targets, limits, expected = HAND[case]
    trees = fit(RegressionTree(categories, **limits), np.array(inputs), np.array(targets))
    assert as_dict(trees) == pytest.approx(expected) if isinstance(expected, float) else as_dict(trees) == expected


def plain(inputs, targets, categories, depth, min_leaf):
    """CART in plain Python and double precision, thresholds tried one by one."""
    best, n = None, len(targets)
    for i, size in enumerate(categories):
        values = np.unique(inputs[:, i])
        for j in range(len(values) if size else len(values) - 1):
            passes = inputs[:, i] == values[j] if size else inputs[:, i] <= values[j]
            k = passes.sum()
            if min(k, n - k) < min_leaf:
                continue
            reduction = targets.var() - (k * targets[passes].var() + (n - k) * targets[~passes].var()) / n
            if reduction > 1e-9 and (best is None or reduction > best[0] + 1e-9):
                number = values[j] if size else (values[j] + values[j + 1]) / 2
                best = (reduction, passes, (i, "==" if size else "<", number))
    if depth == 0 or best is None:
        return targets.mean()
    _, passes, test = best
    left, right = (plain(inputs[rows], targets[rows], categories, depth - 1, min_leaf) for rows in (passes, ~passes))
    return *test, left, right


def assert_same(tree, expected):
    assert isinstance(tree, tuple) == isinstance(expected, tuple)
    if isinstance(tree, tuple):
        assert tree[:2] == expected[:2]
        assert tree[2] == pytest.approx(expected[2], rel=1e-6)
        assert_same(tree[3], expected[3])
        assert_same(tree[4], expected[4])
    else:
        assert tree == pytest.approx(expected, abs=2e-5)


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=40, derandomize=True)
def test_equal_to_a_plain_program(seed: int):
    rng = np.random.default_rng(seed)
    categories, rows = (3, 0, 5, 0, 2), 40
    inputs = np.stack([rng.integers(0, size or 9, rows) for size in categories], axis=1).astype(float)
    inputs[:, 1] = rng.normal(size=rows).astype(np.float32)
    targets = rng.normal(size=rows).astype(np.float32) + inputs[:, 0]
    tree = as_dict(fit_plain(inputs.astype(np.float32), targets.astype(np.float32)))
    assert_same(tree, plain(inputs, targets, categories, 4, 3))


fit_plain = jax.jit(RegressionTree((3, 0, 5, 0, 2), max_depth=4, min_leaf=3).fit)


def mixed(seed: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Inputs of four kinds and three numbers, and a noisy target that depends on some."""
    rng = np.random.default_rng(seed)
    symbols, numbers = rng.integers(0, 6, (rows, 4)), rng.normal(size=(rows, 3))
    targets = symbols[:, 0] * numbers[:, 0] + (symbols[:, 1] == 3) * 2 + numbers[:, 1] ** 2
    targets = targets + rng.normal(0, 0.3, rows)
    return np.concatenate([symbols, numbers], axis=1).astype(np.float32), targets.astype(np.float32)


MIXED = (6, 6, 6, 6, 0, 0, 0)
fit_mixed = jax.jit(RegressionTree(MIXED, max_depth=7, min_leaf=4, num_bins=1024).fit)


@pytest.mark.parametrize("seed", range(8))
def test_equal_to_scikit_learn(seed: int):
    inputs, targets = mixed(seed, 600)
    oracle = DecisionTreeRegressor(max_depth=7, min_samples_leaf=4, random_state=0)
    oracle.fit(one_hot(inputs, MIXED), targets.astype(np.float64))
    trees = fit_mixed(inputs, targets, 600)
    assert np.sum(np.asarray(trees.words) != 0) > 40
    np.testing.assert_allclose(predictions(trees, inputs), oracle.predict(one_hot(inputs, MIXED)), atol=1e-4)


def test_many_values_share_bins_by_rank():
    rows = 1000
    inputs = np.random.default_rng(0).permutation(rows)[:, None].astype(np.float32)
    trees = fit(RegressionTree((0,), max_depth=1, num_bins=4), inputs, inputs[:, 0] >= 480)
    # Bins start at 0, 250, 500 and 750; the best cut is between the second and the third.
    assert as_dict(trees) == (0, "<", 499.5, pytest.approx(20 / 500, abs=1e-6), 1.0)


def test_few_values_have_bins_of_their_own_however_often_they_occur():
    inputs = np.repeat([1.0, 2.0, 3.0], [97, 2, 1])[:, None]
    trees = fit(RegressionTree((0,), min_leaf=1, num_bins=3), inputs, inputs[:, 0] ** 2)
    np.testing.assert_array_equal(predictions(trees, np.array([[1.0], [2.0], [3.0]])), [1, 4, 9])


def test_only_the_first_rows_count():
    inputs, targets = mixed(3, 600)
    some = fit_mixed(inputs, targets, 200)
    others = np.arange(600) >= 200
    rubbish = np.where(others[:, None], np.float32(5), inputs), np.where(others, np.float32(1e3), targets)
    jax.tree.map(np.testing.assert_array_equal, some, fit_mixed(*rubbish, 200))
    oracle = DecisionTreeRegressor(max_depth=7, min_samples_leaf=4, random_state=0)
    expected = oracle.fit(one_hot(inputs[:200], MIXED), targets[:200]).predict(one_hot(inputs, MIXED)[:200])
    np.testing.assert_allclose(predictions(some, inputs)[:200], expected, atol=1e-4)


@pytest.mark.slow
def test_predictions_side_by_side_are_those_of_each_tree_alone():
    """Trees of other depths, a single leaf among them, and rows of other widths."""
    inputs, targets = mixed(7, 300)
    deep, wide = fit_mixed(inputs, targets, 300), fit(RegressionTree((0,), min_leaf=1), inputs[:, 4:5], targets)
    shallow = fit(RegressionTree(MIXED, max_depth=1, min_leaf=4), inputs, targets)
    leaf = fit_mixed(inputs, targets, 0)

    def all_of(row: jax.Array) -> list[jax.Array]:
        return predict_all([Descent(trees, row, ()) for trees in (deep, shallow, leaf)] + [Descent(wide, row[4:5], ())])

    together = jax.jit(jax.vmap(all_of))(inputs.astype(np.float32))
    alone = [*(predictions(trees, inputs) for trees in (deep, shallow, leaf)), predictions(wide, inputs[:, 4:5])]
    for side_by_side, expected in zip(together, alone, strict=True):
        np.testing.assert_array_equal(side_by_side, expected)


def test_no_row_predicts_zero():
    assert as_dict(fit_mixed(*mixed(3, 600), 0)) == 0.0


def test_the_order_of_rows_does_not_matter():
    inputs, targets = mixed(5, 600)
    order = np.random.default_rng(1).permutation(600)
    jax.tree.map(
        np.testing.assert_array_equal, fit_mixed(inputs, targets, 600), fit_mixed(inputs[order], targets[order], 600)
    )


GROUPED = RegressionTree(MIXED, max_depth=3, min_leaf=5, num_bins=8)


def grouped(seed: int, rows: int = 80) -> tuple[np.ndarray, ...]:
    inputs, targets = mixed(seed, rows)
    group = np.random.default_rng(seed).integers(0, 3, rows).astype(np.int32)
    return inputs, np.stack([targets, inputs[:, 4] - targets], axis=1), group


def fit_groups(data: tuple[np.ndarray, ...]) -> tuple[Trees, jax.Array]:
    """All trees, and a prediction of each for the first row."""
    trees = GROUPED.fit_groups(*data, num_groups=3)
    g, k = np.divmod(np.arange(6, dtype=np.int32), 2)
    return trees, jax.vmap(lambda g, k: predict(trees, data[0][0], g, k))(g, k)


@pytest.mark.slow
def test_mappings_agree_bit_for_bit():
    data = [grouped(seed, 60) for seed in range(2)]
    stacked = tuple(map(jnp.stack, zip(*data, strict=True)))
    one = jax.jit(fit_groups)
    alone = [one(each) for each in data]
    expected = jax.tree.map(lambda *leaves: np.stack(leaves), *alone)
    for mapping in ("vmap", "native"):
        together = batch.compile_mapped(fit_groups, mapping)(stacked)
        jax.tree.map(np.testing.assert_array_equal, expected, together)


@pytest.mark.slow
def test_groups_are_trees_of_their_own():
    inputs, targets, group = grouped(7)
    # A bin of its own for every value, so that the bins of all rows are those of the group.
    tree = RegressionTree(MIXED, max_depth=4, min_leaf=5, num_bins=512)
    trees = jax.jit(lambda *data: tree.fit_groups(*data, num_groups=4))(inputs, targets, group)
    assert np.all(np.asarray(trees.words)[3] == 0)
    alone = jax.jit(tree.fit)
    each = jax.jit(jax.vmap(predict, in_axes=(None, 0, None, None)))
    for g in range(3):
        order = np.argsort(group != g, stable=True)
        rows = inputs[order][: np.sum(group == g)]
        for k in range(2):
            group_alone = alone(inputs[order], targets[order, k], len(rows))
            np.testing.assert_allclose(
                each(trees, rows, g, k), predictions(group_alone, inputs[order])[: len(rows)], atol=1e-4
            )


TREE, REWARD_TREE = RegressionTree(INPUT_CATEGORIES), RegressionTree((*INPUT_CATEGORIES, 12))


@jax.jit
def by_trees(
    inputs: jax.Array, actions: jax.Array, targets: jax.Array, rewards: jax.Array, count: jax.Array
) -> jax.Array:
    """Displacement, velocity and reward of every row, learned from the first ones."""
    with_action = jnp.concatenate([inputs, actions[:, None].astype(jnp.float32)], axis=1)
    moves = TREE.fit_groups(inputs, targets, actions, 12, count)
    reward = REWARD_TREE.fit(with_action, rewards, count)

    def row(x: jax.Array) -> jax.Array:
        action = x[-1].astype(jnp.int32)
        return jnp.stack([*(predict(moves, x[:-1], action, k) for k in range(4)), predict(reward, x)])

    return jax.vmap(row)(with_action)


def by_sklearn(data: Transitions, count: int) -> np.ndarray:
    codes = one_hot(data.inputs, INPUT_CATEGORIES)
    with_action = np.concatenate([codes, np.eye(12, dtype=np.float32)[data.actions]], axis=1)
    predicted, early = np.zeros((len(codes), 5)), np.arange(len(codes)) < count
    for a, k in np.ndindex(12, 4):
        rows = data.actions == a
        learned = DecisionTreeRegressor(max_depth=12, min_samples_leaf=5, random_state=0)
        learned.fit(codes[rows & early], data.targets[rows & early, k].astype(float))
        predicted[rows, k] = learned.predict(codes[rows])
    reward = DecisionTreeRegressor(max_depth=12, min_samples_leaf=5, random_state=0)
    predicted[:, 4] = reward.fit(with_action[:count], data.rewards[:count].astype(float)).predict(with_action)
    return predicted


def test_as_accurate_as_scikit_learn_on_recorded_games():
    recorded = read_transitions(read_episodes(recording("rl_steps.npz")))
    errors = np.zeros((2, 5))
    for fold in range(5):
        held = recorded.episodes % 5 == fold
        data = Transitions(*(values[np.argsort(held, stable=True)] for values in recorded))
        count = int(np.sum(~held))
        truth = np.concatenate([data.targets, data.rewards[:, None]], axis=1)
        ours = by_trees(data.inputs, data.actions, data.targets, data.rewards, count)
        for i, predicted in enumerate((np.asarray(ours), by_sklearn(data, count))):
            errors[i] += ((predicted - truth)[count:] ** 2).sum(0)
    assert np.all(errors[0] <= 1.05 * errors[1]), errors[0] / errors[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"categories": ()}, "categories must describe 1 to 128 inputs, got 0"),
        ({"categories": (300,)}, r"categories\[0\] must be an integer from 0 to 256, got 300"),
        ({"categories": (2,), "max_depth": -1}, "max_depth must be an integer from 0 to 64, got -1"),
        ({"categories": (2,), "min_leaf": 0}, "min_leaf must be an integer from 1 to"),
        ({"categories": (2,), "num_bins": 1}, "num_bins must be an integer from 2 to 1024, got 1"),
    ],
)
def test_bad_settings(options: dict, message: str):
    with pytest.raises(ValueError, match=message):
        RegressionTree(**options)


def test_bad_types():
    with pytest.raises(TypeError, match="categories must be a tuple"):
        RegressionTree([2, 3])  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"max_depth must be an integer from 0 to 64, got 2\.5"):
        RegressionTree((2,), max_depth=2.5)  # type: ignore[arg-type]


GOOD = {"inputs": np.array([[0, 1.5], [2, 2.5]], np.float32), "targets": np.ones((2, 1), np.float32),
            "group": np.zeros(2, np.int32), "num_groups": 1, "count": 2}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inputs": np.zeros((2, 3), np.float32)}, r"inputs must have shape \[N, 2\].*got \[2, 3\]"),
        ({"inputs": np.zeros((2, 2), np.int32)}, "inputs must be float32, got int32"),
        ({"inputs": np.array([[0, 0], [3, 0]], np.float32)}, r"inputs\[:, 0\] must be whole numbers in 0..2, got 3"),
        ({"inputs": np.array([[0, 0], [0.5, 0]], np.float32)}, r"whole numbers in 0\.\.2, got 0\.5"),
        ({"inputs": np.array([[0, 0], [1, np.nan]], np.float32)}, "inputs must be finite, got nan"),
        (
            {"targets": np.ones((3, 1), np.float32)},
            r"targets must have a value for each of 2 rows, got shape \[3, 1\]",
        ),
        ({"targets": np.full((2, 1), np.inf, np.float32)}, "targets must be finite, got inf"),
        ({"group": np.array([0, 1], np.int32)}, "group must be in 0..0, got 0..1"),
        ({"group": np.zeros(3, np.int32)}, r"group must be int32 of shape \[2\]"),
        ({"num_groups": 0}, "num_groups must be an integer from 1 to"),
        ({"count": 3}, "count must be in 0..2, got 3"),
        ({"count": 1.5}, "count must be one integer, got float32"),
    ],
)
def test_bad_data(change: dict, message: str):
    tree = RegressionTree((3, 0), min_leaf=1)
    with pytest.raises(ValueError, match=message):
        tree.fit_groups(**(GOOD | change))


def test_fitting_compiles_once():
    tree = RegressionTree((3, 0), min_leaf=1)
    compiled = jax.jit(tree.fit)
    for count in (1, 2):
        compiled(GOOD["inputs"], GOOD["targets"][:, 0], count)
    assert compiled._cache_size() == 1
