"""The sample agent of the 2009 RL competition, from its description."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.core.numerics import put_row, take
from hrljax.envs.base import AnyEnvironment
from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.nearby import dangers
from hrljax.learners.base import Context, Learner, LearnerState, Transition, Words
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter


class Trial(NamedTuple):
    """The actions of the last trial, of which the beginning is replayed."""

    actions: Array  # [most steps] int32
    length: Array  # int32: how many of them are replayed


class Choice(NamedTuple):
    action: Array  # int32
    step: Array  # int32: steps taken in this trial


def runs_on(env: Mario, episode: Episode) -> Array:
    """What the sample agent does by itself: it runs to the right, and jumps if something is near (int32)."""
    player = episode.world.player
    rises = (player.y < player.y_old) & ~player.on_ground
    jumps = dangers(env.course, episode.world).any | rises
    run, jump = (env.action_table.index((1, pressed, 1)) for pressed in (0, 1))
    return lax.select(jumps, jnp.int32(jump), jnp.int32(run))


def forward_actions(env: Mario) -> np.ndarray:
    """Numbers of the actions that do not lead to the left (int32)."""
    return np.array([i for i, (direction, *_) in enumerate(env.action_table) if direction >= 0], np.int32)


@dataclass(frozen=True)
class SampleAgent(Learner[Mario, Trial, Choice]):
    """Never goes left, jumps by what is near, and replays its last trial but for its last steps.

    What the description leaves open is decided here: near is a wall within three columns, a monster within four, a
    pit within two; he goes on jumping as long as he rises; and once in a while he does anything else but go left.

    Attributes:
        has_memory: whether it replays.
        forgotten: last steps of a trial that are not replayed.
        epsilon: probability of a random action that does not lead to the left.
    """

    has_memory: bool = True
    forgotten: int = 7
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)

    is_tabular = False
    num_words = 1
    num_begin_words = 1
    name = "sample agent"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("forgotten", 0)
        checks.flag("SampleAgent: has_memory", self.has_memory)

    def prepare(self, env: AnyEnvironment) -> Mario:
        return checks.instance("env", env, Mario, "Mario, hrljax.make('Mario'), for SampleAgent")

    def init(self, env: Mario, prepared: Mario) -> LearnerState:
        none = jnp.int32(0)
        return LearnerState(Trial(jnp.zeros(env.default_params.max_steps, jnp.int32), none), Choice(none, none))

    def begin(self, prepared: Mario, tables: Trial, first: Episode, words: Words, context: Context) -> Choice:
        return self._choose(prepared, tables, first, jnp.int32(0), words[0], context)

    def action(self, control: Choice) -> Array:
        return control.action

    def learn(
        self, prepared: Mario, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        trial: Trial = state.tables
        step = state.control.step
        last = np.int32(len(trial.actions) - 1)
        at = lax.min(step, last)
        learns = jnp.asarray(context.learns)
        action = lax.select(learns, transition.action, take(trial.actions, at))
        kept = lax.max(step + 1 - np.int32(self.forgotten), jnp.int32(0))
        ends = transition.terminated & learns
        after = Trial(put_row(trial.actions, at, action[None]), lax.select(ends, kept, trial.length))
        return LearnerState(after, self._choose(prepared, after, transition.next_state, step + 1, words[0], context))

    def _choose(self, env: Mario, trial: Trial, episode: Episode, step: Array, word: Array, context: Context) -> Choice:
        forward = forward_actions(env)
        # The rule's action is put before those that are drawn from.
        number = choices.epsilon_greedy(jnp.int32(-1), len(forward), word, at_episode(self.epsilon, context.episode))
        drawn = take(jnp.asarray(forward), lax.max(number, jnp.int32(0)))
        action = lax.select(number < 0, runs_on(env, episode), drawn)
        replayed = take(trial.actions, lax.min(step, np.int32(len(trial.actions) - 1)))
        if self.has_memory:
            action = lax.select(step < trial.length, replayed, action)
        return Choice(action, step)
