"""Hierarchical reinforcement learning in JAX: learning rates measured over thousands of seeds."""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from hrljax import xla as _xla

_xla.request_native_loops()

from hrljax import solvers  # noqa: E402
from hrljax.envs.base import Environment, TabularEnvironment  # noqa: E402
from hrljax.envs.registry import make, register, registered  # noqa: E402
from hrljax.hierarchy import Abstraction, Hierarchy, Subtask  # noqa: E402
from hrljax.learners.flat import SARSA, QLearning  # noqa: E402
from hrljax.learners.hamq import HAMQ  # noqa: E402
from hrljax.learners.hierarchical import HORDQ, MAXQ, MAXQ0  # noqa: E402
from hrljax.learners.roots import ModelRoot, RandomRoot  # noqa: E402
from hrljax.results import load, save  # noqa: E402
from hrljax.sweep import sweep  # noqa: E402
from hrljax.train import Run, train  # noqa: E402

if _TYPE_CHECKING:
    from hrljax import plots, stats

__all__ = [
    "HAMQ",
    "HORDQ",
    "MAXQ",
    "MAXQ0",
    "SARSA",
    "Abstraction",
    "Environment",
    "Hierarchy",
    "ModelRoot",
    "QLearning",
    "RandomRoot",
    "Run",
    "Subtask",
    "TabularEnvironment",
    "load",
    "make",
    "plots",
    "register",
    "registered",
    "save",
    "solvers",
    "stats",
    "sweep",
    "train",
]


def __getattr__(name: str) -> _Any:
    """Loads what is slow to import when it is first used."""
    if name in ("plots", "stats"):
        return _import_module(f"hrljax.{name}")
    raise AttributeError(f"module 'hrljax' has no attribute {name!r}")
