"""Data shaped as a dataset of `hrljax.sweep`."""

import numpy as np
import xarray as xr

EPISODES = [10, 20, 30, 40, 45]  # the last bin is half as long


def curve(seeds: int = 6, **axes: list[float]) -> xr.Dataset:
    """Normally distributed returns and lengths, with the last bin of episodes half as long."""
    shape = (*map(len, axes.values()), seeds, len(EPISODES))
    values = np.random.default_rng(1).normal(-30, 5, shape)
    dims = (*axes, "seed", "episode")
    variables = {"return": (dims, values, {"long_name": "return per episode"})}
    variables["length"] = (dims, -values, {"long_name": "steps per episode", "units": "steps"})
    return xr.Dataset(variables, {**axes, "seed": np.arange(seeds), "episode": EPISODES}, {"learner": "HORDQ"})
