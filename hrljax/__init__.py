"""Hierarchical reinforcement learning in JAX: learning rates measured over thousands of seeds."""

from importlib import import_module as _import_module
from importlib.metadata import version as _version
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from hrljax.engine import compiler as _xla

_xla.request_native_loops()

__version__ = _version("hrljax")

from hrljax import solvers  # noqa: E402
from hrljax.engine import batch as _batch  # noqa: E402
from hrljax.engine.run import Run  # noqa: E402
from hrljax.engine.train import train  # noqa: E402
from hrljax.envs.base import Environment, TabularEnvironment  # noqa: E402
from hrljax.envs.check import check  # noqa: E402
from hrljax.envs.registry import make, register, registered  # noqa: E402
from hrljax.hierarchy.definition import Abstraction, Hierarchy, Subtask  # noqa: E402
from hrljax.hierarchy.leaf_cover import inaccessible, total_leaf_cover  # noqa: E402
from hrljax.hierarchy.tables import tabulate  # noqa: E402
from hrljax.learners.dyna import DynaQ  # noqa: E402
from hrljax.learners.fading import Fading  # noqa: E402
from hrljax.learners.features import Features, tile_features, variable_features  # noqa: E402
from hrljax.learners.feudal import FeudalQ  # noqa: E402
from hrljax.learners.flat import SARSA, QLearning  # noqa: E402
from hrljax.learners.hamq import HAMQ  # noqa: E402
from hrljax.learners.hordq import HORDQ, MAXQ, MAXQ0  # noqa: E402
from hrljax.learners.kwik import KWIKRMax  # noqa: E402
from hrljax.learners.linear_dyna import LinearDyna  # noqa: E402
from hrljax.learners.mario.a_star import MarioAStar  # noqa: E402
from hrljax.learners.options.definition import Options, options_from, primitive_options  # noqa: E402
from hrljax.learners.options.discovery import bottleneck_options, eigen_options  # noqa: E402
from hrljax.learners.options.h_dyna import HDyna  # noqa: E402
from hrljax.learners.options.learner import OptionQ  # noqa: E402
from hrljax.learners.relational.a_star_root import AStarRoot  # noqa: E402
from hrljax.learners.relational.encounter_model import MarioEncounters  # noqa: E402
from hrljax.learners.relational.given_model import MarioDynamics  # noqa: E402
from hrljax.learners.relational.learned_model import MarioModel  # noqa: E402
from hrljax.learners.relational.learner import RelationalHORDQ  # noqa: E402
from hrljax.learners.relational.memory_model import MarioMemory  # noqa: E402
from hrljax.learners.relational.multiway_model import MultiwayModel  # noqa: E402
from hrljax.learners.relational.search_root import SearchRoot  # noqa: E402
from hrljax.learners.rldt import RLDT, SPITI  # noqa: E402
from hrljax.learners.rmax import RMax  # noqa: E402
from hrljax.learners.roots.linear import LinearRoot  # noqa: E402
from hrljax.learners.roots.model import ModelRoot  # noqa: E402
from hrljax.learners.roots.random import RandomRoot  # noqa: E402
from hrljax.learners.roots.rldt import RLDTRoot  # noqa: E402
from hrljax.learners.shared import SharedHORDQ  # noqa: E402
from hrljax.learners.traces import QLambda, SARSALambda  # noqa: E402
from hrljax.search.a_star import a_star_search  # noqa: E402
from hrljax.search.best_first import best_first_search  # noqa: E402
from hrljax.solvers import sweeps as _sweeps  # noqa: E402
from hrljax.sweeps.axes import Points, points  # noqa: E402
from hrljax.sweeps.estimate import estimate  # noqa: E402
from hrljax.sweeps.io import load, save  # noqa: E402
from hrljax.sweeps.learned import Learned  # noqa: E402
from hrljax.sweeps.logs import CSVLog, TensorBoardLog  # noqa: E402
from hrljax.sweeps.processes import processes  # noqa: E402
from hrljax.sweeps.sweep import sweep  # noqa: E402

_sweeps.loops_are_native = lambda: _batch.resolve_mapping("auto") == "native"

if _TYPE_CHECKING:
    from hrljax import plots, stats
    from hrljax.interop.rollout import Rollout, rollout

__all__ = [
    "HAMQ",
    "HORDQ",
    "MAXQ",
    "MAXQ0",
    "RLDT",
    "SARSA",
    "SPITI",
    "AStarRoot",
    "Abstraction",
    "CSVLog",
    "DynaQ",
    "Environment",
    "Fading",
    "Features",
    "FeudalQ",
    "HDyna",
    "Hierarchy",
    "KWIKRMax",
    "Learned",
    "LinearDyna",
    "LinearRoot",
    "MarioAStar",
    "MarioDynamics",
    "MarioEncounters",
    "MarioMemory",
    "MarioModel",
    "ModelRoot",
    "MultiwayModel",
    "OptionQ",
    "Options",
    "Points",
    "QLambda",
    "QLearning",
    "RLDTRoot",
    "RMax",
    "RandomRoot",
    "RelationalHORDQ",
    "Rollout",
    "Run",
    "SARSALambda",
    "SearchRoot",
    "SharedHORDQ",
    "Subtask",
    "TabularEnvironment",
    "TensorBoardLog",
    "a_star_search",
    "best_first_search",
    "bottleneck_options",
    "check",
    "eigen_options",
    "estimate",
    "inaccessible",
    "load",
    "make",
    "options_from",
    "plots",
    "points",
    "primitive_options",
    "processes",
    "register",
    "registered",
    "rollout",
    "save",
    "solvers",
    "stats",
    "sweep",
    "tabulate",
    "tile_features",
    "total_leaf_cover",
    "train",
    "variable_features",
]


def __getattr__(name: str) -> _Any:
    """Loads what is slow to import when it is first used."""
    if name in ("plots", "stats"):
        return _import_module(f"hrljax.{name}")
    if name in ("Rollout", "rollout"):
        return getattr(_import_module("hrljax.interop.rollout"), name)
    raise AttributeError(f"module 'hrljax' has no attribute {name!r}")
