"""Pseudo-rewards: how far a subtask obeys its parent."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from jax import Array

from hrljax.core.numerics import take
from hrljax.hierarchy.layout import StackLayout
from hrljax.learners.base import Context, Transition
from hrljax.learners.child_values import Known, Q
from hrljax.learners.execution import StackLearner
from hrljax.learners.fading import Fading, Seen
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter

Bootstrap = Literal["greedy", "on_policy"]


@dataclass(frozen=True)
class PseudoRewarded(StackLearner[Q]):
    """A hierarchical learner that chooses by ``q_total + kappa(s) * value_of_goal``.

    Attributes:
        pseudo_reward: kappa, a number, a schedule of the episode or `Fading`.
        bootstrap: on the ``"greedy"`` child, or ``"on_policy"`` on what is invoked next.
    """

    pseudo_reward: "Hyperparameter | Fading" = hyperparameter(0.0, schedule=True, settings=Fading)
    bootstrap: Bootstrap = field(default="greedy", kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_choice("bootstrap", Bootstrap)

    @property
    def is_on_policy(self) -> bool:
        return self.bootstrap == "on_policy"

    @abstractmethod
    def value_of_goal(self, q: Q) -> Array:
        """What a child earns of the pseudo-reward of its parent, of one unit if `in_units`, else of all."""

    @property
    def in_units(self) -> bool:
        """Whether values are those of a pseudo-reward of 1."""
        return isinstance(self.pseudo_reward, Fading)

    def preference(self, known: Known, state: Array) -> Callable[[Q], Array]:
        if not self.in_units:
            return lambda q: self.q_total(q) + self.value_of_goal(q)
        kappa = self._kappa(known, state)
        return lambda q: self.q_total(q) + known.context.product(kappa, self.value_of_goal(q))

    def paid(self, known: Known, goal_factor: Array) -> Array:
        """The pseudo-reward at a subtask's end, of which `value_of_goal` is the value."""
        return goal_factor if self.in_units else at_episode(self.pseudo_reward, known.context.episode) * goal_factor

    def nothing_seen(self, layout: StackLayout) -> Seen | None:
        return self.pseudo_reward.nothing_seen(layout.num_states) if isinstance(self.pseudo_reward, Fading) else None

    def after_seeing(self, seen: Seen | None, transition: Transition, context: Context) -> Seen | None:
        if seen is None or not isinstance(self.pseudo_reward, Fading):
            return None
        return self.pseudo_reward.after_seeing(seen, transition.state, transition.reward, context)

    def _kappa(self, known: Known, state: Array) -> Array:
        """The weight of `value_of_goal` in a state."""
        if known.seen is None or not isinstance(self.pseudo_reward, Fading):
            return at_episode(self.pseudo_reward, known.context.episode)
        return self.pseudo_reward.at(known.seen, take(known.seen.visits, state), known.context)
