"""Hierarchical tabular learners with decomposed values: HORDQ, MAXQ-Q and MAXQ-0.

Each learning subtask keeps, for every state and child, the parts of a value side by side in memory:
one read and one write a step. Q_r of a child that is a subtask is not stored but computed from that
subtask's own values. MAXQ-Q is HORDQ without the value after the exit.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import chex
import jax.numpy as jnp
from jax import Array, lax

from hrljax.core.flags import both
from hrljax.learners.base import Discounted
from hrljax.learners.child_values import Known
from hrljax.learners.pseudo_reward import PseudoRewarded
from hrljax.learners.stack import LevelEnd, Step
from hrljax.learners.updates import Move


class Q(NamedTuple):
    """The value of child a of subtask i in state s, in parts (thesis eq. 3.2): ``Q = Q_r + Q_c + Q_e``; scalars."""

    r: Array  # Q_r: until a ends
    c: Array  # Q_c: from there until i ends
    e: Array  # Q_e: from there until the episode ends
    p: Array  # pseudo-reward at i's end, apart from the real reward: biases choices, never enters r, c and e

    def __add__(self, other: object) -> "Q":  # the tuple's concatenation would hide mistakes
        return NotImplemented


def hordq_target(reward: Array, gamma: Discounted, exited: Array, pseudo_reward: Array, q_next: Q) -> Q:
    """What Q(i, s, a) is moved to when a has ended, N steps after it was invoked in s (thesis eq. 3.10-3.12).

        Q_r <- R
        Q_c <- g^N [Q_r + Q_c](i, s', a')    where i goes on, else 0
        Q_e <- g^N Q_e(i, s', a')            where i goes on, else g^N Q(i', s', a')
        Q_p <- g^N Q_p(i, s', a')            where i goes on, else the pseudo-reward

    s' is the state that is reached, a' what the bootstrap picks there, i' the next subtask of the leaf cover.
    (Read literally, eq. 3.11 would count the next subtask's reward twice on exit; eq. 3.4 sums over active
    states only.)

    Args:
        reward: R, since a began.
        gamma: discounts by g^N.
        exited: bool, i ended too.
        pseudo_reward: paid if `exited`; not discounted.
        q_next: of a' in i where it goes on, else in i'; 0 if the episode terminated.
    """
    chex.assert_rank([reward, exited, pseudo_reward, *q_next], 0)
    chex.assert_type([reward, exited, pseudo_reward, *q_next], [float, bool, *[float] * 5])
    r, c, e, p = q_next
    none = jnp.zeros_like(reward)
    return Q(
        r=reward,
        c=lax.select(exited, none, gamma(r + c)),
        e=gamma(lax.select(exited, r + c + e, e)),
        p=lax.select(exited, pseudo_reward, gamma(p)),
    )


@dataclass(frozen=True)
class _Decomposed(PseudoRewarded[Q]):
    """What HORDQ and MAXQ-Q share: all but what a subtask wants."""

    def value_until_end(self, q: Q) -> Array:
        return q.r + q.c

    def value_of_goal(self, q: Q) -> Array:
        return q.p

    def of_subtask(self, stored: Q, best: Q) -> Q:
        return stored._replace(r=self.value_until_end(best))

    def target(self, reward: Array, gamma: Discounted, exited: Array, pseudo_reward: Array, q_next: Q) -> Q:
        """What the values of a child that has ended are moved to; as `hordq_target`."""
        return hordq_target(reward, gamma, exited, pseudo_reward, q_next)

    def moves(self, known: Known, step: Step[Q]) -> list[Move]:
        """One move a level. A level that is not used rewrites a row of subtask 0 as it was before the step."""

        def move(level: int, end: LevelEnd) -> Move:
            child = self.running_child(known, level, step)
            pseudo_reward = self.paid(known, known.layout.goal_factor(child.parent, step.transition.next_state))
            target = self.target(child.reward, child.gamma, jnp.asarray(end.exited), pseudo_reward, step.q_next)
            start = known.layout.start_of_child(child.parent, child.state, child.slot, self._size)
            return Move(start, jnp.stack(target), both(end.used, end.child))

        return [move(level, end) for level, end in enumerate(step.ends)]


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
            choice of a root that chooses greedily; or a schedule of the episode. Else the best child is
            invoked.
        discount: in [0, 1].
        initial_value: of Q_e (of Q_c in MAXQ and in a root that learns); other parts begin at 0.
        pseudo_reward: paid to a subtask that ends in its goal; a number, a schedule of the episode or `Fading`.
        bootstrap: ``"greedy"`` bootstraps on the greedy child (thesis 3.12), ``"on_policy"`` on the
            child that is invoked next.
        ties: of equally good children it invokes the ``"first"``, in the order of the subtask's children, or a
            ``"random"`` one, each as likely as the others. Bootstraps, roots that do not learn, and what is greedy
            without training (pictures, exact values) go by the first.
    """

    name = "HORDQ"

    def initial(self, is_root: bool) -> Q:
        value: Array = self.initial_value  # type: ignore[assignment]
        zero: Array = jnp.float32(0)
        return Q(zero, value, zero, zero) if is_root else Q(zero, zero, value, zero)

    def q_total(self, q: Q) -> Array:
        return q.r + q.c + q.e


@dataclass(frozen=True)
class MAXQ(_Decomposed):
    """MAXQ-Q (Dietterich 2000, Table 4; thesis 2.5.1): a subtask ignores what follows its end.

    Its completion function C is Q_c here, and C~ is Q_c + Q_p. The pseudo-reward is paid in full at
    the end, as any reward of that step. With a pseudo-reward of 0 a subtask has no reason to reach
    its goal, unless that ends it sooner.

    Attributes: as `HORDQ`.
    """

    name = "MAXQ-Q"

    def initial(self, is_root: bool) -> Q:
        value: Array = self.initial_value  # type: ignore[assignment]
        zero: Array = jnp.float32(0)
        return Q(zero, value, zero, zero)

    def q_total(self, q: Q) -> Array:
        return q.r + q.c


@dataclass(frozen=True)
class MAXQ0(MAXQ):
    """MAXQ-0 (Dietterich 2000, Table 2): MAXQ-Q without pseudo-rewards.

    Attributes: as `HORDQ`, but for the pseudo-reward.
    """

    pseudo_reward: float = field(default=0.0, init=False)

    name = "MAXQ-0"
