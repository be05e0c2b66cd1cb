"""``python -m hrljax``: what is installed, how runs are mapped on this machine, and what there is."""

import platform
from importlib.metadata import version

import jax

import hrljax as hrl
from hrljax.engine import batch
from hrljax.learners import Learner

_PACKAGES = ("jax", "jaxlib", "numpy", "xarray", "zarr", "gymnasium")
_MAPPED = {
    "native": "native loops, one run a core at a time",
    "vmap": "vmap over a batch of runs",
}


def report() -> str:
    """A line for each thing that matters to what runs do and how fast."""
    offered = (getattr(hrl, name) for name in hrl.__all__)
    learners = sorted(thing.__name__ for thing in offered if isinstance(thing, type) and issubclass(thing, Learner))
    rows = {
        "hrljax": hrl.__version__,
        "Python": f"{platform.python_version()} on {platform.system()} {platform.machine()}",
        **{package: version(package) for package in _PACKAGES},
        "devices": f"{', '.join(map(str, jax.devices()))}; {batch.usable_cores()} cores",
        "runs": f"{_MAPPED[batch.resolve_mapping('auto')]} (mapping='auto')",
        "loops": batch.cost_of_loops(),
        "environments": ", ".join(hrl.registered()),
        "learners": ", ".join(learners),
    }
    return "\n".join(f"{name:<14}{value}" for name, value in rows.items())


if __name__ == "__main__":
    print(report())
