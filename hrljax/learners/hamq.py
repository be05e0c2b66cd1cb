"""HAMQ: Q-learning over the choice points of a hierarchy, one value for each choice."""

from dataclasses import dataclass
from typing import NamedTuple

from jax import Array

from hrljax.core.flags import choose
from hrljax.learners.child_values import Known
from hrljax.learners.execution import StackLearner
from hrljax.learners.hyperparameters import at_episode
from hrljax.learners.stack import Step, readable
from hrljax.learners.updates import Move, td_target


class ChoiceValue(NamedTuple):
    """The value of a choice, until the episode ends."""

    q: Array  # float32 scalar


@dataclass(frozen=True)
class HAMQ(StackLearner[ChoiceValue]):
    """Q-learning on the choice points of a hierarchy of machines (Parr and Russell 1997).

    A subtask is a machine whose one choice point picks the next child; the machine's state is the
    running subtask, not all that called it. Invoking a subtask takes no time, so the value of that
    choice is the greatest value of the subtask's own choices, computed and not learned (HAMQ-INT,
    Bai and Russell 2017). A primitive action's value bootstraps on the choice that comes next. It
    is the sum that HORDQ splits, learned whole; there is no pseudo-reward.

    Attributes:
        hierarchy: the task hierarchy, of any depth.
        root: None lets the root learn; or a root that does not, `RandomRoot`.
        step_size, epsilon, discount, ties: as of `HORDQ`.
        initial_value: of every choice.
    """

    name = "HAMQ"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.root is not None and self.root.uses_child_values:
            raise ValueError(
                f"HAMQ: root must be None or RandomRoot(), since {type(self.root).__name__}() needs the value of a "
                "subtask until it ends, which HAMQ does not learn"
            )

    def initial(self, is_root: bool) -> ChoiceValue:
        return ChoiceValue(self.initial_value)  # type: ignore[arg-type]

    def q_total(self, q: ChoiceValue) -> Array:
        return q.q

    def value_until_end(self, q: ChoiceValue) -> Array:
        return q.q

    def of_subtask(self, stored: ChoiceValue, best: ChoiceValue) -> ChoiceValue:
        return best

    def moves(self, known: Known, step: Step[ChoiceValue]) -> list[Move]:
        """The choice of the primitive action; what follows it is the choice that comes next."""
        layout, context, stack, transition = known.layout, known.context, step.stack, step.transition
        task, slot = stack.tasks[0], layout.slot_of_action(layout.levels[0], stack.tasks[0], stack.action)
        for level in layout.all_levels[1:]:
            # The subtask that took the action is the last one on the stack.
            lower = readable(stack.tasks[level], step.ends[level].used)
            lower_slot = layout.slot_of_action(layout.levels[level], lower, stack.action)
            task, slot = choose(step.ends[level].used, (lower, lower_slot), (task, slot))
        gamma = context.discounted(at_episode(self.discount, context.episode))
        target = td_target(transition.reward, gamma, step.q_next.q)
        start = layout.start_of_child(task, transition.state, slot, self._size)
        return [Move(start, target[None], True)]
