"""Films: they read back as they were, and bad ones are refused."""

import numpy as np
import pytest
from PIL import Image

from hrljax.envs.film import save_gif


def test_films_read_back(tmp_path):
    frames = [np.full((20, 30, 3), value, np.uint8) for value in (0, 120, 250)]
    save_gif(iter(frames), tmp_path / "film.gif", fps=10)
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.n_frames, film.size, film.info["duration"], film.info["loop"]) == (3, (30, 20), 100, 0)
        for i, frame in enumerate(frames):
            film.seek(i)
            assert np.abs(np.asarray(film.convert("RGB")).astype(int) - frame).max() < 9
    assert [path.name for path in tmp_path.iterdir()] == ["film.gif"]


@pytest.mark.parametrize(
    ("frames", "fps", "message"),
    [
        ([], 24, "frames must be at least one, got none"),
        ([np.zeros((4, 4, 3), np.uint8)], 0, "fps must be a finite number in .0, 50., got 0"),
        ([np.zeros((4, 4, 3), np.float32)], 24, r"frame 0 must be a uint8 array .* got float32 of shape \[4, 4, 3\]"),
        ([np.zeros((4, 4, 3), np.uint8), np.zeros((5, 4, 3), np.uint8)], 24, "frame 1 must be a uint8 array of shape"),
    ],
)
def test_bad_films_are_refused_and_leave_nothing(tmp_path, frames, fps, message):
    with pytest.raises(ValueError, match=message):
        save_gif(frames, tmp_path / "film.gif", fps)
    assert not list(tmp_path.iterdir())
