"""A factored model that a learner or a root makes by trees of what it sees, and its values by value iteration."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.flags import choose
from hrljax.core.lockstep import once_if
from hrljax.core.numerics import put_row, take
from hrljax.envs.factored import FactoredStates
from hrljax.learners.base import Context, Transition
from hrljax.learners.effects import Effects, FactoredModel, Numbers, backed_up
from hrljax.learners.flat import row_of
from hrljax.learners.hyperparameters import Hyperparameter, Settings, hyperparameter
from hrljax.learners.planning import settled
from hrljax.trees.classification import Chance, Data, Forest, Score


class TreeTables(NamedTuple):
    """What was learned, of P = S * A pairs ``state * A + action``."""

    values: Array  # [P] float32: action values of the model
    exploring: Array  # [P] float32: the same, where unknown pairs are worth `optimistic_value`
    is_fresh: Array  # bool: whether `exploring` is of the latest model
    counts: Array  # [P * W + C] int32: what happened how often, see `hrljax.learners.effects`
    visited: Array  # [P] int32: pairs in the order of their first visits
    num_visited: Array  # int32
    numbers: Numbers
    forest: Forest
    surprised: Array  # bool: since the last fit something happened that trees held to be unlikely
    waited: Array  # int32: steps since the last fit


@dataclass(frozen=True)
class TreePlanner(Settings):
    """How `RLDT` and `RLDTRoot` learn, plan and explore.

    Attributes: see `RLDT`.
    """

    optimistic_value: Hyperparameter = hyperparameter(0.0)
    satisfying_value: Hyperparameter = hyperparameter(-100.0)
    least_value: Hyperparameter = hyperparameter(-200.0)
    least_score: Hyperparameter = hyperparameter(1e-4, 0)
    refit_below: Hyperparameter = hyperparameter(0.75, 0, 1)
    planning_tolerance: Hyperparameter = hyperparameter(0.01, 0)
    effects: Effects = "relative"
    score: Score = "gain_ratio"
    explores: bool = True
    known_after: int = 1
    refit_interval: int = 1
    planning_sweeps: int = 200
    max_nodes: int = 255
    max_outcomes: int = 16
    max_rewards: int = 8

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_choice("effects", Effects)
        self._check_choice("score", Score)
        self._check_flag("explores")
        for option in ("known_after", "refit_interval", "planning_sweeps", "max_outcomes", "max_rewards"):
            self._check_integer(option, 1)
        self._check_integer("max_nodes", 1, 2**15)

    def model_of(
        self,
        states: FactoredStates,
        num_actions: int,
        num_trees: int = 1,
        num_weights: int = 2,
        allowed: np.ndarray | None = None,
    ) -> FactoredModel:
        """The model that is learned; the numbers as of `FactoredModel`."""
        return FactoredModel(
            states,
            num_actions,
            self.effects,
            self.max_rewards,
            self.max_outcomes,
            self.score,
            self.max_nodes,
            num_trees,
            num_weights,
            allowed,
        )

    def nothing_learned(self, model: FactoredModel) -> TreeTables:
        pairs = model.num_pairs
        return TreeTables(
            values=jnp.full(pairs, jnp.asarray(self.least_value, jnp.float32)),
            exploring=jnp.full(pairs, jnp.asarray(self.optimistic_value, jnp.float32)),
            is_fresh=jnp.bool_(True),
            counts=model.no_counts(),
            visited=jnp.zeros(pairs, jnp.int32),
            num_visited=jnp.int32(0),
            numbers=model.no_numbers(),
            forest=model.trees.empty(),
            surprised=jnp.bool_(False),
            waited=jnp.int32(0),
        )

    def learned(
        self,
        model: FactoredModel,
        tables: TreeTables,
        transition: Transition,
        weight: Array,
        discount: Array | np.float32,
        chance: Chance | None,
        context: Context,
    ) -> TreeTables:
        """The tables after a step, with a new plan if that is due; as they were where `context` does not learn.

        Args:
            model: what trees there are.
            tables: those before.
            transition: the step, or all that a subtask did.
            weight: float32, of what follows: see `FactoredModel.classes`.
            discount: float32, of every step of a plan.
            chance: which inputs a node of a tree does not look at.
            context: when that is.
        """
        learns = context.learns
        pair = transition.state * np.int32(model.num_actions) + transition.action
        row = model.row(tables.counts, pair)
        seen = model.times_taken(row)
        classes, numbers = model.classes(transition, weight, tables.numbers)
        probability = model.least_probability(tables.forest, pair, classes, transition.terminated, context.zero)
        is_new = learns & (seen == 0)
        after = (
            tables.is_fresh & (seen + 1 != self.known_after),
            tables.surprised | (probability < jnp.asarray(self.refit_below, jnp.float32)),
            tables.waited + 1,
            numbers,
        )
        before = (tables.is_fresh, tables.surprised, tables.waited, tables.numbers)
        is_fresh, surprised, waited, numbers = choose(learns, after, before)
        entry = lax.select(is_new, pair, take(tables.visited, tables.num_visited))
        tables = tables._replace(
            is_fresh=is_fresh,
            surprised=surprised,
            waited=waited,
            numbers=numbers,
            visited=put_row(tables.visited, tables.num_visited, entry[None]),
            num_visited=tables.num_visited + is_new.astype(jnp.int32),
        )
        explores_on_old = self._is_exploring(model, tables, transition.next_state) & ~tables.is_fresh
        needs = (tables.surprised | explores_on_old) & (tables.waited >= self.refit_interval)

        new_row = model.row_after(row, classes, transition.terminated)

        def with_row(tables: TreeTables, row: Array) -> TreeTables:
            return tables._replace(counts=model.with_row(tables.counts, pair, row))

        # The counts change where they are planned with: else the compiler would move parts of the planning out of
        # there, to where they run every step.
        return once_if(
            learns & needs,
            lambda tables: self._planned(
                model, with_row(tables, new_row), transition.next_state, discount, chance, context
            ),
            with_row(tables, lax.select(learns & ~needs, new_row, row)),
        )

    def _planned(
        self,
        model: FactoredModel,
        tables: TreeTables,
        state: Array,
        discount: Array | np.float32,
        chance: Chance | None,
        context: Context,
    ) -> TreeTables:
        """The tables with a new model of all that was seen, and its values."""
        data = Data(jnp.asarray(model.cells), tables.counts, tables.visited, tables.num_visited)
        forest = model.trees.fit(data, jnp.asarray(self.least_score, jnp.float32), context.zero, chance)
        outcomes = model.predicted(forest, tables.numbers, context.zero)
        least, optimistic = (jnp.asarray(v, jnp.float32) for v in (self.least_value, self.optimistic_value))
        tolerance = jnp.asarray(self.planning_tolerance, jnp.float32)

        def sweep(values: Array) -> Array:
            of_states = values.reshape(-1, model.num_actions).max(-1)
            new = lax.clamp(least, backed_up(outcomes, of_states, discount, context.zero), optimistic)
            return new if model.allowed is None else jnp.where(model.allowed, new, least)

        tables = tables._replace(
            forest=forest,
            values=settled(sweep, tables.values, tolerance, self.planning_sweeps),
            surprised=jnp.bool_(False),
            waited=jnp.int32(0),
        )
        if not self.explores:
            return tables
        is_known = model.times_taken(model.rows(tables.counts)) >= self.known_after
        if model.allowed is not None:
            is_known = is_known | ~model.allowed
        explores = self._is_exploring(model, tables, state)

        def exploring_sweep(values: Array) -> Array:
            return jnp.where(is_known, sweep(values), optimistic)

        most = lax.select(explores, jnp.int32(self.planning_sweeps), jnp.int32(0))
        return tables._replace(exploring=settled(exploring_sweep, tables.exploring, tolerance, most), is_fresh=explores)

    def _is_exploring(self, model: FactoredModel, tables: TreeTables, state: Array) -> Array:
        """Whether the model promises too little from a state on."""
        if not self.explores:
            return jnp.bool_(False)
        promised = choices.greedy(row_of(tables.values, state, model.num_actions))[1]
        return promised < jnp.asarray(self.satisfying_value, jnp.float32)

    def worth(self, model: FactoredModel, tables: TreeTables, state: Array) -> list[Array]:
        """What to choose by in a state: the values of its actions, or those for exploring."""
        explores = self._is_exploring(model, tables, state)
        rows = [row_of(values, state, model.num_actions) for values in (tables.exploring, tables.values)]
        return [lax.select(explores, *of_action) for of_action in zip(*rows, strict=True)]
