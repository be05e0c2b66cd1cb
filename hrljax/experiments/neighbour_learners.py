"""The learners that `scripts/neighbours.py` compares, and where."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from hrljax.envs.bus.env import Bus
from hrljax.envs.grid.gridworld import Gridworld
from hrljax.envs.grid.maze import Maze
from hrljax.envs.taxi.env import Taxi
from hrljax.experiments.domains import Domain as AnyDomain
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.base import AnyLearner
from hrljax.learners.dyna import DynaQ
from hrljax.learners.features import Features, state_features, variable_features
from hrljax.learners.feudal import FeudalQ
from hrljax.learners.flat import SARSA, QLearning
from hrljax.learners.hamq import HAMQ
from hrljax.learners.hordq import HORDQ, MAXQ, MAXQ0
from hrljax.learners.kwik import KnownEffects, KWIKRMax
from hrljax.learners.linear_dyna import LinearDyna
from hrljax.learners.options.definition import Options, options_from
from hrljax.learners.options.discovery import bottleneck_options, eigen_options
from hrljax.learners.options.h_dyna import HDyna
from hrljax.learners.options.learner import OptionQ
from hrljax.learners.rldt import RLDT, SPITI
from hrljax.learners.rmax import RMax
from hrljax.learners.roots.linear import LinearRoot
from hrljax.learners.roots.model import ModelRoot
from hrljax.learners.roots.rldt import RLDTRoot
from hrljax.learners.shared import SharedHORDQ
from hrljax.learners.traces import QLambda, SARSALambda

_FEW_STATES = 200


@dataclass(frozen=True)
class Domain(AnyDomain):
    """A domain, and the numbers that its learners share."""

    step_size: float
    initial_value: float = 0.0
    best_reward: float = 0.0  # more than this is never earned from anywhere: optimism of R-MAX
    known_after: int = 1  # steps after which chance has shown itself, for R-MAX
    refit_interval: int = 1  # steps between two models by trees, which chance surprises again and again
    satisfying_value: float = -100.0  # less than this is too little for RL-DT to stop exploring

    @property
    def usual(self) -> dict[str, Any]:
        return {"step_size": self.step_size, "initial_value": self.initial_value}

    @cached_property
    def ways(self) -> Options:
        return options_from(self.hierarchy, self.env)

    @cached_property
    def features(self) -> Features:
        """Tables where they are small, else one feature a value of each variable."""
        return (state_features if self.env.num_states <= _FEW_STATES else variable_features)(self.env)

    @cached_property
    def root_decides(self) -> bool:
        """Whether the root has a choice anywhere."""
        return bool((tabulate(self.hierarchy, self.env).root_counts > 1).any())

    @property
    def has_chance(self) -> bool:
        """Whether an action has more than one effect."""
        return KnownEffects.of(self.env).num_effects > 1

    @property
    def is_grid(self) -> bool:
        return set(self.env.factored().names) == {"row", "column"}


def domains() -> dict[str, Domain]:
    """Maze, Taxi with Gymnasium's rewards, without and with chance, Bus and four rooms, by name."""
    every = (
        Domain("Maze", Maze(), 200, 200, 0.5),
        Domain("Four rooms", Gridworld(), 1000, 300, 0.5),
        Domain("Taxi", Taxi(rules="gymnasium"), 200, 1500, 0.5, best_reward=20.0),
        Domain(
            "stochastic Taxi",
            Taxi(stochastic=True, rules="gymnasium"),
            200,
            3000,
            0.2,
            best_reward=20.0,
            known_after=5,
            refit_interval=20,
        ),
        Domain("Bus", Bus(), 200, 6000, 0.1, -25.0, known_after=5, refit_interval=1000, satisfying_value=-35.0),
    )
    return {domain.name: domain for domain in every}


LEARNERS: dict[str, Callable[[Domain], AnyLearner | None]] = {
    "Q-learning": lambda d: QLearning(**d.usual),
    "SARSA(0)": lambda d: SARSA(**d.usual),
    "Q(0.9)": lambda d: QLambda(**d.usual),
    "SARSA(0.9)": lambda d: SARSALambda(**d.usual),
    "Dyna-Q": lambda d: DynaQ(**d.usual, outcomes_kept=d.known_after),
    "R-MAX": lambda d: RMax(
        optimistic_value=d.best_reward, known_after=d.known_after, planning_tolerance=0.1, planning_sweeps=50
    ),
    "KWIK-R-MAX": lambda d: (
        KWIKRMax(optimistic_value=d.best_reward, planning_tolerance=0.1, planning_sweeps=50) if d.has_chance else None
    ),
    "RL-DT": lambda d: RLDT(
        optimistic_value=d.best_reward, satisfying_value=d.satisfying_value, refit_interval=d.refit_interval
    ),
    "SPITI": lambda d: SPITI(optimistic_value=d.best_reward, refit_interval=max(10, d.refit_interval)),
    "linear Dyna": lambda d: LinearDyna(d.features, d.step_size, d.step_size, initial_value=d.initial_value),
    "options, SMDP": lambda d: OptionQ(d.ways, **d.usual),
    "options, intra-option": lambda d: OptionQ(d.ways, **d.usual, update="intra_option"),
    "bottleneck options": lambda d: OptionQ(bottleneck_options(d.env), **d.usual),
    "eigen-options": lambda d: OptionQ(eigen_options(d.env), **d.usual),
    "H-DYNA": lambda d: HDyna(d.ways, **d.usual),
    "feudal Q-learning": lambda d: FeudalQ(step_size=d.step_size) if d.is_grid else None,
    "HAMQ": lambda d: HAMQ(d.hierarchy, **d.usual),
    "MAXQ-0": lambda d: MAXQ0(d.hierarchy, step_size=d.step_size),
    "MAXQ-Q": lambda d: MAXQ(d.hierarchy, step_size=d.step_size, pseudo_reward=20.0),
    "HORDQ": lambda d: HORDQ(d.hierarchy, **d.usual),
    "shared HORDQ": lambda d: SharedHORDQ(d.complete, **d.usual),
    "shared HORDQ, model root": lambda d: (
        SharedHORDQ(d.complete, ModelRoot(), **d.usual) if d.hierarchy.root.abstraction else None
    ),
    "shared HORDQ, linear root": lambda d: (
        SharedHORDQ(d.complete, LinearRoot(d.features), **d.usual) if d.root_decides else None
    ),
    "shared HORDQ, RL-DT root": lambda d: (
        SharedHORDQ(
            d.complete,
            RLDTRoot(
                optimistic_value=d.best_reward,
                satisfying_value=d.satisfying_value,
                refit_interval=max(100, d.refit_interval),
                planning_sweeps=50,
            ),
            **d.usual,
        )
        if d.root_decides
        else None
    ),
}
"""What makes each learner for a domain, by name; None where it does not apply. Other numbers are the defaults."""
