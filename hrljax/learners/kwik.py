"""R-MAX whose model is learned by KWIK linear regression: what can happen is known, how often is not."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.choices import Ties
from hrljax.core.flags import choose
from hrljax.core.lockstep import once_if
from hrljax.core.numerics import exact_product, put_row, take, take_row
from hrljax.envs.base import AnyTabularEnvironment, numbers_of
from hrljax.envs.outcomes import enumerate_outcomes
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.flat import EpsilonGreedyLearner, row_of
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.planning import settled


@dataclass(frozen=True, eq=False)
class KnownEffects:
    """What can happen: K effects of every action, each of which leads somewhere from each of P = S * A pairs.

    Effects with the same next state and reward from a pair cannot be told apart there: they are a class, numbered by
    the first of them. What a class is made of is one of U vectors of K zeros and ones.
    """

    num_actions: int
    next_state: np.ndarray  # [P, K] int32; S where the episode ends
    reward: np.ndarray  # [P, K] float32
    first: np.ndarray  # [P, K] int32: the first effect of the class of each
    vectors: np.ndarray  # [U, K] float32: effects of a class
    vector: np.ndarray  # [P, K] int32: which vector describes the class of each effect

    @property
    def num_effects(self) -> int:
        return self.first.shape[1]

    @staticmethod
    def of(env: AnyTabularEnvironment) -> "KnownEffects":
        """The effects are the kinds of random words that the environment's default numbers tell apart."""
        _, outcomes, _ = enumerate_outcomes(env, numbers_of(env, None))
        pairs = env.num_states * env.num_actions
        ends = (outcomes.flags.reshape(pairs, -1) & 1) == 1
        after = np.where(ends, env.num_states, outcomes.next_state.reshape(pairs, -1)).astype(np.int32)
        reward = outcomes.reward.reshape(pairs, -1).astype(np.float32)
        is_same = (after[:, :, None] == after[:, None, :]) & (reward[:, :, None] == reward[:, None, :])
        vectors, vector = np.unique(is_same.reshape(-1, after.shape[1]), axis=0, return_inverse=True)
        return KnownEffects(
            env.num_actions,
            after,
            reward,
            is_same.argmax(2).astype(np.int32),
            vectors.astype(np.float32),
            vector.reshape(after.shape).astype(np.int32),
        )


class Regression(NamedTuple):
    """Linear regressions of A actions on K effects, by recursive least squares."""

    inverse: Array  # [A * K * K] float32: ``(I + sum_t x_t x_t^T)^-1``
    weights: Array  # [A * K] float32: the probability of each effect


class KWIKTables(NamedTuple):
    """What `KWIKRMax` has learned."""

    values: Array  # [P] float32: action values of the optimistic model
    regression: Regression


@dataclass(frozen=True)
class KWIKRMax(EpsilonGreedyLearner[KnownEffects]):
    """R-MAX that knows the effects of actions and learns their probabilities by KWIK linear regression.

    Walsh, Szita, Diuk and Littman 2009, Algorithm 1 and its use for stochastic STRIPS. The probability that one of a
    class of effects happens, with the same next state and reward, is ``x^T w``: x has a one for each of them, and w are
    the probabilities of the action's effects, the same in all states. Where ``|Q x|`` is below `known_below` that is
    known; elsewhere the learner learns from what it sees, for every class with y = 1 if it happened, else 0::

        Q <- Q - Q x x^T Q / (1 + x^T Q x)        w <- w + (y - x^T w) Q x

    with ``Q = I`` and ``w = 0`` at first. A pair is known if all its classes are; every other pair is worth
    `optimistic_value`. Whenever something was learned, value iteration improves the action values, with probabilities
    that are not negative and sum to one. What is learned in one state so holds in all of them.

    The effects are what the kinds of the environment's random words do (`hrljax.TabularEnvironment.word_cuts`), by its
    default numbers.

    Attributes:
        epsilon: probability of a uniformly random action, or a schedule of the episode; the learner itself explores by
            optimism alone. Else it takes the best one.
        discount: in [0, 1].
        optimistic_value: of unknown pairs. Should be at least what any policy can earn.
        known_below: above 0. After m visits of a class alone its ``|Q x|`` is about ``1 / m``.
        planning_tolerance: at least 0; value iteration stops when a sweep changes nothing by more.
        planning_sweeps: most sweeps of one value iteration, at least 1. It begins where the last one ended.
        ties: as of `QLearning`.
    """

    epsilon: Hyperparameter = hyperparameter(0.0, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    optimistic_value: Hyperparameter = hyperparameter(0.0)
    known_below: Hyperparameter = hyperparameter(0.05, 0, low_open=True)
    planning_tolerance: Hyperparameter = hyperparameter(0.01, 0)
    planning_sweeps: int = 500
    ties: Ties = "first"

    name = "KWIK-R-MAX"
    has_loops = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("planning_sweeps", 1)

    def prepare(self, env: AnyTabularEnvironment) -> KnownEffects:
        return KnownEffects.of(env)

    def init(self, env: AnyTabularEnvironment, prepared: KnownEffects) -> LearnerState:
        actions, effects = prepared.num_actions, prepared.num_effects
        inverse = jnp.asarray(np.tile(np.eye(effects, dtype=np.float32).ravel(), actions))
        regression = Regression(inverse, jnp.zeros(actions * effects, jnp.float32))
        values = jnp.full(len(prepared.first), jnp.asarray(self.optimistic_value, jnp.float32))
        return LearnerState(KWIKTables(values, regression), jnp.int32(0))

    def begin(self, prepared: KnownEffects, tables: KWIKTables, first: Array, words: Words, context: Context) -> Array:
        return self.choose(row_of(tables.values, first, prepared.num_actions), words[0], context)

    def learn(
        self, prepared: KnownEffects, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        pair = transition.state * np.int32(prepared.num_actions) + transition.action
        num_states = np.int32(len(prepared.first) // prepared.num_actions)
        after = lax.select(transition.terminated, jnp.int32(num_states), transition.next_state)
        is_known = self._is_known(prepared, state.tables.regression, transition.action, pair, context.zero)

        def learned(tables: KWIKTables) -> KWIKTables:
            regression = _seen(prepared, tables.regression, pair, after, transition, context.zero)
            return self._planned(prepared, tables._replace(regression=regression), context)

        tables = once_if(context.learns & ~is_known, learned, state.tables)
        action = self.choose(row_of(tables.values, transition.next_state, prepared.num_actions), words[0], context)
        return LearnerState(tables, action)

    def _is_known(
        self, effects: KnownEffects, regression: Regression, action: Array, pair: Array, zero: Array
    ) -> Array:
        """Whether the probabilities of all classes of one pair are known (bool)."""
        known = self._known_vectors(effects, _matrix(effects, regression, action)[None], zero)
        count = effects.num_effects
        which = take_row(jnp.asarray(effects.vector.ravel()), pair * np.int32(count), count)
        return known[0].at[which].get(mode="promise_in_bounds").all()

    def _known_vectors(self, effects: KnownEffects, matrices: Array, zero: Array) -> Array:
        """Of matrices Q (``[N, K, K]``) and each x of U vectors, whether ``|Q x|`` is small enough: bool ``[N, U]``."""
        squared = jnp.zeros((len(matrices), len(effects.vectors)), jnp.float32)
        for i in range(effects.num_effects):
            component = jnp.zeros_like(squared)
            for j in range(effects.num_effects):
                component = component + jnp.where(
                    effects.vectors[None, :, j] > 0, matrices[:, i, j, None], np.float32(0)
                )
            squared = squared + exact_product(component, component, zero)
        threshold = jnp.asarray(self.known_below, jnp.float32)
        return squared < threshold * threshold

    def _planned(self, effects: KnownEffects, tables: KWIKTables, context: Context) -> KWIKTables:
        actions, count = effects.num_actions, effects.num_effects
        matrices = tables.regression.inverse.reshape(actions, count, count)
        known_vectors = self._known_vectors(effects, matrices, context.zero).reshape(-1)
        of_action = np.tile(np.arange(actions, dtype=np.int32), len(effects.first) // actions)[:, None]
        places = of_action * np.int32(len(effects.vectors)) + effects.vector
        is_known = known_vectors.at[places].get(mode="promise_in_bounds").all(1)
        chances = _probabilities(tables.regression.weights.reshape(actions, count), context.zero)
        chance = [jnp.tile(chances[:, k], len(effects.first) // actions) for k in range(count)]
        optimistic, tolerance = (jnp.asarray(v, jnp.float32) for v in (self.optimistic_value, self.planning_tolerance))
        discount = at_episode(self.discount, context.episode)

        def sweep(values: Array) -> Array:
            of_states = jnp.concatenate([values.reshape(-1, actions).max(-1), jnp.zeros(1, jnp.float32)])
            total = jnp.zeros_like(values)
            for k in range(count):
                after = of_states.at[effects.next_state[:, k]].get(mode="promise_in_bounds")
                worth = jnp.asarray(effects.reward[:, k]) + context.product(discount, after)
                total = total + context.product(chance[k], worth)
            return jnp.where(is_known, total, optimistic)

        return tables._replace(values=settled(sweep, tables.values, tolerance, self.planning_sweeps))


def _matrix(effects: KnownEffects, regression: Regression, action: Array) -> Array:
    """Q of an action, ``[K, K]``."""
    size = effects.num_effects**2
    return take_row(regression.inverse, action * np.int32(size), size).reshape(effects.num_effects, -1)


def _seen(
    effects: KnownEffects, regression: Regression, pair: Array, after: Array, transition: Transition, zero: Array
) -> Regression:
    """The regressions after a step to a state (int32; S if the episode ended): a sample for every class of its pair.

    What happened is the class with that next state and the nearest reward.
    """
    count, action = effects.num_effects, transition.action
    first_of, vector_of, next_states, rewards = (
        take_row(jnp.asarray(table.ravel()), pair * np.int32(count), count)
        for table in (effects.first, effects.vector, effects.next_state, effects.reward)
    )
    leads_there = next_states == after
    off = jnp.where(leads_there, jnp.abs(rewards - transition.reward), np.float32(np.inf))
    happened = (leads_there & (off == off.min())).astype(jnp.float32)
    vectors = jnp.asarray(effects.vectors.ravel())
    weights = take_row(regression.weights, action * np.int32(count), count)

    def of_class(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        x = take_row(vectors, take(vector_of, k) * np.int32(count), count)
        new = least_squares_step(*carry, x, take(happened, k), zero)
        return choose(take(first_of, k) == k, new, carry)

    matrix, weights = lax.fori_loop(
        jnp.int32(0), jnp.int32(count), of_class, (_matrix(effects, regression, action), weights)
    )
    return Regression(
        put_row(regression.inverse, action * np.int32(count**2), matrix.reshape(-1)),
        put_row(regression.weights, action * np.int32(count), weights),
    )


def least_squares_step(matrix: Array, weights: Array, x: Array, y: Array, zero: Array) -> tuple[Array, Array]:
    """``Q - Q x x^T Q / (1 + x^T Q x)`` and ``w + (y - x^T w) Q x`` with the new Q (recursive least squares).

    Args:
        matrix: Q, ``[K, K]`` float32, symmetric.
        weights: w, ``[K]`` float32.
        x: ``[K]`` float32.
        y: float32 scalar.
        zero: see `hrljax.core.numerics.opaque_zero`.
    """
    q, along, predicted = jnp.zeros_like(weights), jnp.float32(1), jnp.float32(0)
    for j in range(len(weights)):
        q = q + exact_product(matrix[:, j], x[j], zero)
    for j in range(len(weights)):
        along = along + exact_product(x[j], q[j], zero)
        predicted = predicted + exact_product(x[j], weights[j], zero)
    gain = exact_product(q, np.float32(1) / along, zero)
    weights = weights + exact_product(gain, y - predicted, zero)
    return matrix - exact_product(q[:, None], gain[None], zero), weights


def _probabilities(weights: Array, zero: Array) -> Array:
    """Weights (``[A, K]``) that are not negative and sum to one; all alike where none is positive."""
    positive = lax.max(weights, jnp.float32(0))
    total = positive[:, 0]
    for k in range(1, weights.shape[1]):
        total = total + positive[:, k]
    reciprocal = np.float32(1) / jnp.where(total > 0, total, np.float32(1))
    alike = np.float32(1 / weights.shape[1])
    return jnp.where(total[:, None] > 0, exact_product(positive, reciprocal[:, None], zero), alike)
