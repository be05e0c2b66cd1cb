"""Hierarchical reinforcement learning in JAX: learning rates measured over thousands of seeds."""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from hrljax import xla as _xla

_xla.request_native_loops()

from hrljax import solvers  # noqa: E402
from hrljax.check_environment import check  # noqa: E402
from hrljax.envs.base import Environment, TabularEnvironment  # noqa: E402
from hrljax.envs.registry import make, register, registered  # noqa: E402
from hrljax.estimate import plan  # noqa: E402
from hrljax.hierarchy import Abstraction, Hierarchy, Subtask  # noqa: E402
from hrljax.leaf_covers import inaccessible, total_leaf_cover  # noqa: E402
from hrljax.learned import Learned  # noqa: E402
from hrljax.learners.dyna import DynaQ  # noqa: E402
from hrljax.learners.flat import SARSA, QLearning  # noqa: E402
from hrljax.learners.hamq import HAMQ  # noqa: E402
from hrljax.learners.hierarchical import HORDQ, MAXQ, MAXQ0  # noqa: E402
from hrljax.learners.option_set import Options, options_from, primitive_options  # noqa: E402
from hrljax.learners.options import OptionQ  # noqa: E402
from hrljax.learners.relational import RelationalHORDQ  # noqa: E402
from hrljax.learners.rmax import RMax  # noqa: E402
from hrljax.learners.roots import ModelRoot, RandomRoot  # noqa: E402
from hrljax.learners.search_root import SearchRoot  # noqa: E402
from hrljax.learners.traces import QLambda, SARSALambda  # noqa: E402
from hrljax.models.mario_dynamics import MarioDynamics  # noqa: E402
from hrljax.models.mario_model import MarioModel  # noqa: E402
from hrljax.planners.best_first import best_first_search  # noqa: E402
from hrljax.results import load, save  # noqa: E402
from hrljax.sweep import sweep  # noqa: E402
from hrljax.train import Run, train  # noqa: E402

if _TYPE_CHECKING:
    from hrljax import plots, stats, task_graphs, workers

__all__ = [
    "HAMQ",
    "HORDQ",
    "MAXQ",
    "MAXQ0",
    "SARSA",
    "Abstraction",
    "DynaQ",
    "Environment",
    "Hierarchy",
    "Learned",
    "MarioDynamics",
    "MarioModel",
    "ModelRoot",
    "OptionQ",
    "Options",
    "QLambda",
    "QLearning",
    "RMax",
    "RandomRoot",
    "RelationalHORDQ",
    "Run",
    "SARSALambda",
    "SearchRoot",
    "Subtask",
    "TabularEnvironment",
    "best_first_search",
    "check",
    "inaccessible",
    "load",
    "make",
    "options_from",
    "plan",
    "plots",
    "primitive_options",
    "register",
    "registered",
    "save",
    "solvers",
    "stats",
    "sweep",
    "task_graphs",
    "total_leaf_cover",
    "train",
    "workers",
]


def __getattr__(name: str) -> _Any:
    """Loads what is slow to import when it is first used."""
    if name in ("plots", "stats", "task_graphs", "workers"):
        return _import_module(f"hrljax.{name}")
    raise AttributeError(f"module 'hrljax' has no attribute {name!r}")
