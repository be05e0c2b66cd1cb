"""Settings of Mario's learned model."""

import numpy as np
import pytest

from hrljax import MarioModel


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"rows": 0}, ValueError, "MarioModel: rows must be an integer from 1 to 1048576, got 0"),
        ({"rows": "5"}, TypeError, "MarioModel: rows must be an integer from 1 to 1048576, got '5'"),
        ({"max_depth": 0}, ValueError, "MarioModel: max_depth must be an integer from 1 to 64, got 0"),
        ({"min_leaf": 0}, ValueError, "MarioModel: min_leaf must be an integer from 1 to 1048576, got 0"),
        ({"num_bins": 1}, ValueError, "MarioModel: num_bins must be an integer from 2 to 1024, got 1"),
        ({"size": 4}, ValueError, "MarioModel: size must be an odd integer from 1 to 11, got 4"),
        ({"size": 13}, ValueError, "MarioModel: size must be an odd integer from 1 to 11, got 13"),
        ({"offsets": "x"}, ValueError, "MarioModel: offsets must be one of False, True, got 'x'"),
        ({"below": 2}, ValueError, "MarioModel: below must be one of False, True, got 2"),
        ({"pessimism": "a"}, TypeError, "MarioModel: pessimism must be a number, got 'a'"),
        (
            {"pessimism": -0.1},
            ValueError,
            r"MarioModel: pessimism must be a finite number in \[0, 3.4e\+38\], got -0.1",
        ),
    ],
)
def test_bad_settings_are_refused(settings: dict, error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        MarioModel(**settings)


@pytest.mark.parametrize("size", [1, 11])
def test_every_allowed_size_makes_trees(size: int):
    model = MarioModel(size=np.int64(size), offsets=True, rows=np.int32(9))  # type: ignore[arg-type]
    assert (type(model.size), type(model.rows)) == (int, int)
    assert model.motion_tree.num_inputs == size**2 + 4
    assert model.reward_tree(12).num_inputs == size**2 + 5
