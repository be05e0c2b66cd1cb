"""Exact solvers of known models, without and with a task hierarchy."""

from hrljax.solvers.decomposition import Decomposed, decompose
from hrljax.solvers.dynamic_programming import (
    Solution,
    action_values,
    policy_evaluation,
    policy_iteration,
    value_iteration,
)
from hrljax.solvers.hierarchical import Criterion, Optima, recursively_optimal, solve_hierarchy
from hrljax.solvers.joint import JointProcess, NoBestPolicyError, joint_process
from hrljax.solvers.joint_optima import Optimum, greedy, optimise
from hrljax.solvers.model import Model

__all__ = [
    "Criterion",
    "Decomposed",
    "JointProcess",
    "Model",
    "NoBestPolicyError",
    "Optima",
    "Optimum",
    "Solution",
    "action_values",
    "decompose",
    "greedy",
    "joint_process",
    "optimise",
    "policy_evaluation",
    "policy_iteration",
    "recursively_optimal",
    "solve_hierarchy",
    "value_iteration",
]
