"""Where experiments have learners run."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hrljax.core.environment import Numbers
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.leaf_cover import total_leaf_cover
from hrljax.hierarchy.tables import tabulate
from hrljax.solvers.dynamic_programming import policy_evaluation
from hrljax.solvers.model import Model


@dataclass(frozen=True)
class Domain:
    """An environment whose episodes are cut off early, and how many of them learners have."""

    name: str
    env: AnyTabularEnvironment
    max_steps: int
    episodes: int

    @property
    def params(self) -> Numbers:
        return self.env.default_params._replace(max_steps=self.max_steps)

    @cached_property
    def hierarchy(self) -> Hierarchy:
        return self.env.hierarchy()

    @cached_property
    def complete(self) -> Hierarchy:
        """With a total leaf cover."""
        active = tabulate(self.hierarchy, self.env).active
        return total_leaf_cover(self.hierarchy, active=active).hierarchy

    @cached_property
    def model(self) -> Model:
        return self.env.model(self.params)

    def expected_return(self, value: Any) -> float:
        """Of an episode, for the value of every state (``[S]``)."""
        return float(self.env.initial_distribution(self.params) @ np.asarray(value))

    def random_return(self) -> float:
        """Expected return of an episode with random actions."""
        uniform = np.full((self.model.num_states, self.model.num_actions), 1 / self.model.num_actions, np.float32)
        return self.expected_return(policy_evaluation(self.model, uniform, horizon=self.max_steps))
