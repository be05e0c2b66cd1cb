"""A factored model of an environment: what each variable, the reward and the end of an episode become of a step.

Each is predicted by classification trees of its own over the variables and the action. What variables become is taken
to be independent of each other, given state and action (a dynamic Bayesian network without arcs between its results).
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal, NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product, put_row, stage, take, take_row
from hrljax.envs.factored import FactoredStates
from hrljax.learners.base import Transition
from hrljax.trees.classification import ClassificationTrees, Forest, Score
from hrljax.trees.scores import gather, share_of

Effects: TypeAlias = Literal["relative", "absolute"]
_MOST_VALUES = 4
"""What a variable can become of one step, at most: the likeliest are kept."""


class Distinct(NamedTuple):
    """The different numbers seen, at most N."""

    values: Array  # [N] float32, in the order in which they were first seen
    number: Array  # int32: how many there are

    @staticmethod
    def of(size: int, *first: float) -> "Distinct":
        """Places for so many numbers, of which the first are known."""
        values = np.zeros(size, np.float32)
        values[: len(first)] = first
        return Distinct(jnp.asarray(values), jnp.int32(len(first)))

    def having(self, number: Array) -> "tuple[Array, Distinct]":
        """The place of a number, and the numbers with it; beyond the first N it counts as the nearest of them."""
        size = len(self.values)
        places = np.arange(size, dtype=np.int32)
        off = jnp.where(places < self.number, jnp.abs(self.values - number), np.float32(np.inf))
        is_new = (off.min() > 0) & (self.number < np.int32(size))
        place = lax.select(is_new, self.number, jnp.where(off == off.min(), places, np.int32(2**30)).min())
        value = lax.select(is_new, number, take(self.values, place))
        return place, Distinct(put_row(self.values, place, value[None]), self.number + is_new.astype(jnp.int32))


class Numbers(NamedTuple):
    """What classes of trees stand for."""

    rewards: Distinct
    weights: Distinct  # of what follows: first 1 where the episode went on and 0 where it ended


class Outcomes(NamedTuple):
    """What the model predicts of P = S * A pairs ``state * A + action``: M next states each, with their weights."""

    reward: Array  # [P] float32: mean
    follows: Array  # [P] float32: mean weight of what follows (the probability that the episode goes on, where steps
    # are not discounted), divided by the sum of the weights of next states
    next_state: Array  # [M * P] int32
    weight: Array  # [M * P] float32
    most: Array  # int32: of how many next states any pair has


@dataclass(frozen=True, eq=False)
class FactoredModel:
    """Which trees there are, and what their classes mean. V trees of variables, one of rewards, one of ends.

    Attributes:
        states: the values of V variables in every state.
        num_actions: A.
        effects: whether a tree of a variable predicts its ``"relative"`` change, or its ``"absolute"`` next value.
        num_rewards: R, different rewards that are told apart.
        num_outcomes: M, next states of a pair that are kept.
        num_weights: different weights of what follows that are told apart, at least 2.
        allowed: ``[P]`` bool: pairs whose action can be taken, all if None.
        score, max_nodes, num_trees: as of `ClassificationTrees`.
    """

    states: FactoredStates
    num_actions: int
    effects: Effects
    num_rewards: int
    num_outcomes: int
    score: Score
    max_nodes: int
    num_trees: int
    num_weights: int = 2
    allowed: np.ndarray | None = None

    @property
    def num_variables(self) -> int:
        return len(self.states.sizes)

    @property
    def num_pairs(self) -> int:
        return len(self.states.values) * self.num_actions

    @cached_property
    def trees(self) -> ClassificationTrees:
        sizes = self.states.sizes
        of_variables = tuple(2 * size - 1 if self.effects == "relative" else size for size in sizes)
        return ClassificationTrees(
            sizes=(*sizes, self.num_actions),
            ordered=(*(size > 2 for size in sizes), False),
            num_classes=(*of_variables, self.num_rewards, self.num_weights),
            score=self.score,
            max_nodes=self.max_nodes,
            num_trees=self.num_trees,
        )

    @cached_property
    def cells(self) -> np.ndarray:
        """``[P * F]`` int32: the inputs of every pair, as of `ClassificationTrees.cells`."""
        values = np.repeat(self.states.values, self.num_actions, 0)
        actions = np.tile(np.arange(self.num_actions), len(self.states.values))
        return self.trees.cells(np.concatenate([values, actions[:, None]], 1))

    def no_counts(self) -> Array:
        """``[P * W + C]`` int32: counts of no steps, as of `hrljax.trees.classification.Data`."""
        return jnp.zeros(self.num_pairs * self.trees.width + self.trees.most_classes, jnp.int32)

    def row(self, counts: Array, pair: Array) -> Array:
        """``[W]`` int32: the counts of a pair.

        Read but once, whatever is made of it: a second read could not be told to come before the row is written, and
        the compiler would copy all counts for it in every step.
        """
        width = self.trees.width
        return stage(partial(take_row, length=width))(counts, pair * np.int32(width))

    def rows(self, counts: Array) -> Array:
        """``[P, W]`` int32: the counts of all pairs."""
        width = self.trees.width
        return counts[: self.num_pairs * width].reshape(-1, width)

    def times_taken(self, rows: Array) -> Array:
        """How often the actions of pairs with these counts (``[..., W]``) were taken, ``[...]`` int32.

        Each time the episode ended or went on.
        """
        first = self.trees.first_class[-1]
        return rows[..., first : first + self.num_weights].sum(-1, dtype=jnp.int32)

    def no_numbers(self) -> Numbers:
        return Numbers(Distinct.of(self.num_rewards), Distinct.of(self.num_weights, 1.0, 0.0))

    def classes(self, transition: Transition, weight: Array, numbers: Numbers) -> tuple[list[Array], Numbers]:
        """The class of each kind of tree (int32) that a step is one of, and the numbers with those of the step.

        Args:
            transition: the step.
            weight: float32, of what follows: 0 where the episode ended, else 1, or what it is discounted by.
            numbers: those seen before.
        """
        size = self.num_variables
        table = jnp.asarray(self.states.values.ravel())
        before, after = (take_row(table, s * np.int32(size), size) for s in (transition.state, transition.next_state))
        is_relative = self.effects == "relative"
        of_variables = [
            after[v] - before[v] + np.int32(n - 1) if is_relative else after[v] for v, n in enumerate(self.states.sizes)
        ]
        reward, rewards = numbers.rewards.having(transition.reward)
        end, weights = numbers.weights.having(weight)
        return [*of_variables, reward, end], Numbers(rewards, weights)

    def row_after(self, row: Array, classes: list[Array], terminated: Array) -> Array:
        """The counts of a pair with one more step. Of a step that ends the episode no next state is learned."""
        places = np.arange(self.trees.width, dtype=np.int32)
        for kind, (first, which) in enumerate(zip(self.trees.first_class, classes, strict=True)):
            is_of_step = places == which + np.int32(first)
            row = row + (is_of_step & ~terminated if kind < self.num_variables else is_of_step).astype(jnp.int32)
        return row

    def with_row(self, counts: Array, pair: Array, row: Array) -> Array:
        """The counts with those of a pair replaced."""
        return put_row(counts, pair * np.int32(self.trees.width), row)

    def least_probability(
        self, forest: Forest, pair: Array, classes: list[Array], terminated: Array, zero: Array
    ) -> Array:
        """The probability (float32) that trees gave to what happened: of the kind that gave it the least."""
        inputs = len(self.trees.sizes)
        cells = take_row(jnp.asarray(self.cells), pair * np.int32(inputs), inputs)[None]
        size, of_step = self.trees.most_classes, jnp.stack(classes)

        def of_kind(kind: Array, least: Array) -> Array:
            def of_tree(number: Array, total: Array) -> Array:
                leaf = self.trees.leaves(forest, self.trees.tree(kind, number), cells)[0]
                row = take_row(forest.counts, leaf * np.int32(size), size)
                return total + share_of(take(row, take(of_step, kind)), row.sum(dtype=jnp.int32), zero)

            total = lax.fori_loop(jnp.int32(0), jnp.int32(self.num_trees), of_tree, jnp.float32(0))
            plays_no_part = terminated & (kind < np.int32(self.num_variables))
            return lax.select(plays_no_part, least, lax.min(least, total * np.float32(1 / self.num_trees)))

        return lax.fori_loop(jnp.int32(0), jnp.int32(len(classes)), of_kind, jnp.float32(1))

    def predicted(self, forest: Forest, numbers: Numbers, zero: Array) -> Outcomes:
        """The outcomes of all pairs."""
        probabilities = self._probabilities(forest, zero)
        *of_variables, of_rewards, of_ends = probabilities

        def mean(known: Distinct, of_classes: Array) -> Array:
            total = jnp.zeros(self.num_pairs, jnp.float32)
            for which in range(len(known.values)):
                total = total + exact_product(known.values[which], of_classes[which], zero)
            return total

        next_state, weight, total, most = self._combined(of_variables, zero)
        follows = mean(numbers.weights, of_ends) / lax.max(total, np.float32(1e-6))
        return Outcomes(mean(numbers.rewards, of_rewards), follows, next_state, weight, most)

    def _probabilities(self, forest: Forest, zero: Array) -> list[Array]:
        """For each kind of tree, ``[classes, P]`` float32: the mean of its trees."""
        trees, shares, pairs = self.trees, self.trees.shares(forest, zero), np.int32(self.num_pairs)
        cells = jnp.asarray(self.cells).reshape(self.num_pairs, -1)
        count = trees.num_kinds * trees.num_trees

        def of_tree(tree: Array, leaves: Array) -> Array:
            return put_row(leaves, tree * pairs, trees.leaves(forest, tree, cells))

        leaves = lax.fori_loop(jnp.int32(0), jnp.int32(count), of_tree, jnp.zeros(count * self.num_pairs, jnp.int32))
        leaves = leaves.reshape(count, -1) * np.int32(trees.most_classes)

        def of_kind(kind: int) -> Array:
            classes = np.arange(trees.num_classes[kind], dtype=np.int32)[:, None]
            total = jnp.zeros((len(classes), self.num_pairs), jnp.float32)
            for number in range(trees.num_trees):
                total = total + gather(shares, leaves[trees.tree(kind, number)][None] + classes)
            return total * np.float32(1 / trees.num_trees)

        return [of_kind(kind) for kind in range(trees.num_kinds)]

    def _combined(self, probabilities: list[Array], zero: Array) -> tuple[Array, Array, Array, Array]:
        """Next states and weights ``[M * P]``, the sum of the weights ``[P]``, and the most that any pair has.

        The values of the first variable change fastest, each variable's likeliest first.
        """
        pairs, most = self.num_pairs, self.num_outcomes
        variables, count = [], jnp.ones(pairs, jnp.int32)
        for v, size in enumerate(self.states.sizes):
            chances, classes, number = _likeliest(probabilities[v])
            now = np.repeat(self.states.values[:, v], self.num_actions)
            if self.effects == "relative":
                classes = [jnp.clip(now + which - np.int32(size - 1), 0, size - 1) for which in classes]
            variables.append((chances, classes, number))
            count = lax.min(count * number, np.int32(most))
        stays = np.repeat(np.arange(len(self.states.values), dtype=np.int32), self.num_actions)
        numbers = jnp.asarray(self.states.number)

        def one(m: Array, carry: tuple[list[Array], Array, Array, Array]) -> tuple[list[Array], Array, Array, Array]:
            digits, next_state, weight, total = carry
            values, chance = [], jnp.ones(pairs, jnp.float32)
            for digit, (chances, classes, _) in zip(digits, variables, strict=True):
                of_digit, value = chances[0], classes[0]
                for i in range(1, len(chances)):
                    of_digit = jnp.where(digit == i, chances[i], of_digit)
                    value = jnp.where(digit == i, classes[i], value)
                values.append(value)
                chance = exact_product(chance, of_digit, zero)
            chance = jnp.where(m < count, chance, np.float32(0))
            state = gather(numbers, self.states.place(values))
            next_state = put_row(next_state, m * np.int32(pairs), jnp.where(state < 0, stays, state))
            weight = put_row(weight, m * np.int32(pairs), chance)
            new, goes_on = [], jnp.ones(pairs, jnp.bool_)
            for digit, (_, _, number) in zip(digits, variables, strict=True):
                more = digit + goes_on.astype(jnp.int32)
                goes_on = more == number
                new.append(jnp.where(goes_on, np.int32(0), more))
            return new, next_state, weight, total + chance

        begin = (
            [jnp.zeros(pairs, jnp.int32)] * self.num_variables,
            jnp.zeros(most * pairs, jnp.int32),
            jnp.zeros(most * pairs, jnp.float32),
            jnp.zeros(pairs, jnp.float32),
        )
        _, next_state, weight, total = lax.fori_loop(jnp.int32(0), count.max(), one, begin)
        return next_state, weight, total, count.max()


def backed_up(outcomes: Outcomes, values: Array, discount: Array | np.float32, zero: Array) -> Array:
    """``Q(s, a) = r(s, a) + discount * P(goes on) * sum_m P(s'_m) V(s'_m)``, ``[P]``, of state values ``[S]``."""
    pairs = len(outcomes.reward)

    def add(m: Array, total: Array) -> Array:
        first = m * np.int32(pairs)
        after = gather(values, take_row(outcomes.next_state, first, pairs))
        return total + exact_product(take_row(outcomes.weight, first, pairs), after, zero)

    after = lax.fori_loop(jnp.int32(0), outcomes.most, add, jnp.zeros(pairs, jnp.float32))
    after = exact_product(outcomes.follows, after, zero)
    # A discount that is known to be 1 must be no factor: then the compiler sees two products with nothing in between.
    return outcomes.reward + exact_product(discount, after, zero)


def _likeliest(probabilities: Array) -> tuple[list[Array], list[Array], Array]:
    """Of ``[classes, P]`` the greatest, their classes, and how many (int32, at least 1) are not 0; ``[P]`` each."""
    numbers = np.arange(len(probabilities), dtype=np.int32)[:, None]
    chances, classes, count = [], [], jnp.zeros(probabilities.shape[1], jnp.int32)
    for _ in range(min(_MOST_VALUES, len(numbers))):
        best = probabilities.max(0)
        which = jnp.where(probabilities == best[None], numbers, np.int32(len(numbers))).min(0)
        chances.append(best)
        classes.append(which)
        count = count + (best > 0).astype(jnp.int32)
        probabilities = jnp.where(numbers == which[None], np.float32(0), probabilities)
    return chances, classes, lax.max(count, jnp.int32(1))
