"""HAMQ: Q-learning over the choice points of a hierarchy, one value for each choice."""

from dataclasses import dataclass
from typing import Any

from jax import Array

from hrljax.core.flags import choose
from hrljax.core.numerics import put_row, take_row
from hrljax.hierarchy.layout import TaskGraph
from hrljax.learners import updates
from hrljax.learners.base import Experience, Moment
from hrljax.learners.child_values import Values
from hrljax.learners.execution import Control, Ended, StackLearner, readable
from hrljax.learners.hyperparameters import at_episode


@dataclass(frozen=True)
class HAMQ(StackLearner):
    """Q-learning on the choice points of a hierarchy of machines (Parr and Russell 1997).

    A subtask is a machine whose one choice point picks the next child; the machine's state is the
    running subtask, not all that called it. Invoking a subtask takes no time, so the value of that
    choice is the greatest value of the subtask's own choices, computed and not learned (HAMQ-INT,
    Bai and Russell 2017). A primitive action's value bootstraps on the choice that comes next. It
    is the sum that HORDQ splits, learned whole; there is no pseudo-reward.

    Attributes:
        hierarchy: the task hierarchy, of any depth.
        root: None lets the root learn; or a root that does not, `RandomRoot`.
        step_size, epsilon, discount: as of `HORDQ`.
        initial_value: of every choice.
    """

    name = "HAMQ"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.root is not None and self.root.learns:
            raise ValueError(
                f"HAMQ: root must be None or RandomRoot(), since {type(self.root).__name__}() needs the value of a "
                "subtask until it ends, which HAMQ does not learn"
            )

    def _initial(self, is_root: bool) -> tuple[Any, ...]:
        return (self.initial_value,)

    def _worth(self, values: Values) -> Array:
        return values[0]

    def _until_end(self, values: Values) -> Array:
        return values[0]

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
        task = control.tasks[0]
        slot = graph.slot_of_action(0, task, control.action)
        for level in graph.all_levels[1:]:
            # The subtask that took the action is the last one on the stack.
            here = readable(control.tasks[level], ended[level].used)
            its_slot = graph.slot_of_action(level, here, control.action)
            task, slot = choose(ended[level].used, (here, its_slot), (task, slot))
        target = updates.td_target(step.reward, at_episode(self.discount, moment.episode), follows[0], moment.zero)
        at = (task * graph.num_states + step.state) * graph.num_slots + slot
        old = take_row(parts, at, 1)
        new = updates.increment(old, target[None], at_episode(self.step_size, moment.episode), moment.live, moment.zero)
        return put_row(parts, at, new)
