"""A pseudo-reward that fades by itself."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core.numerics import put_row, take_row
from hrljax.learners.base import Context
from hrljax.learners.hyperparameters import Hyperparameter, Settings, at_episode, hyperparameter


class Seen(NamedTuple):
    """What a pseudo-reward that fades goes by, over the steps that a learner has learned from."""

    visits: Array  # [places] float32
    of_steps: Array  # [2] float32: `mean_reward` and `steps`; a native loop pays for every array

    @property
    def mean_reward(self) -> Array:
        """Mean |reward| of a step, float32 scalar."""
        return self.of_steps[0]

    @property
    def steps(self) -> Array:
        """How many, float32 scalar; stands still at 2**24, from where the mean forgets."""
        return self.of_steps[1]


@dataclass(frozen=True)
class Fading(Settings):
    """A pseudo-reward that fades wherever the learner has been.

        kappa(s) = worth * mean |reward| of a step / (1 + n(s) / after)

    n(s) is how often this run has taken a step in s, the last step aside, as it is of the mean. Where
    everything is visited for ever, kappa tends to 0, and behaviour to what is greedy in real rewards;
    no schedule over episodes is needed. To multiply all rewards by a number changes no choice.

    Attributes:
        worth: how many typical steps it is worth to obey where nothing is known, at least 0.
        after: visits after which it is worth half, greater than 0.
    """

    worth: Hyperparameter = hyperparameter(10.0, 0)
    after: Hyperparameter = hyperparameter(10.0, 0, low_open=True)

    def nothing_seen(self, num_places: int) -> Seen:
        return Seen(jnp.zeros(num_places, jnp.float32), jnp.zeros(2, jnp.float32))

    def after_seeing(self, seen: Seen, place: Array, reward: Array, context: Context) -> Seen:
        """After a step in a place."""
        once = jnp.asarray(context.learns).astype(jnp.float32)
        steps = seen.steps + once
        off = jnp.abs(reward) - seen.mean_reward
        mean = seen.mean_reward + lax.select(
            jnp.asarray(context.learns), off / lax.max(steps, jnp.float32(1)), once * 0
        )
        visits = put_row(seen.visits, place, take_row(seen.visits, place, 1) + once)
        return Seen(visits, jnp.stack([mean, steps]))

    def at(self, seen: Seen, visits: Array, context: Context) -> Array:
        """kappa (float32 scalar) where there were so many visits."""
        # As a fraction whose denominator is a sum: a division by a constant is a multiplication to XLA.
        worth, after = (at_episode(number, context.episode) for number in (self.worth, self.after))
        return context.product(worth * after, seen.mean_reward) / (after + visits)
