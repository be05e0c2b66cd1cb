"""H-DYNA: planning on abstract models, those of options, beside the model of actions."""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.counting import count
from hrljax.core.numerics import put_row, take, take_row
from hrljax.core.random import word_block
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.hyperparameters import at_episode
from hrljax.learners.options.learner import OptionQ, OptionTables, Running, best_option
from hrljax.learners.updates import Move, moved, td_target

Models = Literal["all", "abstract"]


class AbstractModels(NamedTuple):
    """What was learned, for P = S * O pairs ``state * O + option``."""

    values: Array  # [P] float32
    reward: Array  # [P] float32: what the option earned when it was last called there, discounted
    discount: Array  # [P] float32: to the power of its steps; 0 if the episode terminated
    after: Array  # [P] int32: where it ended
    seen: Array  # [P] bool
    visited: Array  # [P] int32: pairs in the order of their first ends
    num_visited: Array  # int32


@dataclass(frozen=True)
class HDyna(OptionQ):
    """H-DYNA (Singh 1992) over given subtasks: Dyna on a hierarchy of models that abstract from time.

    An option's model is its last outcome in a state: the reward R until it ended, in N steps, and the state s' there.
    With primitive actions as options, theirs is the model of Dyna-Q. After every real step, from which values are
    learned as by `hrljax.OptionQ`, `planning_steps` pairs that were seen are drawn uniformly and backed up:

        Q(s, o) <- Q(s, o) + alpha [ R + g^N max_o' Q(s', o') - Q(s, o) ]

    Singh learned the subtasks first and then their models; here the subtasks' policies are given as `Options`. With
    `discount` as a schedule, models keep the discount of when they were learned.

    Attributes:
        options, update, step_size, epsilon, discount, initial_value, ties: as those of `hrljax.OptionQ`.
        planning_steps: backups after every real step, at least 0; 0 gives `hrljax.OptionQ` bit for bit.
        models: ``"all"``, or ``"abstract"``: without those of primitive actions.
    """

    planning_steps: int = 10
    models: Models = "all"

    name = "H-DYNA"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("planning_steps", 0)
        self._check_choice("models", Models)

    @property
    def num_words(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride] (depends on a field)
        return 3 if self.planning_steps else 1

    def init(self, env: AnyTabularEnvironment, prepared: OptionTables) -> LearnerState:
        values, control = super().init(env, prepared)
        pairs = len(values)
        numbers, places = jnp.zeros(pairs, jnp.float32), jnp.zeros(pairs, jnp.int32)
        tables = AbstractModels(values, numbers, numbers, places, jnp.zeros(pairs, jnp.bool_), places, jnp.int32(0))
        return LearnerState(tables, control)

    def begin(self, prepared: OptionTables, tables: Any, first: Array, words: Words, context: Context) -> Running:
        return super().begin(prepared, tables.values, first, words, context)

    def learn(
        self, prepared: OptionTables, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        tables: AbstractModels = state.tables
        running, over = self.stepped(prepared, state.control, transition, context)
        values = self.taught(prepared, tables.values, running, over, transition, context)
        tables = tables._replace(values=values)
        if self.planning_steps:
            tables = self._remembered(prepared, tables, running, over, transition, context)
            tables = self._replayed(prepared, tables, words[1:], context)
        control = self.continued(prepared, tables.values, running, over, transition, words[0], context)
        return LearnerState(tables, control)

    def greedy_policy(
        self, env: AnyTabularEnvironment, prepared: OptionTables, tables: Any, context: Context
    ) -> HierarchicalPolicy:
        return super().greedy_policy(env, prepared, tables.values, context)

    def _remembered(
        self,
        prepared: OptionTables,
        tables: AbstractModels,
        running: Running,
        over: Array,
        transition: Transition,
        context: Context,
    ) -> AbstractModels:
        """The models after an option has ended, if it has."""
        pair = running.state * prepared.num_options + running.option
        is_abstract = running.option >= self.options.num_primitives
        counts = over & context.learns & (is_abstract | jnp.bool_(self.models == "all"))
        is_new = counts & ~take(tables.seen, pair)
        discount = lax.select(transition.terminated, jnp.float32(0), running.discount)

        def put(table: Array, place: Array, value: Array, changes: Array) -> Array:
            return put_row(table, place, lax.select(changes, value, take(table, place))[None])

        return tables._replace(
            reward=put(tables.reward, pair, running.reward, counts),
            discount=put(tables.discount, pair, discount, counts),
            after=put(tables.after, pair, transition.next_state, counts),
            seen=put(tables.seen, pair, jnp.bool_(True), counts),
            visited=put(tables.visited, tables.num_visited, pair, is_new),
            num_visited=tables.num_visited + is_new.astype(jnp.int32),
        )

    def _replayed(
        self, prepared: OptionTables, tables: AbstractModels, key: tuple[Array, ...], context: Context
    ) -> AbstractModels:
        drawn, options = word_block((key[0], key[1]), count(), self.planning_steps, 1), prepared.num_options
        step_size = at_episode(self.step_size, context.episode)
        any_seen = tables.num_visited > 0

        def replay(i: Array, values: Array) -> Array:
            which = drawn[i][0] % lax.max(tables.num_visited, jnp.int32(1)).astype(jnp.uint32)
            pair = take(tables.visited, which)
            after, discount = take(tables.after, pair), take(tables.discount, pair)
            best = best_option(take_row(values, after * options, options), prepared.row(after))[1]
            follows = lax.select(discount > 0, best, jnp.float32(0))
            target = td_target(take(tables.reward, pair), context.discounted(discount), follows)
            return moved(values, [Move(pair, target[None], any_seen)], step_size, context)

        values = lax.fori_loop(np.int32(0), np.int32(self.planning_steps), replay, tables.values)
        return tables._replace(values=values)
