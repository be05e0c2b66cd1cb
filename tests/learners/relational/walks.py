"""A walk in Mario, which is recorded once for all tests that learn from it."""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hrljax.core.random import WORD_RANGE
from hrljax.envs.mario.competition import unbegun
from hrljax.envs.mario.env import Mario
from hrljax.learners.base import Transition

ENV = Mario(seeds=(2,), difficulty=10, preset="thesis")
"""Monsters from the first screen on."""


class Walk(NamedTuple):
    """What a learner is given, step by step."""

    first: Any
    steps: list[Transition]
    words: np.ndarray  # [steps + 1] uint32


@cache
def recorded() -> Walk:
    """Right-biased random actions until the episode ends.

    It begins before the first tick, since a reset takes as long to compile as a step.
    """
    generator = np.random.default_rng(7)
    step = jax.jit(lambda state, action: ENV.step(jax.random.key(0), state, action))
    first = state = unbegun(ENV.course, 0)
    steps: list[Transition] = []
    while not steps or not steps[-1].terminated:
        action = jnp.int32(generator.choice([4, 5, 7, 8, 0]))
        _, after, reward, terminated, _, _ = step(state, action)
        steps.append(Transition(state, action, reward, after, terminated))
        state = after
    assert 10 < len(steps) < 64
    return Walk(first, steps, generator.integers(WORD_RANGE, size=len(steps) + 1).astype(np.uint32))
