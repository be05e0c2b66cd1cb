"""RL-DT and SPITI: decision trees that learn a factored model, planned on by value iteration."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.choices import Ties
from hrljax.core.flags import choose
from hrljax.core.lockstep import once_if
from hrljax.core.numerics import put_row, take
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.effects import Effects, FactoredModel, Rewards, backed_up
from hrljax.learners.flat import EpsilonGreedyLearner, row_of
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.planning import settled
from hrljax.trees.classification import Chance, Data, Forest, Score


class RLDTTables(NamedTuple):
    """What RL-DT has learned, of P = S * A pairs ``state * A + action``."""

    values: Array  # [P] float32: action values of the model
    exploring: Array  # [P] float32: the same, where unknown pairs are worth `optimistic_value`
    is_fresh: Array  # bool: whether `exploring` is of the latest model
    counts: Array  # [P * W + C] int32: what happened how often, see `hrljax.learners.effects`
    visited: Array  # [P] int32: pairs in the order of their first visits
    num_visited: Array  # int32
    rewards: Rewards
    forest: Forest
    surprised: Array  # bool: since the last fit something happened that trees held to be unlikely
    waited: Array  # int32: steps since the last fit


@dataclass(frozen=True)
class RLDT(EpsilonGreedyLearner[FactoredModel]):
    """RL-DT (Hester and Stone 2009): decision trees that generalise the relative effects of actions.

    A tree for each variable of the state (`hrljax.TabularEnvironment.variables`), one for the reward and one for the
    end of an episode predict what a step does, from the variables and the action. Their results are taken to be
    independent of each other. When a step was a surprise, all trees are grown anew and value iteration solves what
    they predict::

        Q(s, a) = r(s, a) + discount * P(goes on | s, a) * sum_s' prod_v P(s'_v | s, a) max_b Q(s', b)

    In a state where the model promises less than `satisfying_value`, it explores: there it follows the same values with
    `optimistic_value` for pairs that are not known yet.

    Attributes:
        epsilon: probability of a uniformly random action, or a schedule of the episode; RL-DT itself explores until
            it is satisfied. Else it takes the best one.
        discount: in [0, 1].
        optimistic_value: at least what any policy can earn: of pairs that are not known, where it explores. No value of
            the model is greater, though trees may believe in a reward that comes again and again.
        satisfying_value: it explores where the model promises less (in the paper: as long as the rewards in reach are
            less than 40 % of the greatest). Of a model of which no end is known it is `least_value`.
        least_value: no value of the model is less, and all are so at first.
        least_score: of a test in a tree, at least 0: its gain ratio, or its chi-squared.
        refit_below: the model is made anew when a tree gave less than this probability to what happened.
        left_out: probability that a node of a forest does not look at an input.
        planning_tolerance: at least 0; value iteration stops when a sweep changes nothing by more.
        effects: whether trees predict the ``"relative"`` change of a variable, or its ``"absolute"`` next value.
        score: of a test, ``"gain_ratio"`` (C4.5) or ``"chi_squared"``.
        num_trees: of each kind, at least 1; their predictions are averaged. With more than one every node leaves out
            inputs by chance, as in TEXPLORE (Hester and Stone 2013).
        explores: whether it explores where it is not satisfied. If not, by `epsilon` alone.
        known_after: visits after which a pair is known, at least 1.
        refit_interval: steps between two fits, at least 1.
        planning_sweeps: most sweeps of one value iteration, at least 1. It begins where the last one ended.
        max_nodes: of a tree, at least 1.
        max_outcomes: next states of a pair that are planned with, at least 1. The combinations of values that the
            variables can get are used in their order, of each variable the four likeliest.
        max_rewards: different rewards that are told apart, at least 1. Others count as the nearest of them.
        ties: as of `QLearning`.
    """

    epsilon: Hyperparameter = hyperparameter(0.0, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    optimistic_value: Hyperparameter = hyperparameter(0.0)
    satisfying_value: Hyperparameter = hyperparameter(-100.0)
    least_value: Hyperparameter = hyperparameter(-200.0)
    least_score: Hyperparameter = hyperparameter(1e-4, 0)
    refit_below: Hyperparameter = hyperparameter(0.75, 0, 1)
    left_out: Hyperparameter = hyperparameter(0.2, 0, 1)
    planning_tolerance: Hyperparameter = hyperparameter(0.01, 0)
    effects: Effects = "relative"
    score: Score = "gain_ratio"
    num_trees: int = 1
    explores: bool = True
    known_after: int = 1
    refit_interval: int = 1
    planning_sweeps: int = 200
    max_nodes: int = 255
    max_outcomes: int = 16
    max_rewards: int = 8
    ties: Ties = "first"

    name = "RL-DT"
    has_loops = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_choice("effects", Effects)
        self._check_choice("score", Score)
        self._check_flag("explores")
        self._check_integer("num_trees", 1, 100)
        for option in ("known_after", "refit_interval", "planning_sweeps", "max_outcomes", "max_rewards"):
            self._check_integer(option, 1)
        self._check_integer("max_nodes", 1, 2**15)

    @property
    def num_words(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride] (depends on a field)
        return 1 if self.num_trees == 1 else 3

    def prepare(self, env: AnyTabularEnvironment) -> FactoredModel:
        return FactoredModel(
            env.factored(),
            env.num_actions,
            self.effects,
            self.max_rewards,
            self.max_outcomes,
            self.score,
            self.max_nodes,
            self.num_trees,
        )

    def init(self, env: AnyTabularEnvironment, prepared: FactoredModel) -> LearnerState:
        pairs = prepared.num_pairs
        tables = RLDTTables(
            values=jnp.full(pairs, jnp.asarray(self.least_value, jnp.float32)),
            exploring=jnp.full(pairs, jnp.asarray(self.optimistic_value, jnp.float32)),
            is_fresh=jnp.bool_(True),
            counts=prepared.no_counts(),
            visited=jnp.zeros(pairs, jnp.int32),
            num_visited=jnp.int32(0),
            rewards=Rewards(jnp.zeros(self.max_rewards, jnp.float32), jnp.int32(0)),
            forest=prepared.trees.empty(),
            surprised=jnp.bool_(False),
            waited=jnp.int32(0),
        )
        return LearnerState(tables, jnp.int32(0))

    def begin(self, prepared: FactoredModel, tables: RLDTTables, first: Array, words: Words, context: Context) -> Array:
        return self._chosen(prepared, tables, first, words[0], context)

    def learn(
        self, prepared: FactoredModel, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        model, tables, learns = prepared, state.tables, context.learns
        pair = transition.state * np.int32(model.num_actions) + transition.action
        seen = model.seen_before(tables.counts, pair)
        classes, rewards = model.classes(transition, tables.rewards)
        probability = model.least_probability(tables.forest, pair, classes, transition.terminated, context.zero)
        is_new = learns & (seen == 0)
        after = (
            tables.is_fresh & (seen + 1 != self.known_after),
            tables.surprised | (probability < jnp.asarray(self.refit_below, jnp.float32)),
            tables.waited + 1,
            rewards,
        )
        before = (tables.is_fresh, tables.surprised, tables.waited, tables.rewards)
        is_fresh, surprised, waited, rewards = choose(learns, after, before)
        entry = lax.select(is_new, pair, take(tables.visited, tables.num_visited))
        tables = tables._replace(
            is_fresh=is_fresh,
            surprised=surprised,
            waited=waited,
            rewards=rewards,
            visited=put_row(tables.visited, tables.num_visited, entry[None]),
            num_visited=tables.num_visited + is_new.astype(jnp.int32),
        )
        explores_on_old = self._is_exploring(model, tables, transition.next_state) & ~tables.is_fresh
        needs = (tables.surprised | explores_on_old) & (tables.waited >= self.refit_interval)

        def observed(tables: RLDTTables, learns: Array) -> RLDTTables:
            return tables._replace(counts=model.counted(tables.counts, pair, classes, transition.terminated, learns))

        # The counts change where they are planned with: else the compiler would move parts of the planning out of
        # there, to where they run every step.
        tables = once_if(
            learns & needs,
            lambda tables: self._planned(
                model, observed(tables, jnp.bool_(True)), transition.next_state, words[1:], context
            ),
            observed(tables, learns & ~needs),
        )
        return LearnerState(tables, self._chosen(model, tables, transition.next_state, words[0], context))

    def _planned(
        self, model: FactoredModel, tables: RLDTTables, state: Array, words: Words, context: Context
    ) -> RLDTTables:
        """The tables with a new model of all that was seen, and its values."""
        data = Data(jnp.asarray(model.cells), tables.counts, tables.visited, tables.num_visited)
        chance = Chance((words[0], words[1]), jnp.asarray(self.left_out, jnp.float32)) if words else None
        forest = model.trees.fit(data, jnp.asarray(self.least_score, jnp.float32), context.zero, chance)
        outcomes = model.predicted(forest, tables.rewards, context.zero)
        least, optimistic = (jnp.asarray(v, jnp.float32) for v in (self.least_value, self.optimistic_value))
        tolerance = jnp.asarray(self.planning_tolerance, jnp.float32)
        discount = at_episode(self.discount, context.episode)

        def sweep(values: Array) -> Array:
            of_states = values.reshape(-1, model.num_actions).max(-1)
            return lax.clamp(least, backed_up(outcomes, of_states, discount, context.zero), optimistic)

        tables = tables._replace(
            forest=forest,
            values=settled(sweep, tables.values, tolerance, self.planning_sweeps),
            surprised=jnp.bool_(False),
            waited=jnp.int32(0),
        )
        if not self.explores:
            return tables
        is_known = model.seen_before(tables.counts, jnp.arange(model.num_pairs, dtype=jnp.int32)) >= self.known_after
        explores = self._is_exploring(model, tables, state)

        def exploring_sweep(values: Array) -> Array:
            return jnp.where(is_known, sweep(values), optimistic)

        most = lax.select(explores, jnp.int32(self.planning_sweeps), jnp.int32(0))
        return tables._replace(exploring=settled(exploring_sweep, tables.exploring, tolerance, most), is_fresh=explores)

    def _is_exploring(self, model: FactoredModel, tables: RLDTTables, state: Array) -> Array:
        """Whether the model promises too little from a state on."""
        if not self.explores:
            return jnp.bool_(False)
        promised = choices.greedy(row_of(tables.values, state, model.num_actions))[1]
        return promised < jnp.asarray(self.satisfying_value, jnp.float32)

    def _chosen(self, model: FactoredModel, tables: RLDTTables, state: Array, word: Array, context: Context) -> Array:
        explores = self._is_exploring(model, tables, state)
        rows = [row_of(values, state, model.num_actions) for values in (tables.exploring, tables.values)]
        return self.choose([lax.select(explores, *of_action) for of_action in zip(*rows, strict=True)], word, context)


@dataclass(frozen=True)
class SPITI(RLDT):
    """SDYNA (Degris, Sigaud and Wuillemin 2006) as its instance SPITI: the mechanism of `RLDT` with other options.

    Trees predict the next value of a variable and test by chi-squared, so that they do not take noise for structure;
    exploration is epsilon-greedy. Every `refit_interval` steps, if something was not certain, all trees are grown anew,
    which gives the trees of an incremental method, and a few sweeps go on from the values that were. SPITI sweeps over
    the leaves of trees, here over states: the same values, at a cost that grows with the states.

    Attributes: as of `RLDT`. As long as trees know of no way to earn more, all actions are equally good, and only
    `ties` that are broken at random find one.
    """

    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    least_score: Hyperparameter = hyperparameter(10.6, 0)
    refit_below: Hyperparameter = hyperparameter(1.0, 0, 1)
    effects: Effects = "absolute"
    score: Score = "chi_squared"
    explores: bool = False
    refit_interval: int = 10
    planning_sweeps: int = 10
    ties: Ties = "random"

    name = "SPITI"
