"""Pictures of a state of the Mario environment: what the agent observes as text, and the screen."""

import numpy as np

from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.drawing import picture
from hrljax.envs.mario.env import Mario


def text(env: Mario, state: Episode) -> str:
    """The observation as 16 lines of 21 characters."""
    return "".join(bytes(row).decode("latin-1") + "\n" for row in np.asarray(env.observation(state)))


def rgb_array(env: Mario, state: Episode) -> np.ndarray:
    """The screen as ``[480, 640, 3]`` uint8."""
    return picture.screen(env.course, state.world)
