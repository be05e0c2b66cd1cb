"""A* on the game itself: what perfect knowledge of the engine, monsters included, is worth (Baumgarten 2009)."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import checks
from hrljax.envs.base import AnyEnvironment
from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.simulator import Simulator
from hrljax.learners.base import Context, Learner, LearnerState, Transition, Words
from hrljax.learners.hyperparameters import Hyperparameter, hyperparameter
from hrljax.search.a_star import AStarResult, a_star_search


class Plan(NamedTuple):
    """The steps that are to come."""

    actions: Array  # [depth] int32, then -1
    arrives: Array  # bool: whether they lead to the goal of their search

    @property
    def action(self) -> Array:
        """The first of them (int32); 0 if there is none."""
        return lax.max(self.actions[0], jnp.int32(0))


def plan_of(result: AStarResult) -> Plan:
    return Plan(result.actions, result.estimate <= 0)


def kept(plan: Plan, new: Plan) -> Plan:
    """What is left of a plan after its first step, if only it arrives; else a new one."""
    rest = jnp.roll(plan.actions, -1).at[-1].set(-1)
    keeps = plan.arrives & ~new.arrives & (rest[0] >= 0)
    return jax.tree.map(lambda old, other: jnp.where(keeps, old, other), Plan(rest, plan.arrives), new)


@dataclass(frozen=True)
class MarioAStar(Learner[Mario, tuple[()], Plan]):
    """Plans on the engine as the model in every step, and learns nothing.

    A plan minimises the steps to a point `horizon` tiles ahead, or to the exit; the estimate of what is left is the
    distance at top speed (`hrljax.envs.mario.simulator`). Baumgarten's agent of the Mario AI competition of 2009
    (Togelius, Karakovskiy and Baumgarten 2010) plans so; a step of this competition is five ticks long. Games in one
    cell count as one, so a search may miss a way that the last one saw. Where it does not arrive and the last plan
    does, what is left of that is followed: it comes true.

    Attributes:
        max_expansions: games that are looked on from in a step, each with every action; a step of real time is
            208 ms long.
        horizon: in tiles.
        depth: steps that a plan has at most.
        weight: of the estimate; above 1 it hurries to the goal.
        damage_cost: steps that a hit is worth which Mario survives.
    """

    weight: Hyperparameter = hyperparameter(1.5, 0)
    damage_cost: Hyperparameter = hyperparameter(20.0, 0)
    max_expansions: int = 512
    horizon: int = 20
    depth: int = 24

    name = "A*"
    is_tabular = False
    num_words = 0
    num_begin_words = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("max_expansions", "horizon", "depth"):
            self._check_integer(name, 1)

    def prepare(self, env: AnyEnvironment) -> Mario:
        return checks.instance("env", env, Mario, "Mario, hrljax.make('Mario'), for MarioAStar")

    def init(self, env: Mario, prepared: Mario) -> LearnerState:
        return LearnerState((), Plan(jnp.full(self.depth, -1, jnp.int32), jnp.bool_(False)))

    def begin(self, prepared: Mario, tables: tuple[()], first: Episode, words: Words, context: Context) -> Plan:
        return plan_of(self.search(prepared, first))

    def action(self, control: Plan) -> Array:
        return control.action

    def learn(
        self, prepared: Mario, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        return LearnerState((), kept(state.control, plan_of(self.search(prepared, transition.next_state))))

    def search(self, env: Mario, episode: Episode) -> AStarResult:
        """The plan at a moment of an episode, with the games that were looked on from."""
        game = Simulator(env, episode, env.default_params.max_steps, self.horizon, jnp.asarray(self.damage_cost))
        return a_star_search(
            game.model,
            episode,
            env.num_actions,
            game.estimate,
            depth=self.depth,
            max_expansions=self.max_expansions,
            weight=jnp.asarray(self.weight),
            place=game.place,
            num_places=game.num_places(self.depth),
        )
