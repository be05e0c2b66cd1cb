"""R-MAX: optimism about every state and action that is not known yet."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.choices import Ties
from hrljax.core.lockstep import once_if
from hrljax.core.numerics import take
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.learners import samples as model
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.flat import ActionValueLearner, row_of
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter, later_option
from hrljax.learners.planning import settled


class RMaxTables(NamedTuple):
    """What R-MAX has learned."""

    values: Array  # [S * A] float32: action values of the optimistic model
    samples: model.Samples  # the first outcomes of every pair


@dataclass(frozen=True)
class RMax(ActionValueLearner):
    """R-MAX (Brafman and Tennenholtz 2002; thesis ch. 1), with planning of bounded cost.

    A (state, action) pair is known after `known_after` visits. Its model is the mean of their
    outcomes and stays as it is; every other pair is worth `optimistic_value`. Whenever a pair
    becomes known, and only then, value iteration improves the action values, from where the last one
    left them, until a sweep changes none by more than `planning_tolerance`.

    Attributes:
        epsilon: probability of a uniformly random action, or a schedule of the episode; R-MAX itself
            explores by optimism alone. Else it takes the best one.
        discount: in [0, 1].
        optimistic_value: of unknown pairs. Should be at least what any policy can earn: ``R_max / (1
            - discount)`` in the paper, 0 where every reward is a cost.
        known_after: visits after which a pair is known, at least 1.
        planning_tolerance: at least 0.
        planning_sweeps: most Jacobi sweeps over all pairs when one becomes known, at least 1. A bound
            that is often reached is too low: where nothing is left to become known, values that are
            still too optimistic are not corrected any more.
        ties: as of `QLearning`.
    """

    epsilon: Hyperparameter = hyperparameter(0.0, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    optimistic_value: Hyperparameter = hyperparameter(0.0)
    planning_tolerance: Hyperparameter = hyperparameter(0.01, 0)
    known_after: int = 5
    planning_sweeps: int = 500
    ties: Ties = later_option("first")

    name = "R-MAX"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("known_after", 1)
        self._check_integer("planning_sweeps", 1)

    def init(self, env: AnyTabularEnvironment, prepared: int) -> LearnerState:
        values = jnp.full(env.num_states * prepared, self._optimistic())
        samples = model.empty(env.num_states, prepared, self.known_after)
        return LearnerState(RMaxTables(values, samples), jnp.int32(0))

    def learn(
        self, prepared: int, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        tables: RMaxTables = state.tables
        pair = transition.state * prepared + transition.action
        num_states = len(tables.values) // prepared
        missing = self.known_after - take(tables.samples.seen, pair)

        def observed(tables: RMaxTables, learns: Array) -> RMaxTables:
            return tables._replace(samples=model.recorded(tables.samples, pair, transition, num_states, learns))

        # The last outcome is recorded where it is planned with: with samples that do not change
        # there, the compiler would move parts of the planning out, to where they run every step.
        tables = once_if(
            context.learns & (missing == 1),
            lambda tables: self._planned(observed(tables, jnp.bool_(True)), prepared, context),
            observed(tables, context.learns & (missing > 1)),
        )
        action = self.choose(row_of(tables.values, transition.next_state, prepared), words[0], context)
        return LearnerState(tables, action)

    def _planned(self, tables: RMaxTables, prepared: int, context: Context) -> RMaxTables:
        num_pairs = len(tables.values)
        known = tables.samples.seen >= self.known_after
        after = tables.samples.after.reshape(-1, num_pairs)
        share = np.float32(1 / self.known_after)
        reward = context.product(share, _sum(list(tables.samples.reward.reshape(-1, num_pairs))))
        # A discount that is known to be 1 must be no factor: the compiler would see two products and nothing between.
        discount = at_episode(self.discount, context.episode)

        def sweep(values: Array) -> Array:
            at_states = jnp.concatenate([values.reshape(-1, prepared).max(-1), jnp.zeros(1, jnp.float32)])
            follows = [at_states.at[states].get(mode="promise_in_bounds") for states in after]
            mean = context.product(share, _sum(follows))
            backed_up = reward + context.product(discount, mean)
            return lax.select(known, backed_up, jnp.broadcast_to(self._optimistic(), backed_up.shape))

        tolerance = jnp.asarray(self.planning_tolerance, jnp.float32)
        return tables._replace(values=settled(sweep, tables.values, tolerance, self.planning_sweeps))

    def _optimistic(self) -> Array:
        return jnp.asarray(self.optimistic_value, jnp.float32)


def _sum(terms: list[Array]) -> Array:
    """The sum, term by term: in one order under every mapping."""
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total
