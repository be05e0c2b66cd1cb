"""A learner of which more is measured than it reports by itself: discounted returns, rewards per step."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import chex
import jax.numpy as jnp
from jax import Array

from hrljax.core import checks
from hrljax.core.environment import Words
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.learners.base import AnyLearner, Context, Learner, LearnerState, Reported, Transition
from hrljax.learners.hyperparameters import at_episode

Measure: TypeAlias = Literal["discounted_return", "average_reward"]


class Weighted(NamedTuple):
    """What a measured learner is doing."""

    control: Any  # what the learner itself is doing
    weight: Array  # float32: discount of the steps since the episode began


class Measured(Learner[Any, Any, Weighted]):
    """Learns as another learner does, with the same words and the same bits, and reports measures of every step.

    With the learner's discount g, rewards R_1, R_2, ... of an episode, and T steps of the N episodes of a bin:

        discounted_return = mean over episodes of  R_1 + g R_2 + g^2 R_3 + ...
        average_reward    = (sum of all rewards) / T

    (Sutton and Barto 2018, equations 3.8 and 10.6.)
    """

    name = "measured"

    def __init__(self, learner: AnyLearner, measures: Sequence[Measure]):
        self.learner, self.measures = learner, tuple(measures)
        self.num_words, self.num_begin_words = learner.num_words, learner.num_begin_words  # type: ignore[misc]
        self.is_tabular = learner.is_tabular  # type: ignore[misc]

    @property
    def reports(self) -> tuple[str, ...]:
        return (*self.learner.reports, *self.measures)

    @property
    def reports_per_episode(self) -> tuple[str, ...]:
        return (*self.learner.reports_per_episode, "discounted_return")

    @property
    def planning_interval(self) -> int:
        return self.learner.planning_interval

    def prepare(self, env: Any) -> Any:
        return self.learner.prepare(env)

    def init(self, env: Any, prepared: Any) -> LearnerState:
        state = self.learner.init(env, prepared)
        return LearnerState(state.tables, Weighted(state.control, jnp.float32(1)))

    def begin(self, prepared: Any, tables: Any, first: Any, words: Words, context: Context) -> Weighted:
        return Weighted(self.learner.begin(prepared, tables, first, words, context), jnp.float32(1))

    def action(self, control: Weighted) -> Array:
        return self.learner.action(control.control)

    def learn(
        self, prepared: Any, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> Reported:
        control, weight = state.control
        learned = self.learner.learn(prepared, LearnerState(state.tables, control), transition, words, context)
        state, report = learned if isinstance(learned, Reported) else (learned, ())
        discount = jnp.asarray(at_episode(getattr(self.learner, "discount", 1.0), context.episode), jnp.float32)
        measured = {
            "average_reward": transition.reward,
            "discounted_return": context.product(weight, transition.reward),
        }
        after = Weighted(state.control, context.product(discount, weight))
        of_measures = (jnp.asarray(measured[name], jnp.float32) for name in self.measures)
        return Reported(LearnerState(state.tables, after), (*report, *of_measures))

    def plan(self, prepared: Any, tables: chex.ArrayTree, context: Context) -> chex.ArrayTree:
        return self.learner.plan(prepared, tables, context)

    def greedy_policy(self, env: Any, prepared: Any, tables: Any, context: Context) -> HierarchicalPolicy:
        return self.learner.greedy_policy(env, prepared, tables, context)


def checked_measures(measures: Sequence[str]) -> tuple[Measure, ...]:
    """The measures, each once, in the order in which they are defined.

    Raises:
        TypeError, ValueError: no sequence of names, or an unknown name.
    """
    for name in checks.names("measures", measures):
        checks.choice("measures", name, Measure)
    return tuple(name for name in get_args(Measure) if name in measures)
