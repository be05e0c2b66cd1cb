"""What an environment of one's own is made of; docs/own_environment.md shows how."""

from hrljax.core.random import below
from hrljax.envs.base import Environment, TabularEnvironment
from hrljax.envs.factored import FactoredStates

__all__ = ["Environment", "FactoredStates", "TabularEnvironment", "below"]
