"""Options of SARSA(lambda), of a pit specialist and of rules under SMDP Q-learning (Gibson and Risk)."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.core.numerics import take_row
from hrljax.core.random import threshold
from hrljax.envs.base import AnyEnvironment
from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.levels.tiles import TILE
from hrljax.envs.mario.nearby import dangers, pits
from hrljax.learners.base import Context, Learner, LearnerState, Transition, Words
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.mario.sample import runs_on
from hrljax.learners.relational.concepts import Concepts, NearestThings
from hrljax.learners.relational.learner import Control, Prepared, RelationalHORDQ
from hrljax.learners.relational.learner import Tables as Values
from hrljax.learners.updates import Move, moved, td_target

PIT_REACH = 4
"""Tiles within which a pit calls the specialist."""
_SPEEDS = 4
_TICKS = 5
OPTIONS = ("SARSA(lambda)", "pit specialist", "rules")
_SPECIALIST = 1


@dataclass(frozen=True)
class Pits:
    """Where the next column of a pit is, whether Mario stands, and how fast he runs: one of these holds at a time."""

    num = (PIT_REACH + 2) * 2 * _SPEEDS
    most = 1

    def held(self, env: Mario, episode: Episode) -> Concepts:
        ahead = pits(env.course, episode.world, 0, PIT_REACH)
        column = jnp.where(ahead.any(), jnp.argmax(ahead), PIT_REACH + 1).astype(jnp.int32)
        player = episode.world.player
        tiles_a_step = (player.x - player.x_old) * np.float32(_TICKS / TILE)
        speed = lax.clamp(jnp.int32(0), tiles_a_step.astype(jnp.int32), jnp.int32(_SPEEDS - 1))
        number = (column * 2 + player.on_ground.astype(jnp.int32)) * np.int32(_SPEEDS) + speed
        return number[None], jnp.int32(1)


def situation(env: Mario, episode: Episode) -> tuple[Array, Array]:
    """What the master knows, a number below 16 (int32), and whether there is a pit for the specialist (bool)."""
    world, near = episode.world, dangers(env.course, episode.world)
    pit = pits(env.course, world, -PIT_REACH, PIT_REACH).any()
    number = jnp.int32(0)
    for flag in (pit, near.wall, near.monster, world.player.on_ground):
        number = number * 2 + flag.astype(jnp.int32)
    return number, pit


class Tables(NamedTuple):
    """What the master and the two options that learn have learned."""

    master: Array  # [16 * 3] float32: value of an option in a situation
    sarsa: Values
    specialist: Values


class Running(NamedTuple):
    """The option that runs, and what each would do."""

    option: Array  # int32
    situation: Array  # int32: in which it began
    reward: Array  # float32: discounted sum of its rewards so far
    discount: Array  # float32: discount to the power of its steps so far
    sarsa: Control
    specialist: Control
    rule: Array  # int32


@dataclass(frozen=True)
class ThreeOptions(Learner[Prepared, Tables, Running]):
    """A master calls one of three options: a SARSA(lambda) agent, a pit specialist and a rule-based agent.

    As described (thesis 4.2.1): these three; the specialist concerns itself only with pits, and is there only if one
    is within four tiles of Mario; the master learns by SMDP Q-learning which to call. An option o that ran from s to s'
    for k steps moves

        Q(s, o) towards  r_1 + g r_2 + .. + g^(k-1) r_k + g^k max_o' Q(s', o').

    The rest is this library's reading. The master's state says whether a pit is within four tiles, a wall or a monster
    near (`hrljax.envs.mario.nearby.dangers`), and whether Mario stands on the ground; an option runs until that
    changes. SARSA(lambda) sees the three nearest monsters or pits, the specialist the next pit, the ground and Mario's
    speed, and learns by SARSA too; each learns from its own steps. The rules are the sample agent's.

    Attributes:
        step_size: of the master and of the options, in (0, 1].
        epsilon: probability of any option in place of the best one, and within the options of any action.
        discount: in [0, 1].
        trace_decay: lambda.
        trace_length: steps that traces reach back.
    """

    step_size: Hyperparameter = hyperparameter(0.05, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.01, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(0.9, 0, 1)
    trace_decay: Hyperparameter = hyperparameter(0.8, 0, 1)
    trace_length: int = 12

    name = "three options"
    is_tabular = False
    num_words = 3
    num_begin_words = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("trace_length", 1)

    @property
    def sarsa(self) -> RelationalHORDQ:
        return replace(
            self.specialist,
            concepts=NearestThings(3),
            trace_decay=self.trace_decay,
            trace_length=self.trace_length,
        )

    @property
    def specialist(self) -> RelationalHORDQ:
        return RelationalHORDQ(concepts=Pits(), step_size=self.step_size, epsilon=self.epsilon, discount=self.discount)

    def prepare(self, env: AnyEnvironment) -> Prepared:
        env = checks.instance("env", env, Mario, "Mario, hrljax.make('Mario'), for ThreeOptions")
        return Prepared(env, env.num_actions)

    def init(self, env: Mario, prepared: Prepared) -> LearnerState:
        sarsa, specialist = (learner.init(env, prepared) for learner in (self.sarsa, self.specialist))
        none, master = jnp.int32(0), jnp.zeros(16 * len(OPTIONS), jnp.float32)
        running = Running(none, none, jnp.float32(0), jnp.float32(1), sarsa.control, specialist.control, none)
        return LearnerState(Tables(master, sarsa.tables, specialist.tables), running)

    def begin(self, prepared: Prepared, tables: Tables, first: Episode, words: Words, context: Context) -> Running:
        sarsa = self.sarsa.begin(prepared, tables.sarsa, first, words[1:2], context)
        specialist = self.specialist.begin(prepared, tables.specialist, first, words[2:3], context)
        number, pit = situation(prepared.env, first)
        option = self._called(tables.master, number, pit, words[0], context)
        rule = runs_on(prepared.env, first)
        return Running(option, number, jnp.float32(0), jnp.float32(1), sarsa, specialist, rule)

    def action(self, control: Running) -> Array:
        return choices.pick([control.sarsa.action, control.specialist.action, control.rule], control.option)

    def learn(
        self, prepared: Prepared, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        running, tables = state.control, state.tables
        gamma = context.discounted(jnp.asarray(self.discount, jnp.float32))
        reward = running.reward + context.product(running.discount, transition.reward)
        discount = gamma(running.discount)
        after, pit = situation(prepared.env, transition.next_state)
        ends = (after != running.situation) | transition.terminated

        best = choices.greedy(self._values(tables.master, after, pit))[1]
        beyond = lax.select(transition.terminated, jnp.float32(0), best)
        target = td_target(reward, context.discounted(discount), beyond)
        place = running.situation * np.int32(len(OPTIONS)) + running.option
        step_size = jnp.asarray(at_episode(self.step_size, context.episode))
        master = moved(tables.master, [Move(place, target[None], ends)], step_size, context)

        option = lax.select(ends, self._called(master, after, pit, words[0], context), running.option)
        sarsa = self._continued(0, prepared, tables.sarsa, running, transition, words[1], context)
        specialist = self._continued(_SPECIALIST, prepared, tables.specialist, running, transition, words[2], context)
        # What was done before another option ran did not lead here.
        forgets = (option != 0) & jnp.asarray(context.learns)
        trail = sarsa.tables.trail
        trail = trail._replace(length=lax.select(forgets, jnp.int32(0), trail.length))
        tables = Tables(master, sarsa.tables._replace(trail=trail), specialist.tables)
        kept = Running(
            option=option,
            situation=lax.select(ends, after, running.situation),
            reward=lax.select(ends, jnp.float32(0), reward),
            discount=lax.select(ends, jnp.float32(1), discount),
            sarsa=sarsa.control,
            specialist=specialist.control,
            rule=runs_on(prepared.env, transition.next_state),
        )
        return LearnerState(tables, kept)

    def _continued(
        self,
        option: int,
        prepared: Prepared,
        values: Values,
        running: Running,
        transition: Transition,
        word: Array,
        context: Context,
    ) -> LearnerState:
        """An option that learns after a step, which counts if it ran."""
        learner, control = ((self.sarsa, running.sarsa), (self.specialist, running.specialist))[option]
        of_it = context._replace(learns=jnp.asarray(context.learns) & (running.option == option))
        return learner.learn(prepared, LearnerState(values, control), transition, (word,), of_it)

    def _values(self, master: Array, situation: Array, pit: Array) -> list[Array]:
        """Of the options that are there."""
        values = list(take_row(master, situation * np.int32(len(OPTIONS)), len(OPTIONS)))
        values[_SPECIALIST] = lax.select(pit, values[_SPECIALIST], jnp.float32(-np.inf))
        return values

    def _called(self, master: Array, situation: Array, pit: Array, word: Array, context: Context) -> Array:
        """The best option that is there, or with probability epsilon any of these."""
        best = choices.greedy(self._values(master, situation, pit))[0]
        drawn = choices.nth_allowed([jnp.bool_(True), pit, jnp.bool_(True)], word)
        return lax.select(word < threshold(at_episode(self.epsilon, context.episode)), drawn, best)
