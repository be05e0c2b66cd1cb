"""The result of one run, and how it is cut into bins of episodes."""

from typing import Any, NamedTuple

import chex
from jax import Array
from jax.core import Tracer

from hrljax.engine.start import Start, steps_of
from hrljax.envs.base import AnyEnvironment
from hrljax.learners.base import AnyLearner


class Run(NamedTuple):
    """Result of one run."""

    learned: chex.ArrayTree  # the learner's tables after the last episode
    metrics: dict[str, Array]  # each [bins] float32: means, in bins of episodes; see `metric_names`
    greedy_return: Array  # [checkpoints] float32: exact value of the greedy policy
    episodes: Array  # int32: episodes that were learned from, those before `start` included
    step_words: Array  # [2] uint32: primitive steps of these episodes, the low and the high half

    @property
    def steps(self) -> Any:
        """Primitive steps of these episodes, int64 ``[...]`` where runs are mapped; outside of compiled code.

        Raises:
            TypeError: the run is traced.
        """
        if isinstance(self.step_words, Tracer):
            raise TypeError("Run.steps has 64 bits, which compiled code does not; use Run.step_words there")
        return steps_of(self.step_words)

    def as_start(self) -> Start:
        """Where a run begins that goes on from this one."""
        return Start(self.learned, self.episodes, self.step_words)


def metric_names(env: AnyEnvironment, learner: AnyLearner) -> tuple[str, ...]:
    """Names of the entries of `Run.metrics`.

    Per episode: return, length (steps), the environment's events, and truncated: 1 if the episode was cut
    off by the limit of steps. Per step: what the learner reports.
    """
    return ("return", "length", *env.metrics, "truncated", *learner.reports)


def bin_sizes(num_episodes: int, bin_size: int) -> list[int]:
    """Episodes in each bin; only the last may be smaller."""
    full, rest = divmod(num_episodes, bin_size)
    return [bin_size] * full + [rest] * (rest > 0)


def default_bin_size(num_episodes: int) -> int:
    """The bin size that gives about 200 bins."""
    return max(1, num_episodes // 200)
