"""Exact solvers of known models."""

from hrljax.solvers.dynamic_programming import (
    Solution,
    action_values,
    policy_evaluation,
    policy_iteration,
    value_iteration,
)
from hrljax.solvers.model import Model

__all__ = ["Model", "Solution", "action_values", "policy_evaluation", "policy_iteration", "value_iteration"]
