"""What a learner of one's own is made of; docs/own_learner.md shows how."""

from hrljax.core.choices import epsilon_greedy, greedy, nth_allowed, pick
from hrljax.core.random import below
from hrljax.learners.base import Context, Learner, LearnerState, Reported, Transition
from hrljax.learners.child_values import Known
from hrljax.learners.execution import StackLearner
from hrljax.learners.flat import ActionValueLearner, StepSizeLearner, row_of
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter, report_option
from hrljax.learners.roots.base import Decision, Root, SubtaskRoot
from hrljax.learners.stack import Step
from hrljax.learners.updates import Move, moved, td_target

__all__ = [
    "ActionValueLearner",
    "Context",
    "Decision",
    "Hyperparameter",
    "Known",
    "Learner",
    "LearnerState",
    "Move",
    "Reported",
    "Root",
    "StackLearner",
    "Step",
    "StepSizeLearner",
    "SubtaskRoot",
    "Transition",
    "at_episode",
    "below",
    "epsilon_greedy",
    "greedy",
    "hyperparameter",
    "moved",
    "nth_allowed",
    "pick",
    "report_option",
    "row_of",
    "td_target",
]
