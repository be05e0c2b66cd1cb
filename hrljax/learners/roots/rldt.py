"""A root that plans on trees: RL-DT over subtasks instead of actions."""

from dataclasses import dataclass

import numpy as np
from jax import Array

from hrljax.envs.base import AnyTabularEnvironment
from hrljax.learners.base import Context, Transition
from hrljax.learners.effects import FactoredModel
from hrljax.learners.hyperparameters import Hyperparameter, hyperparameter
from hrljax.learners.roots.smdp import SMDPPrepared, SMDPRoot
from hrljax.learners.tree_planner import TreePlanner, TreeTables


@dataclass(frozen=True)
class RLDTRoot(TreePlanner, SMDPRoot):
    """RL-DT (Hester and Stone 2009) whose actions are the subtasks.

    As `hrljax.RLDT`, with the discounted reward of a subtask until it ends, and the discount to the power of its steps,
    each predicted by a tree. Trees are as biased as variables are not independent of each other; what they miss, the
    subtasks of HORDQ under it have to make good.

    Attributes:
        optimistic_value, satisfying_value, least_value, least_score, refit_below, planning_tolerance, effects, score,
            explores, planning_sweeps, max_nodes, max_outcomes: as of `hrljax.RLDT`.
        known_after: times after which a subtask is known in a state, at least 1.
        refit_interval: subtasks that end between two fits, at least 1.
        max_rewards: different rewards of a subtask, and different discounts, that are told apart, at least 2. Others
            count as the nearest of them.
    """

    satisfying_value: Hyperparameter = hyperparameter(-40.0)
    refit_interval: int = 100
    max_rewards: int = 32

    name = "RL-DT"
    has_loops = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("max_rewards", 2)

    def model_over(self, env: AnyTabularEnvironment, invocable: np.ndarray) -> FactoredModel:
        states, tasks = env.factored(), invocable.shape[1]
        return self.model_of(states, tasks, num_weights=self.max_rewards, allowed=invocable.ravel())

    def init(self, prepared: SMDPPrepared[FactoredModel]) -> TreeTables:
        return self.nothing_learned(prepared.model)

    def worth_of(self, model: FactoredModel, tables: TreeTables, state: Array, context: Context) -> list[Array]:
        return self.worth(model, tables, state)

    def after(
        self, model: FactoredModel, tables: TreeTables, step: Transition, discount: Array, context: Context
    ) -> TreeTables:
        return self.learned(model, tables, step, discount, np.float32(1), None, context)
