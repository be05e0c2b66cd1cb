"""Where the recordings of the original platformer lie."""

import os
from pathlib import Path

import pytest

EXCERPT = Path(__file__).parent / "data"
"""A few recorded levels of every type and difficulty, always there."""
LEVEL_FILES = {"levels.npz": 1320, "levels_w150.npz": 63, "levels_w620.npz": 63}


def recording(name: str) -> Path:
    """A file of the full recordings; skips the test where they are not."""
    folder = os.environ.get("HRLJAX_MARIO_DATA")
    if not folder:
        pytest.skip("HRLJAX_MARIO_DATA does not name the directory of the recordings")
    return Path(folder) / name
