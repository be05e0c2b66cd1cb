"""Dyna-Q: Q-learning that replays what it remembers of the environment."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.counting import count
from hrljax.core.numerics import put_row, take
from hrljax.core.random import word_block
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.learners import samples as model
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.flat import StepSizeLearner, row_of


class DynaTables(NamedTuple):
    """What Dyna-Q has learned."""

    values: Array  # [S * A] float32 action values
    samples: model.Samples
    visited: Array  # [S * A] int32: pairs ``state * A + action`` in the order of their first visits
    num_visited: Array  # int32


@dataclass(frozen=True)
class DynaQ(StepSizeLearner):
    """Dyna-Q (Sutton 1990; Sutton and Barto 1998, Fig. 9.4; thesis 2.3.2), tabular.

    After the update of Q-learning from a real step come `planning_steps` updates of the same kind
    from remembered ones: a pair drawn uniformly among those ever visited, and one of the outcomes
    kept for it, drawn uniformly. The next action is chosen after that. (An index is a random word
    of 24 bits modulo n: no index is likelier than another by more than ``n / 2**24``.)

    Attributes:
        step_size: in (0, 1], or a schedule of the episode; of real and remembered steps.
        epsilon: probability of a uniformly random action, or a schedule of the episode. Else it takes the best one.
        discount: in [0, 1].
        initial_value: of every state and action.
        planning_steps: remembered steps per real one, at least 0; 0 gives Q-learning bit for bit.
        outcomes_kept: latest outcomes kept of each pair, at least 1. With 1 the model holds the
            environment to be deterministic and believes what happened last.
        ties: as of `QLearning`.
    """

    planning_steps: int = 10
    outcomes_kept: int = 1

    name = "Dyna-Q"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("planning_steps", 0)
        self._check_integer("outcomes_kept", 1)

    @property
    def num_words(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride] (depends on a field)
        return 3 if self.planning_steps else 1

    def init(self, env: AnyTabularEnvironment, prepared: int) -> LearnerState:
        values = self.initial_values(env)
        samples = model.empty(env.num_states, prepared, self.outcomes_kept)
        visited = jnp.zeros(len(values), jnp.int32)
        return LearnerState(DynaTables(values, samples, visited, jnp.int32(0)), jnp.int32(0))

    def learn(
        self, prepared: int, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        tables: DynaTables = state.tables
        pair = transition.state * prepared + transition.action
        outcome = transition.reward, transition.next_state, transition.terminated
        tables = tables._replace(values=self._backed_up(tables.values, pair, outcome, prepared, context))
        if self.planning_steps:
            tables = self._remembered(tables, pair, transition, prepared, context)
            tables = self._replayed(tables, words[1:], prepared, context)
        action = self.choose(row_of(tables.values, transition.next_state, prepared), words[0], context)
        return LearnerState(tables, action)

    def _backed_up(
        self, values: Array, pair: Array, outcome: tuple[Array, Array, Array], prepared: int, context: Context
    ) -> Array:
        """One update of Q-learning from a reward, a next state, and whether the episode terminated."""
        reward, after, terminated = outcome
        bootstrap = choices.greedy(row_of(values, after, prepared))[1]
        return self.moved(values, pair, self.target(reward, bootstrap, terminated, context), context)

    def _remembered(
        self, tables: DynaTables, pair: Array, transition: Transition, prepared: int, context: Context
    ) -> DynaTables:
        is_new = context.learns & (take(tables.samples.seen, pair) == 0)
        entry = lax.select(is_new, pair, take(tables.visited, tables.num_visited))
        num_states = len(tables.visited) // prepared
        return tables._replace(
            samples=model.recorded(tables.samples, pair, transition, num_states, context.learns),
            visited=put_row(tables.visited, tables.num_visited, entry[None]),
            num_visited=tables.num_visited + is_new.astype(jnp.int32),
        )

    def _replayed(self, tables: DynaTables, key: tuple[Array, ...], prepared: int, context: Context) -> DynaTables:
        num_pairs, words_of = len(tables.visited), 1 if self.outcomes_kept == 1 else 2
        num_states = num_pairs // prepared
        drawn = word_block((key[0], key[1]), count(), _whole_registers(self.planning_steps), words_of)

        def replay(i: Array, values: Array) -> Array:
            words = drawn[i]
            pair = take(tables.visited, _below(words[0], tables.num_visited))
            place = pair
            if self.outcomes_kept > 1:
                stored = lax.min(take(tables.samples.seen, pair), jnp.int32(self.outcomes_kept))
                place = _below(words[1], stored) * np.int32(num_pairs) + pair
            after, reward = take(tables.samples.after, place), take(tables.samples.reward, place)
            return self._backed_up(values, pair, (reward, after, after == num_states), prepared, context)

        values = lax.fori_loop(0, self.planning_steps, replay, tables.values)
        return tables._replace(values=values)


def _whole_registers(n: int) -> int:
    """`n` rounded up so that vectors of that length fill their registers, which is faster."""
    return 8 if n <= 8 else -(-n // 16) * 16


def _below(word: Array, n: Array) -> Array:
    """A uniform index in ``[0, n)``, int32."""
    return (word % n.astype(jnp.uint32)).astype(jnp.int32)
