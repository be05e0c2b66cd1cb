"""A* on the game itself: what perfect knowledge of the engine, monsters included, is worth (Baumgarten 2009)."""

from dataclasses import dataclass

import jax.numpy as jnp
from jax import Array

from hrljax.core import checks
from hrljax.envs.base import AnyEnvironment
from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.simulator import Simulator
from hrljax.learners.base import Context, Learner, LearnerState, Transition, Words
from hrljax.learners.hyperparameters import Hyperparameter, hyperparameter
from hrljax.search.a_star import AStarResult, a_star_search


@dataclass(frozen=True)
class MarioAStar(Learner[Mario, tuple[()], Array]):
    """Plans on the engine as the model in every step, and learns nothing.

    A plan minimises the steps to a point `horizon` tiles ahead, or to the exit; the estimate of what is left is the
    distance at top speed (`hrljax.envs.mario.simulator`). Baumgarten's agent of the Mario AI competition of 2009
    (Togelius, Karakovskiy and Baumgarten 2010) plans so; a step of this competition is five ticks long.

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
        return LearnerState((), jnp.int32(0))

    def begin(self, prepared: Mario, tables: tuple[()], first: Episode, words: Words, context: Context) -> Array:
        return self.search(prepared, first).action

    def action(self, control: Array) -> Array:
        return control

    def learn(
        self, prepared: Mario, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        return LearnerState((), self.search(prepared, transition.next_state).action)

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
