"""HORDQ with one value function for all subtasks of a total leaf cover."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.flags import both
from hrljax.core.numerics import take, take_row
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.layout import ChildSet, StackLayout
from hrljax.hierarchy.leaf_cover import inaccessible
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.base import Discounted, Transition
from hrljax.learners.child_values import Known
from hrljax.learners.execution import Prepared
from hrljax.learners.fading import Fading
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.pseudo_reward import PseudoRewarded
from hrljax.learners.stack import Step
from hrljax.learners.updates import Move, td_target

Taught = Literal["running", "active"]


class SharedQ(NamedTuple):
    """The values of child a of subtask i in state s; float32 scalars."""

    q: Array  # Q(s, a), of the whole problem: one for all subtasks; of a child that is a subtask, not stored
    p: Array  # P_i(s, a), until i ends: of a pseudo-reward of 1 at its end
    u: Array  # U_i(s, a), until i ends: of real rewards; 0 where no root asks for it


def until_end(reward: Array, gamma: Discounted, exited: Array, goal: Array, next_p: Array, next_u: Array) -> Array:
    """What P_i(s, a) and U_i(s, a) are moved to when a has ended, N steps after it was chosen in s.

        P_i <- goal_i(s')         where i ended, else g^N P_i(s', a')
        U_i <- R                  where i ended, else R + g^N U_i(s', a')

    Args:
        reward: R, since a began.
        gamma: discounts by g^N.
        exited: bool, i ended too.
        goal: factor of the pseudo-reward in s'.
        next_p: of what the bootstrap picks in s'; 0 if the episode terminated.
        next_u: of the same.

    Returns:
        ``[2]`` float32: of P_i and of U_i.
    """
    none = jnp.zeros_like(reward)
    return jnp.stack([lax.select(exited, goal, gamma(next_p)), reward + gamma(lax.select(exited, none, next_u))])


@dataclass(frozen=True)
class SharedHORDQ(PseudoRewarded[SharedQ]):
    """HORDQ whose subtasks share one Q(s, a): what one of them learns, all know.

    With a total leaf cover the optimal Q(i, s, a) is Q*(s, a) for every subtask i of the cover (thesis,
    Theorem 2), so one table can serve all; the thesis has it so in Mario (4.2.5). A subtask has but the
    value P_i of a pseudo-reward of 1 at its end, and U_i, its return until then, where the root asks for it.

        choice in i:   argmax_a Q(s, a) + kappa(s) P_i(s, a), epsilon-greedy
        a subtask c:   Q(s, c) = Q(s, a) of the action a that c would take (Theorem 1)
        Q(s, a) <- r + g max_b Q(s', b)           P_i, U_i: see `until_end`

    Q is Q-learning's, whatever subtasks, root and pseudo-reward make of behaviour; so it converges to Q*
    wherever Q-learning does.

    Attributes:
        hierarchy: of any depth, with a total leaf cover: every subtask with a primitive child can execute every
            primitive action in all states in which it is active (`hrljax.total_leaf_cover` completes one).
        root: as of `HORDQ`.
        step_size, epsilon, discount, ties: as of `HORDQ`.
        initial_value: of Q.
        pseudo_reward: kappa; a number, a schedule of the episode or `Fading`.
        bootstrap: of Q; ``"greedy"`` on the best action, ``"on_policy"`` on the action that is taken next.
        taught: which subtasks' P and U a step teaches: those that are ``"running"``, or all that are ``"active"``
            in its state and have its action. Off-policy, the latter bootstrap on their own greedy child.
    """

    pseudo_reward: "Hyperparameter | Fading" = hyperparameter(Fading(), schedule=True, settings=Fading)
    taught: Taught = field(default="running", kw_only=True)

    name = "shared HORDQ"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_choice("taught", Taught)
        if not self.hierarchy.is_total_leaf_cover():
            lacks = ", ".join(
                f"{name!r} lacks {action!r}"
                for name in self.hierarchy.leaf_cover()
                for action in self.hierarchy.actions
                if action not in self.hierarchy.reachable_actions(name)
            )
            raise ValueError(f"SharedHORDQ: hierarchy must have a total leaf cover, but {lacks}; {_REMEDY}")

    def prepare(self, env: AnyTabularEnvironment) -> Prepared:
        """Raises ValueError if a subtask cannot execute an action in a state in which it is active."""
        gaps = inaccessible(self.hierarchy, tabulate(self.hierarchy, env).active)
        if gaps:
            raise ValueError(f"SharedHORDQ: hierarchy must have a total leaf cover, but {gaps[0]}; {_REMEDY}")
        return super().prepare(env)

    # How values are stored: [S * A] Q, then [tasks * S * K * _size] P and U.

    def initial(self, is_root: bool) -> SharedQ:
        none = jnp.float32(0)
        return SharedQ(jnp.asarray(self.initial_value, jnp.float32), none, none)

    def initial_values(self, layout: StackLayout, root_learns: bool) -> Array:
        shared = jnp.full(_num_shared(layout), self.initial(is_root=False).q)
        cells = layout.num_tasks * layout.num_states * layout.num_slots
        return jnp.concatenate([shared, jnp.zeros(cells * self._size, jnp.float32)])

    @property
    def _size(self) -> int:
        return 2 if self.root is not None and self.root.uses_child_values else 1

    def _stored(self, known: Known, children: ChildSet, task: Array, state: Array) -> list[SharedQ]:
        size, none = self._size, jnp.float32(0)
        row = self._shared_row(known, state)
        start = known.layout.start(task, state, size) + _num_shared(known.layout)
        numbers = take_row(known.q, start, children.num_slots * size)
        of_slots = [numbers[slot * size : (slot + 1) * size] for slot in range(children.num_slots)]
        return [
            SharedQ(none if action < 0 else row[action], p_and_u[0], none if size == 1 else p_and_u[1])
            for action, p_and_u in zip(children.actions, of_slots, strict=True)
        ]

    def _stored_in(self, known: Known, children: ChildSet, task: Array, state: Array, slot: Array) -> SharedQ:
        size = self._size
        numbers = take_row(known.q, self._start(known.layout, task, state, slot), size)
        q = take(known.q, state * known.layout.num_actions + known.layout.child_of(children, slot)[0])
        return SharedQ(q, numbers[0], jnp.float32(0) if size == 1 else numbers[1])

    def _shared_row(self, known: Known, state: Array) -> list[Array]:
        """Q(s, a) of every action."""
        row = take_row(known.q, state * known.layout.num_actions, known.layout.num_actions)
        return [row[action] for action in range(known.layout.num_actions)]

    def _start(self, layout: StackLayout, task: Array, state: Array, slot: Array) -> Array:
        """Where P and U of a child begin."""
        return layout.start_of_child(task, state, slot, self._size) + _num_shared(layout)

    # What values mean.

    def q_total(self, q: SharedQ) -> Array:
        return q.q

    def value_until_end(self, q: SharedQ) -> Array:
        return q.u

    def value_of_goal(self, q: SharedQ) -> Array:
        return q.p

    def of_subtask(self, stored: SharedQ, best: SharedQ) -> SharedQ:
        return SharedQ(best.q, stored.p, best.u + stored.u)

    @property
    def in_units(self) -> bool:
        return True

    # What a step teaches.

    def moves(self, known: Known, step: Step[SharedQ]) -> list[Move]:
        """Q(s, a); then P and U of the subtasks that are taught. A learning root has no end before the episode's."""
        levels = known.layout.all_levels[1 if self.root is None else 0 :]
        if self.taught == "running":
            return [self._shared(known, step), *(self._running(known, level, step) for level in levels)]
        # What is taught comes before what rewrites a row as it was.
        subtasks = [self._running(known, level, step) for level in levels if level + 1 < known.layout.num_levels]
        return [self._shared(known, step), *self._active(known, step.transition), *subtasks]

    def _shared(self, known: Known, step: Step[SharedQ]) -> Move:
        num_actions, transition = known.layout.num_actions, step.transition
        if step.next_action is None:
            best = choices.greedy(self._shared_row(known, transition.next_state))[1]
        else:
            best = take(known.q, transition.next_state * num_actions + step.next_action)
        best = lax.select(transition.terminated, jnp.float32(0), best)
        gamma = known.context.discounted(at_episode(self.discount, known.context.episode))
        target = td_target(transition.reward, gamma, best)
        return Move(transition.state * num_actions + transition.action, target[None], True)

    def _running(self, known: Known, level: int, step: Step[SharedQ]) -> Move:
        child, end, after = self.running_child(known, level, step), step.ends[level], step.q_next
        goal = known.layout.goal_factor(child.parent, step.transition.next_state)
        target = until_end(child.reward, child.gamma, jnp.asarray(end.exited), goal, after.p, after.u)
        start = self._start(known.layout, child.parent, child.state, child.slot)
        learns = both(end.used, end.child)
        if self.taught == "active":  # An action is taught with those of all other active subtasks.
            learns = both(learns, step.stack.tasks[level + 1] >= 0)
        return Move(start, target[: self._size], learns)

    def _active(self, known: Known, transition: Transition) -> list[Move]:
        """Of every subtask that is active in the state and has the action."""
        layout, after = known.layout, transition.next_state
        gamma = known.context.discounted(at_episode(self.discount, known.context.episode))
        table = layout.active_tasks(without_root=self.root is None)
        row = take_row(jnp.asarray(table.ravel()), transition.state * table.shape[1], table.shape[1])
        taught = sorted(set(table[table >= 0].tolist()))

        def move(entry: Array) -> Move:
            task = lax.max(entry, jnp.int32(taught[0]))
            slot = layout.slot_of_action(taught, task, transition.action)
            learns = both(entry >= 0, layout.has_action(taught, task, transition.action))
            exited, goal = ~layout.is_active(task, after), layout.goal_factor(task, after)
            best = layout.by_child_set(taught, task, lambda children: self._best(known, children, task, after))
            p, u = (lax.select(transition.terminated, jnp.float32(0), number) for number in (best.p, best.u))
            target = until_end(transition.reward, gamma, exited, goal, p, u)
            return Move(self._start(layout, task, transition.state, slot), target[: self._size], learns)

        return [move(row[i]) for i in range(table.shape[1])]


_REMEDY = (
    "hrljax.total_leaf_cover(hierarchy, active=hrljax.tabulate(hierarchy, env).active).hierarchy adds what is missing"
)


def _num_shared(layout: StackLayout) -> int:
    """Numbers of Q(s, a), which come first in the table."""
    return layout.num_states * layout.num_actions
