"""Linear models and values of states, learned by gradients and planned with by prioritized sweeping.

Notation of Sutton, Szepesvari, Geramifard and Bowling (2008): phi are the n features of a state,
``theta^T phi`` is its value, ``F_a phi`` what features follow action a, ``b_a^T phi`` what it earns. F_a
holds the discount g too: it predicts ``g phi'``.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.numerics import expectation, put_row, put_rows, take, take_row
from hrljax.core.random import WordBlock
from hrljax.learners.base import Context
from hrljax.learners.features import Active, Features

_ROUNDING = 1e-6
"""Weights whose sum is no more, relative to the sum of their sizes, are taken to sum to 0."""


class LinearTables(NamedTuple):
    """What was learned: n features, A actions."""

    theta: Array  # [n] float32
    follows: Array  # [n * n * A] float32: F_a[k, j] at ``(j * n + k) * A + a``
    earned: Array  # [n * A] float32: b_a[j] at ``j * A + a``
    priority: Array  # [n] float32: of the features that wait to be swept from; 0 if one does not wait


class Outcome(NamedTuple):
    """What an action, or a subtask, led to."""

    before: Active  # phi
    action: Array  # int32: a
    reward: Array  # float32: r, until phi' was reached
    after: Active  # phi'
    discount: Array  # float32: g of the steps until then, 0 if the episode terminated


class LinearModel(NamedTuple):
    """How many features and actions there are, and which actions a feature allows."""

    features: Features
    num_actions: int
    allowed: np.ndarray  # [n * A] bool: the action can be taken in some state that has the feature

    @staticmethod
    def of(features: Features, num_actions: int) -> "LinearModel":
        """One in which every action can be taken everywhere."""
        return LinearModel(features, num_actions, np.ones(features.size * num_actions, np.bool_))

    @property
    def size(self) -> int:
        return self.features.size

    def empty(self, value: Array) -> LinearTables:
        """Every state and every action is worth `value`, where the weights of features sum to the most that they do.

        If they sum to 0 in all states, all is worth 0: equal shares of features make nothing else.
        """
        sums = self.features.weight.sum(1)
        most = sums[np.abs(sums).argmax()]
        cancels = np.abs(most) <= _ROUNDING * np.abs(self.features.weight).sum(1).max()
        share = jnp.zeros_like(value) if cancels else value / most
        n, actions = self.size, self.num_actions
        zeros = jnp.zeros(n, jnp.float32)
        return LinearTables(
            jnp.full(n, share), jnp.zeros(n * n * actions, jnp.float32), jnp.full(n * actions, share), zeros
        )

    # What is predicted.

    def backed_up(self, tables: LinearTables, feature: Array, context: Context) -> Array:
        """``b_a[j] + theta^T F_a e_j`` of a feature j for every action: ``[A]``."""
        actions = self.num_actions

        def add(k: Array, total: Array) -> Array:
            share = take_row(tables.follows, (feature * self.size + k) * actions, actions)
            return total + context.product(take(tables.theta, k), share)

        return lax.fori_loop(0, self.size, add, take_row(tables.earned, feature * actions, actions))

    def value(self, tables: LinearTables, active: Active, context: Context) -> Array:
        """``theta^T phi``."""
        return expectation(active.weights, [take(tables.theta, j) for j in active.numbers], context.zero)

    def action_values(self, tables: LinearTables, active: Active, context: Context) -> list[Array]:
        """``b_a^T phi + theta^T F_a phi`` of every action, scalars."""
        parts = [self.backed_up(tables, j, context) for j in active.numbers]
        weights = [jnp.broadcast_to(weight, (self.num_actions,)) for weight in active.weights]
        row = expectation(weights, parts, context.zero)
        return [row[a] for a in range(self.num_actions)]

    # What is learned.

    def learned(
        self, tables: LinearTables, seen: Outcome, step_size: Array, model_step_size: Array, context: Context
    ) -> LinearTables:
        """The tables after an outcome was seen, values (by alpha) first, then the model (by beta).

        Where `context` does not learn, nothing changes.
        """
        target = seen.reward + context.product(seen.discount, self.value(tables, seen.after, context))
        tables = self._corrected(tables, seen.before, target, step_size, context)
        return self._observed(tables, seen, model_step_size, context)

    def _corrected(
        self, tables: LinearTables, before: Active, target: Array, step_size: Array, context: Context
    ) -> LinearTables:
        """``theta += alpha delta phi`` for ``delta = target - theta^T phi``; features wait with ``|delta phi_j|``."""
        delta = target - self.value(tables, before, context)
        delta = lax.select(jnp.asarray(context.learns), delta, jnp.zeros_like(delta))
        change = context.product(step_size, delta)
        theta = [take(tables.theta, j) + context.product(w, change) for j, w in zip(*before, strict=True)]
        waits = [
            lax.max(take(tables.priority, j), jnp.abs(context.product(w, delta))) for j, w in zip(*before, strict=True)
        ]
        return tables._replace(
            theta=put_rows(tables.theta, before.numbers, [value[None] for value in theta]),
            priority=put_rows(tables.priority, before.numbers, [value[None] for value in waits]),
        )

    def _observed(self, tables: LinearTables, seen: Outcome, step_size: Array, context: Context) -> LinearTables:
        """``F_a += beta (g phi' - F_a phi) phi^T`` and ``b_a += beta (r - b_a^T phi) phi``."""
        before, action, reward, after, discount = seen
        n, actions = self.size, self.num_actions
        width = n * actions
        columns = [take_row(tables.follows, j * width, width) for j in before.numbers]
        earned = [take_row(tables.earned, j * actions, actions) for j in before.numbers]
        is_taken = (jnp.arange(actions) == action) & context.learns
        weights = [context.product(discount, weight) for weight in after.weights]
        feature = jnp.arange(width, dtype=jnp.int32) // np.int32(actions)
        target = jnp.zeros(width, jnp.float32)
        for index, weight in zip(after.numbers, weights, strict=True):
            target = lax.select(feature == index, jnp.broadcast_to(weight, (width,)), target)
        errors = (
            target - expectation([jnp.broadcast_to(w, (width,)) for w in before.weights], columns, context.zero),
            reward - expectation([jnp.broadcast_to(w, (actions,)) for w in before.weights], earned, context.zero),
        )
        taken = jnp.tile(is_taken, n), is_taken
        steps = [lax.select(mask, error, jnp.zeros_like(error)) for mask, error in zip(taken, errors, strict=True)]
        sizes = [context.product(step_size, weight) for weight in before.weights]
        columns = [old + context.product(size, steps[0]) for old, size in zip(columns, sizes, strict=True)]
        earned = [old + context.product(size, steps[1]) for old, size in zip(earned, sizes, strict=True)]
        return tables._replace(
            follows=put_rows(tables.follows, [j * width for j in before.numbers], columns),
            earned=put_rows(tables.earned, [j * actions for j in before.numbers], earned),
        )

    # What is planned.

    def swept(self, tables: LinearTables, times: int, step_size: Array, context: Context) -> LinearTables:
        """MG prioritized sweeping (Algorithm 4), in so many turns.

        A turn is::

            i <- the feature that waits with the greatest priority; it waits no more
            for all j such that F_a[i, j] != 0 for some a:
                delta <- max_a (b_a[j] + theta^T F_a e_j) - theta[j]
                theta[j] <- theta[j] + alpha delta
                j waits with priority |delta|, if not with a greater one
        """
        learns = jnp.asarray(context.learns)

        def pop(_: Array, tables: LinearTables) -> LinearTables:
            popped = jnp.argmax(tables.priority).astype(jnp.int32)
            waits = learns & (take(tables.priority, popped) > 0)
            left = lax.select(waits, jnp.float32(0), take(tables.priority, popped))
            tables = tables._replace(priority=put_row(tables.priority, popped, left[None]))
            return lax.fori_loop(0, self.size, lambda j, tables: back_up(j, popped, waits, tables), tables)

        def back_up(j: Array, popped: Array, waits: Array, tables: LinearTables) -> LinearTables:
            place = (j * self.size + popped) * self.num_actions
            leads_there = (take_row(tables.follows, place, self.num_actions) != 0).any()
            return self._renewed(tables, j, leads_there & waits, step_size, context)

        return lax.fori_loop(0, times, pop, tables)

    def replayed(
        self, tables: LinearTables, drawn: WordBlock, times: int, step_size: Array, context: Context
    ) -> LinearTables:
        """Backs up features drawn uniformly, one after the other; one word each (Algorithm 1)."""

        def one(i: Array, tables: LinearTables) -> LinearTables:
            j = (drawn[i][0] % np.uint32(self.size)).astype(jnp.int32)
            return self._renewed(tables, j, jnp.asarray(context.learns), step_size, context)

        return lax.fori_loop(0, times, one, tables)

    def _renewed(
        self, tables: LinearTables, feature: Array, is_due: Array, step_size: Array, context: Context
    ) -> LinearTables:
        """The tables after ``theta[j]`` was backed up from the model, if it is due."""
        theta, priority = take(tables.theta, feature), take(tables.priority, feature)

        def renewed() -> tuple[Array, Array]:
            row = self.backed_up(tables, feature, context)
            allowed = take_row(jnp.asarray(self.allowed), feature * self.num_actions, self.num_actions)
            row = lax.select(allowed, row, jnp.full_like(row, -np.inf))
            best = choices.greedy([row[a] for a in range(self.num_actions)])[1]
            delta = lax.select(allowed.any(), best - theta, jnp.float32(0))
            return theta + context.product(step_size, delta), lax.max(priority, jnp.abs(delta))

        new, waits = lax.cond(is_due, renewed, lambda: (theta, priority))
        return tables._replace(
            theta=put_row(tables.theta, feature, new[None]), priority=put_row(tables.priority, feature, waits[None])
        )

    def all_action_values(self, tables: LinearTables, context: Context) -> Array:
        """``[S, A]``: `action_values` of every state."""

        def of_state(state: Array) -> Array:
            return jnp.stack(self.action_values(tables, self.features.of(state), context))

        return jax.vmap(of_state)(jnp.arange(self.features.num_states, dtype=jnp.int32))
