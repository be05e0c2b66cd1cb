"""Features of states by hand, and what of them is refused."""

import numpy as np
import pytest

import hrljax as hrl
from hrljax.learners.features import Features, state_features
from tests.words import KEY

TAXI, ROOMS = hrl.make("Taxi"), hrl.make("Gridworld")


def test_a_table_has_one_feature_a_state():
    np.testing.assert_array_equal(state_features(ROOMS).dense(), np.eye(169))


def test_features_of_variables():
    """Taxi: 5 rows, 5 columns, 5 places of the passenger, 4 destinations."""
    features = hrl.variable_features(TAXI)
    assert (features.size, features.num_active) == (19, 4)
    state = ((2 * 5 + 3) * 5 + 4) * 4 + 1
    assert features.index[state].tolist() == [2, 5 + 3, 10 + 4, 15 + 1]
    np.testing.assert_allclose((features.dense() ** 2).sum(1), 1, rtol=1e-6)


def test_tiles():
    """Two tilings of 2 x 2 cells over 13 rows and columns: the second is moved by one cell."""
    features = hrl.tile_features(ROOMS, width=2, num_tilings=2)
    assert (features.size, features.num_active) == (7 * 7 + 7 * 7, 2)
    share = features.dense() @ features.dense().T
    row, column = np.divmod(np.arange(169), 13)

    def tile(offset: int) -> np.ndarray:
        return (row + offset) // 2 * 100 + (column + offset) // 2

    expected = sum(tile(offset)[:, None] == tile(offset) for offset in (0, 1)) / 2
    np.testing.assert_allclose(share, expected, atol=1e-6)


def test_tiles_of_some_variables():
    features = hrl.tile_features(TAXI, ["row", "column"], width=5, num_tilings=1, apart=["passenger"])
    assert features.size == 5
    assert features.index[:, 0].tolist() == (np.arange(500) // 4 % 5).tolist()
    assert hrl.tile_features(TAXI, apart=["passenger", "destination"]) == hrl.tile_features(
        TAXI, ["row", "column"], apart=["passenger", "destination"]
    )


def test_dense_features_and_back():
    matrix = np.array([[0, 0.5, 0], [1, 0, -1], [0, 0, 0]], np.float32)
    features = Features.from_dense(matrix)
    assert features.num_active == 2
    np.testing.assert_array_equal(features.dense(), matrix)
    assert features == Features.from_dense(matrix.copy())
    assert hash(features) == hash(Features.from_dense(matrix))
    assert features != Features.from_dense(2 * matrix)


def test_bad_features_are_named():
    ones = np.ones((2, 2), np.float32)
    with pytest.raises(ValueError, match=r"once a state, got \[1 1\] in state 1"):
        Features(np.array([[0, 1], [1, 1]]), ones, 2)
    with pytest.raises(ValueError, match="from 0 to 1"):
        Features(np.array([[0, 2], [0, 1]]), ones, 2)
    with pytest.raises(ValueError, match="weight must be finite"):
        Features(np.array([[0, 1], [1, 0]]), ones * np.inf, 2)
    with pytest.raises(TypeError, match="index must be"):
        Features(ones, ones, 2)
    with pytest.raises(ValueError, match="apart"):
        hrl.tile_features(TAXI, apart=["fuel"])
    with pytest.raises(TypeError, match="tabular environment"):
        hrl.variable_features(3)
    with pytest.raises(ValueError, match="the features are over 500 states, Gridworld has 169"):
        hrl.train(ROOMS, hrl.LinearDyna(hrl.variable_features(TAXI)), KEY, 1)
