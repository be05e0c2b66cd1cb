"""Hierarchical tabular learners with decomposed values: HORDQ, MAXQ-Q and MAXQ-0.

One mechanism serves all. Each learning subtask keeps, for every state and child, the four
`updates.Parts` of a value side by side in memory: one read and one write a step. Q_r of a subtask is not
stored but computed from that subtask's own values. MAXQ-Q is the same without the value after the
exit: its C~ is the completion plus the pseudo part.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core.flags import both
from hrljax.core.numerics import put_row, stage, take_row
from hrljax.hierarchy.layout import TaskGraph
from hrljax.learners import updates
from hrljax.learners.base import Experience, Moment
from hrljax.learners.child_values import Values
from hrljax.learners.execution import Control, Ended, StackLearner, readable
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter

Bootstrap = Literal["greedy", "on_policy"]
_PARTS = len(updates.Parts._fields)


@dataclass(frozen=True)
class _Decomposed(StackLearner):
    pseudo_reward: Hyperparameter = hyperparameter(0.0, schedule=True)
    bootstrap: Bootstrap = field(default="greedy", kw_only=True)

    _has_exit_value: ClassVar[bool]

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_choice("bootstrap", Bootstrap)

    @property
    def _is_on_policy(self) -> bool:
        return self.bootstrap == "on_policy"

    def _initial(self, is_root: bool) -> tuple[Any, ...]:
        initial = self.initial_value
        return (0.0, 0.0, initial, 0.0) if self._has_exit_value and not is_root else (0.0, initial, 0.0, 0.0)

    def _worth(self, values: Values) -> Array:
        parts, real = updates.Parts(*values), self._until_end(values)
        return (real + parts.exit if self._has_exit_value else real) + parts.pseudo

    def _until_end(self, values: Values) -> Array:
        parts = updates.Parts(*values)
        return parts.reward + parts.completion

    def _learned(
        self,
        graph: TaskGraph,
        parts: Array,
        control: Control,
        step: Experience,
        ended: list[Ended],
        follows: Any,
        moment: Moment,
    ) -> Array:
        moves = [self._update(graph, level, control, step, ended[level], follows, moment) for level in graph.all_levels]
        step_size = at_episode(self.step_size, moment.episode)

        def new_row(place: Array, target: Array, live: Array) -> Array:
            return updates.increment(take_row(parts, place, _PARTS), target, step_size, live, moment.zero)

        # Every row is read before the first is written; with one level there is nothing to keep apart.
        apart = stage(new_row) if len(moves) > 1 else new_row
        rows = [apart(place, target, live) for place, target, live in moves]
        # From the last level to the first: an unused level rewrites a row of subtask 0 as it was before the step.
        for (place, _, _), row in reversed(list(zip(moves, rows, strict=True))):
            parts = put_row(parts, place, row)
        return parts

    def _update(
        self,
        graph: TaskGraph,
        level: int,
        control: Control,
        step: Experience,
        ended: Ended,
        follows: Any,
        moment: Moment,
    ) -> tuple[Array, Array, Array]:
        """Where the values of the child on a level lie, their target, and whether that child ended."""
        task = readable(control.tasks[level], ended.used)
        if level == graph.num_levels - 1:
            state, slot = step.state, graph.slot_of_action(level, task, control.action)
            discount, reward = at_episode(self.discount, moment.episode), step.reward
        else:
            state, slot, discount = control.pending[level]
            # Q_r of a subtask is read from its own values.
            reward = lax.select(control.tasks[level + 1] < 0, step.reward, jnp.float32(0))
        pseudo = at_episode(self.pseudo_reward, moment.episode) * graph.goal(task, step.next_state)
        exited = jnp.asarray(ended.exited)
        target = self._target(reward, discount, exited, pseudo, updates.Parts(*follows), moment.zero)
        place = ((task * graph.num_states + state) * graph.num_slots + slot) * _PARTS
        return place, jnp.stack(target), jnp.asarray(both(both(ended.used, ended.child), moment.live))

    def _target(
        self, reward: Array, discount: Any, exited: Array, pseudo: Array, follows: updates.Parts, zero: Array
    ) -> updates.Parts:
        return updates.hordq_targets(reward, discount, exited, pseudo, follows, zero)


@dataclass(frozen=True)
class HORDQ(_Decomposed):
    """Hierarchically optimal recursive Q-learning (thesis 3.1-3.2, eq. 3.10-3.12; Andre and Russell 2002).

    Every learning subtask keeps Q_r, Q_c and Q_e; their sum is the value of the whole problem, so
    that a subtask disobeys its parent where obeying costs more than the pseudo-reward.

    Attributes:
        hierarchy: the task hierarchy, of any depth.
        root: how the root chooses, `RandomRoot` or `ModelRoot`; None lets it learn as any other
            subtask. What does not learn is no part of the leaf cover.
        step_size: in (0, 1], or a schedule of the episode.
        epsilon: probability of a random child at every decision of a subtask, and of a random
            choice of a root that chooses greedily; or a schedule of the episode.
        discount: in [0, 1].
        initial_value: of Q_e (of Q_c in MAXQ and in a root that learns); other parts begin at 0.
        pseudo_reward: paid to a subtask that ends in its goal, or a schedule of the episode.
        bootstrap: ``"greedy"`` bootstraps on the greedy child (thesis 3.12), ``"on_policy"`` on the
            child that is invoked next.
    """

    name = "HORDQ"
    _has_exit_value = True


@dataclass(frozen=True)
class MAXQ(_Decomposed):
    """MAXQ-Q (Dietterich 2000, Table 4; thesis 2.5.1): a subtask ignores what follows its end.

    Its completion function C is Q_c here, and C~ is Q_c + Q_p. The pseudo-reward is paid in full at
    the end, as any reward of that step. With a pseudo-reward of 0 a subtask has no reason to reach
    its goal, unless that ends it sooner.

    Attributes: as `HORDQ`.
    """

    name = "MAXQ-Q"
    _has_exit_value = False


@dataclass(frozen=True)
class MAXQ0(MAXQ):
    """MAXQ-0 (Dietterich 2000, Table 2): MAXQ-Q without pseudo-rewards.

    Attributes: as `HORDQ`, but for the pseudo-reward.
    """

    pseudo_reward: float = field(default=0.0, init=False)

    name = "MAXQ-0"
