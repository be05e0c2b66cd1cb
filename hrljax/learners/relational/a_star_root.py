"""A root that plans in Mario by A*: on his own dynamics, without or with what is learned of meeting things."""

from dataclasses import dataclass
from typing import Any

import chex
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.numerics import exact_product, opaque_zero
from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.levels.tiles import TILE
from hrljax.envs.mario.stretch import TOP_STEP, Stretch
from hrljax.learners.hyperparameters import Hyperparameter, hyperparameter
from hrljax.learners.relational.encounter_model import MarioEncounters
from hrljax.learners.relational.given_model import MarioDynamics
from hrljax.learners.relational.memory_model import MarioMemory
from hrljax.learners.relational.planner_model import PlannerModel
from hrljax.learners.relational.search_root import PlanningRoot
from hrljax.search.a_star import AStarResult, a_star_search
from hrljax.search.best_first import Loop

_LEAST_COST = np.float32(0.1)
"""Of a step that earns so much that it would cost nothing: no way may grow cheaper by being longer."""


@dataclass(frozen=True)
class AStarRoot(PlanningRoot):
    """Suggests the first action of the way to a point ahead that costs the fewest steps by a model.

    A step of the model that earns r and leads Mario d tiles to the right costs

        c = max(0.1, 1 - (r - d) / v)

    steps: one, and what it earns or loses beside the distance in steps at top speed, of v = 3.07 tiles each. A step in
    which Mario dies, or with which the model sees a look-ahead end before the exit, is not taken. What is left is the
    distance at top speed, as in `hrljax.MarioAStar`, which asks the game itself.

    Attributes:
        model: `hrljax.MarioDynamics`, `hrljax.MarioEncounters` or `hrljax.MarioMemory` of one of them, which know how
            fast Mario really is.
        weight: of the estimate; above 1 it hurries to the goal.
        max_expansions: nodes that are looked on from, each with every action.
        horizon: in tiles.
        depth: steps that a plan has at most.
        follow, refit_interval: see `hrljax.learners.relational.search_root.PlanningRoot`.
    """

    model: PlannerModel[Any] = MarioEncounters()
    depth: int = 24
    weight: Hyperparameter = hyperparameter(1.5, 0)
    max_expansions: int = 512
    horizon: int = 20

    name = "A*"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("max_expansions", "horizon"):
            self._check_integer(name, 1)
        kinds = (MarioDynamics, MarioEncounters, MarioMemory)
        checks.instance("AStarRoot: model", self.model, kinds, "a MarioDynamics, MarioEncounters or MarioMemory")

    def search(self, env: Mario, tables: chex.ArrayTree, episode: Episode, loop: Loop = "while") -> AStarResult:
        model, start = self.model.planned(env, tables, episode)
        stretch, of_distance = Stretch(start.player, self.horizon), env.default_params.displacement_reward

        def step(state: Any, action: Array) -> tuple[Any, Array]:
            after, reward, *ended = model(state, action)
            before, now = state.player, after.player
            zero = opaque_zero(lax.bitcast_convert_type(now.x, jnp.uint32))
            distance = exact_product(np.float32(of_distance / TILE), now.x - before.x, zero)
            extra = exact_product(np.float32(TILE / TOP_STEP), reward - distance, zero)
            closed = (now.death_time > 0) | ((now.win_time == 0) & (ended[0] if ended else False))
            return after, lax.select(closed, jnp.float32(np.inf), lax.max(_LEAST_COST, np.float32(1) - extra))

        return a_star_search(
            step,
            start,
            env.num_actions,
            lambda state: stretch.steps_left(state.player),
            depth=self.depth,
            max_expansions=self.max_expansions,
            weight=jnp.asarray(self.weight),
            place=lambda state, depth: stretch.place(state.player, depth),
            num_places=stretch.num_places(self.depth),
        )
