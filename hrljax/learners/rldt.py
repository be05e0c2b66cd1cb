"""RL-DT and SPITI: decision trees that learn a factored model, planned on by value iteration."""

from dataclasses import dataclass

import jax.numpy as jnp
from jax import Array

from hrljax.core.choices import Ties
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.effects import Effects, FactoredModel
from hrljax.learners.flat import EpsilonGreedyLearner
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.tree_planner import TreePlanner, TreeTables
from hrljax.trees.classification import Chance, Score


@dataclass(frozen=True)
class RLDT(TreePlanner, EpsilonGreedyLearner[FactoredModel]):
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
    left_out: Hyperparameter = hyperparameter(0.2, 0, 1)
    num_trees: int = 1
    ties: Ties = "first"

    name = "RL-DT"
    has_loops = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("num_trees", 1, 100)

    @property
    def num_words(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride] (depends on a field)
        return 1 if self.num_trees == 1 else 3

    def prepare(self, env: AnyTabularEnvironment) -> FactoredModel:
        return self.model_of(env.factored(), env.num_actions, self.num_trees)

    def init(self, env: AnyTabularEnvironment, prepared: FactoredModel) -> LearnerState:
        return LearnerState(self.nothing_learned(prepared), jnp.int32(0))

    def begin(self, prepared: FactoredModel, tables: TreeTables, first: Array, words: Words, context: Context) -> Array:
        return self.choose(self.worth(prepared, tables, first), words[0], context)

    def learn(
        self, prepared: FactoredModel, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        weight = (~transition.terminated).astype(jnp.float32)
        discount = at_episode(self.discount, context.episode)
        chance = None
        if self.num_trees > 1:
            chance = Chance((words[1], words[2]), jnp.asarray(self.left_out, jnp.float32))
        tables = self.learned(prepared, state.tables, transition, weight, discount, chance, context)
        action = self.choose(self.worth(prepared, tables, transition.next_state), words[0], context)
        return LearnerState(tables, action)


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
