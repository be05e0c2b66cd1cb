"""A learned model of Mario by multiway regression trees, as Orange 2 grew them (thesis 4.2.3).

For every action one tree gives Mario's displacement and next velocity together; another, with the action as one more
input, gives the reward, whether the episode ends and, if it is asked for, what comes after. Trees are grown from all
different transitions.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.numerics import put_row, take, take_row
from hrljax.envs.mario.env import Mario
from hrljax.learners.relational.aftermath import after_step, nothing_came, worth_at, worth_of
from hrljax.learners.relational.screen_model import NUM_CHANGES, Experience, Foreseen, ModelTables, ScreenModel
from hrljax.learners.relational.visited import no_rows, place_of
from hrljax.trees.multiway import READINGS, MultiwayTree, MultiwayTrees, predict

Reading = Literal["A", "B", "C", "D"]
_LIKELY = np.float32(0.5)


class Rows(NamedTuple):
    """Different transitions, and how often each was met; the row after the last is written to where nothing is kept."""

    values: Array  # [(N + 1) * width] float32: inputs, action, change, reward, whether it was the last one, last keys
    weights: Array  # [N + 1] float32
    places: Array  # [2^19] int32: by a hash, the number of a row with it
    filled: Array  # int32: rows so far
    memory: Any  # [2^19] int32: by a hash of inputs and actions, the row that was met last; () without memory
    aftermath: Any  # `Aftermath`; () without it
    has_news: Array  # bool: whether there is something that the trees were not fitted to


class Learned(NamedTuple):
    """The fitted trees."""

    motion: MultiwayTrees  # a tree for each action
    outcome: MultiwayTrees


@dataclass(frozen=True)
class MultiwayModel(ScreenModel):
    """Multiway trees, fitted to all different transitions, which foresee ends.

    Attributes:
        reading: how trees are grown, see `hrljax.trees.multiway.READINGS`.
        rows: N, different transitions that are kept; those that come after them are forgotten.
        weighted: whether a transition that was met three times counts as three. If not, trees change only when
            something new was met, and are fitted only then.
        memory: whether a step whose inputs, action and last action have been met is predicted to be what it was when
            they were last met, without the trees; they are asked about all others. Numbers are rounded to a 32nd.
        death_decay: in [0, 1): by how much less a death counts for every step that it came later, where a plan is cut
            off (`hrljax.learners.relational.aftermath`); 0: what comes after a plan does not count.
    """

    rows: int = 60_000
    reading: Reading = "A"
    weighted: bool = True
    memory: bool = False
    death_decay: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_choice("reading", Reading)
        for option in ("weighted", "memory"):
            self._check_flag(option)
        name = f"{type(self).__name__}: death_decay"
        self._set("death_decay", float(checks.number(name, self.death_decay, checks.Interval(0, 1, high_open=True))))

    @cached_property
    def motion_tree(self) -> MultiwayTree:
        return MultiwayTree(self.categories, **READINGS[self.reading])

    def outcome_tree(self, num_actions: int) -> MultiwayTree:
        """Of the reward, of the end and of what comes after."""
        return MultiwayTree((*self.categories, num_actions), **READINGS[self.reading])

    @property
    def _width(self) -> int:
        return self.num_inputs + 1 + NUM_CHANGES + 2 + self.memory

    @property
    def _marks(self) -> bool:
        return self._is_pessimistic and not self.memory

    def empty(self, num_actions: int) -> Rows:
        rows = self.rows + 1
        return Rows(
            values=jnp.zeros(rows * self._width, jnp.float32),
            weights=jnp.zeros(rows, jnp.float32),
            places=no_rows(self.rows),
            filled=jnp.int32(0),
            memory=no_rows(self.rows) if self.memory else (),
            aftermath=nothing_came(self.rows) if self.death_decay else (),
            has_news=jnp.bool_(False),
        )

    def unfitted(self, num_actions: int) -> Learned:
        """Trees that predict 0."""
        outcome = self.outcome_tree(num_actions).unfitted(self.rows, 3 if self.death_decay else 2)
        return Learned(self.motion_tree.unfitted(self.rows, NUM_CHANGES, num_actions + 1), outcome)

    def add(self, replay: Rows, new: Experience, num_actions: int, learns: Array) -> Rows:
        """Counts a transition, where `learns`. Of a last one there is no change."""
        learns = jnp.asarray(learns)
        change = jnp.where(new.terminated, np.float32(0), new.change)
        end = new.terminated.astype(jnp.float32)
        others = [new.action.astype(jnp.float32), *change, new.reward, end]
        others += [new.last_keys.astype(jnp.float32)] * self.memory
        row = jnp.concatenate([new.inputs, jnp.stack(others)])
        bits = lax.bitcast_convert_type(row + np.float32(0), jnp.int32)
        place = place_of(bits)
        known, width = take(replay.places, place), np.int32(self._width)
        is_known = jnp.all(take_row(replay.values, known * width, self._width) == row) & (known < self.rows)
        number = lax.select(is_known, known, lax.min(replay.filled, jnp.int32(self.rows)))
        number = lax.select(learns, number, jnp.int32(self.rows))
        is_new = learns & ~is_known & (replay.filled < self.rows)
        weight = take(replay.weights, number) + np.float32(1)
        memory, aftermath, has_changed = replay.memory, replay.aftermath, jnp.bool_(False)
        if self.memory:
            of_key = place_of(self._key(new.inputs, new.last_keys, new.action))
            before = take(memory, of_key)
            memory = put_row(memory, of_key, lax.select(number < self.rows, number, before)[None])
        if self.death_decay:
            aftermath, has_changed = after_step(aftermath, number, new.reward, new.terminated, self.death_decay, learns)
        return Rows(
            values=put_row(replay.values, number * width, row),
            weights=put_row(replay.weights, number, weight[None]),
            places=put_row(replay.places, place, lax.select(is_new, number, known)[None]),
            filled=replay.filled + is_new.astype(jnp.int32),
            memory=memory,
            aftermath=aftermath,
            has_news=replay.has_news | is_new | has_changed,
        )

    def refit(self, env: Mario, tables: ModelTables) -> ModelTables:
        """Fits the trees to what is kept, if anything has changed."""
        if self.weighted:
            return super().refit(env, tables)
        replay: Rows = tables.replay
        learned = lax.cond(replay.has_news, lambda: self.fit(replay, env.num_actions), lambda: tables.learned)
        return tables._replace(learned=learned, replay=replay._replace(has_news=jnp.bool_(False)))

    def fit(self, replay: Rows, num_actions: int) -> Learned:
        values = replay.values.reshape(-1, self._width)[: self.rows]
        count, f = replay.filled, self.num_inputs
        weights = replay.weights[: self.rows] if self.weighted else None
        inputs, with_action = values[:, :f], values[:, : f + 1]
        action, change, outcome = values[:, f].astype(jnp.int32), values[:, f + 1 : f + 5], values[:, f + 5 : f + 7]
        group = jnp.where(outcome[:, 1] > 0, np.int32(num_actions), action)
        if self.death_decay:
            outcome = jnp.concatenate([outcome, worth_of(replay.aftermath)[:, None]], axis=1)
        return Learned(
            motion=self.motion_tree.fit(inputs, change, weights, group, num_actions + 1, count),
            outcome=self.outcome_tree(num_actions).fit(with_action, outcome, weights, count=count),
        )

    def foreseen(self, tables: ModelTables, inputs: Array, last_keys: Array, action: Array) -> Foreseen:
        def by_trees() -> Array:
            """Change, reward, end and what comes after."""
            with_action = jnp.concatenate([inputs, action.astype(jnp.float32)[None]])
            learned: Learned = tables.learned
            return jnp.concatenate([predict(learned.motion, inputs, action), predict(learned.outcome, with_action)])

        is_met = None
        if self.memory:
            is_met, remembered = self._remembered(tables.replay, inputs, last_keys, action)
            predicted = lax.cond(is_met, lambda: remembered, by_trees)
        else:
            predicted = by_trees()
        beyond = predicted[NUM_CHANGES + 2] if self.death_decay else None
        return Foreseen(
            list(predicted[:NUM_CHANGES]), predicted[NUM_CHANGES], predicted[NUM_CHANGES + 1] > _LIKELY, beyond, is_met
        )

    def _key(self, inputs: Array, last_keys: Array, action: Array) -> Array:
        """By what a step is remembered, int32 ``[F + 2]``."""
        return jnp.append(self._rounded(inputs, action), last_keys)

    def _remembered(self, replay: Rows, inputs: Array, last_keys: Array, action: Array) -> tuple[Array, Array]:
        """Whether a step was met, and what it brought when it was met last."""
        f, key = self.num_inputs, self._key(inputs, last_keys, action)
        number = take(replay.memory, place_of(key))
        row = take_row(replay.values, number * np.int32(self._width), self._width)
        its_key = self._key(row[:f], row[-1].astype(jnp.int32), row[f].astype(jnp.int32))
        outcome = row[f + 1 : f + 7]
        if self.death_decay:
            outcome = jnp.append(outcome, worth_at(replay.aftermath, number))
        return (number < self.rows) & jnp.all(its_key == key), outcome
