"""Relational temporal-difference learning in Mario, alone or under a root that plans (thesis 4.2.4-4.2.5).

Concepts are the things on the screen as (type, dx, dy) in whole tiles from Mario. The value of an
action is linear: a weight for every concept and action, times how often the concept occurs, and a
weight for the action alone (Asgharbeygi, Stracuzzi and Langley 2006).

The root suggests an action t; its one subtask Action(t) takes one primitive action and ends, so its
Q_c is 0, and its pseudo-reward is exactly a bonus for following the root, which biases the choice
and never enters the values.
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.core.numerics import exact_product, put_row, take_row
from hrljax.envs.mario.engine.state import MAX_SPRITES
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.features import NUM_OBJECT_CELLS, object_cells, objects
from hrljax.learners import updates
from hrljax.learners.base import Experience, Learner, LearnerState, Moment
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.relational.search_root import SearchRoot

Bootstrap = Literal["on_policy", "greedy"]
Concepts = tuple[Array, Array]
"""Numbers of the concepts that hold (int32 [MAX_SPRITES], those that do first) and how many they are (int32)."""


class Trail(NamedTuple):
    """The last L updates that eligibility reaches back to, in a ring."""

    cells: Array  # [L, MAX_SPRITES] int32
    counts: Array  # [L] int32
    actions: Array  # [L] int32
    length: Array  # int32: entries of this episode


class Tables(NamedTuple):
    """What a relational learner has learned."""

    weights: Array  # [(concepts + 1) * A] float32; the last row belongs to the action alone
    trail: Any  # Trail, or () without traces
    root: Any  # SearchTables, or () without a root


class Control(NamedTuple):
    """What the agent is about to do."""

    action: Array  # int32
    plan: Any  # what is left of the root's plan, or () without a root


class Prepared(NamedTuple):
    env: Mario
    num_actions: int


@dataclass(frozen=True)
class RelationalHORDQ(Learner):
    """HORDQ with relational features in the one subtask Action(t), under a root that plans (thesis 4.2.5).

    With a pseudo-reward of 0 it is relational SARSA; with a very large one it follows its root.

    Attributes:
        root: what suggests actions; None for relational SARSA alone.
        pseudo_reward: bonus for the suggested action when choosing, or a schedule of the episode.
        step_size: in (0, 1], or a schedule; for every concept that holds.
        epsilon: probability of a random action, or a schedule.
        discount: in [0, 1].
        trace_decay: lambda of accumulating traces, in [0, 1]; needs a `trace_length`.
        trace_length: steps that traces reach back, 0 for none (static).
        initial_value: of every action at first.
        bootstrap: ``"on_policy"`` on the action taken next (SARSA), ``"greedy"`` on the best action
            without the bonus.
    """

    root: SearchRoot | None = None
    pseudo_reward: Hyperparameter = hyperparameter(0.0, schedule=True)
    step_size: Hyperparameter = hyperparameter(0.05, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.01, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(0.7, 0, 1)
    trace_decay: Hyperparameter = hyperparameter(0.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)
    trace_length: int = 0
    bootstrap: Bootstrap = "on_policy"

    name = "relational HORDQ"
    is_tabular = False
    num_words = 1
    num_begin_words = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.root is not None:
            checks.instance("RelationalHORDQ: root", self.root, SearchRoot, "None or a SearchRoot")
        self._check_choice("bootstrap", Bootstrap)
        self._check_integer("trace_length", 0)

    @property
    def planning_interval(self) -> int:
        return 0 if self.root is None else self.root.refit_interval

    def prepare(self, env: Any) -> Prepared:
        checks.instance("env", env, Mario, "Mario, hrljax.make('Mario'), for RelationalHORDQ")
        return Prepared(env, env.num_actions)

    def init(self, env: Any, prepared: Prepared) -> LearnerState:
        actions = prepared.num_actions
        weights = jnp.zeros((NUM_OBJECT_CELLS + 1) * actions, jnp.float32)
        initial = jnp.broadcast_to(jnp.asarray(self.initial_value, jnp.float32), (actions,))
        weights = put_row(weights, jnp.int32(NUM_OBJECT_CELLS * actions), initial)
        trail: Any = ()
        if self.trace_length:
            places = jnp.zeros(self.trace_length, jnp.int32)
            cells = jnp.zeros((self.trace_length, MAX_SPRITES), jnp.int32)
            trail = Trail(cells, places, places, jnp.int32(0))
        root: Any = () if self.root is None else self.root.init(prepared.env)
        plan: Any = () if self.root is None else self.root.no_plan()
        return LearnerState(Tables(weights, trail, root), Control(jnp.int32(0), plan))

    def begin(
        self, prepared: Prepared, tables: Tables, first: Any, words: tuple[Array, ...], moment: Moment
    ) -> Control:
        plan: Any = ()
        suggested = None
        if self.root is not None:
            plan = self.root.advise(prepared.env, tables.root, self.root.no_plan(), first, jnp.bool_(True))
            suggested = plan.action
        values = self._values(prepared, tables.weights, _concepts(first))
        return Control(self._choose(values, suggested, words[0], moment), plan)

    def action(self, control: Control) -> Array:
        return control.action

    def learn(
        self, prepared: Prepared, state: LearnerState, step: Experience, words: tuple[Array, ...], moment: Moment
    ) -> LearnerState:
        tables, control = state
        plan, suggested, root = control.plan, None, tables.root
        if self.root is not None:
            root = self.root.observe(prepared.env, tables.root, step, moment)
            # Decides with the trees, which a step does not change.
            asked = ~step.terminated & moment.live
            plan = self.root.advise(prepared.env, tables.root, control.plan, step.next_state, asked)
            suggested = plan.action
        before = _concepts(step.state)
        values = self._values(prepared, tables.weights, _concepts(step.next_state))
        action = self._choose(values, suggested, words[0], moment)
        follows = choices.pick(values, action) if self.bootstrap == "on_policy" else choices.greedy(values)[1]
        follows = lax.select(step.terminated, jnp.float32(0), follows)
        target = updates.td_target(step.reward, at_episode(self.discount, moment.episode), follows, moment.zero)
        old = choices.pick(self._values(prepared, tables.weights, before), step.action)
        size = lax.select(
            jnp.asarray(moment.live), jnp.asarray(at_episode(self.step_size, moment.episode)), jnp.float32(0)
        )
        change = exact_product(size, target - old, moment.zero)
        if self.trace_length:
            trail = _reached(tables.trail, before, step, self.trace_length, moment.live)
            decay = exact_product(
                jnp.asarray(at_episode(self.discount, moment.episode)),
                jnp.asarray(self.trace_decay, jnp.float32),
                moment.zero,
            )
            weights = self._along(prepared, tables.weights, trail, change, decay, moment)
            trail = trail._replace(length=lax.select(step.terminated & moment.live, jnp.int32(0), trail.length))
        else:
            trail, weights = (), self._added(prepared, tables.weights, before, step.action, change)
        return LearnerState(Tables(weights, trail, root), Control(action, plan))

    def plan(self, prepared: Prepared, tables: Tables, moment: Moment) -> Tables:
        if self.root is None:
            return tables
        return tables._replace(root=self.root.refit(prepared.env, tables.root, moment))

    def _values(self, prepared: Prepared, weights: Array, concepts: Concepts) -> list[Array]:
        """Value of every action, sums in the order of the list of concepts."""
        cells, count = concepts
        actions = prepared.num_actions

        def add(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            i, total = carry
            return i + 1, total + take_row(weights, cells[i] * np.int32(actions), actions)

        alone = take_row(weights, jnp.int32(NUM_OBJECT_CELLS * actions), actions)
        _, total = lax.while_loop(lambda carry: carry[0] < count, add, (jnp.int32(0), alone))
        return [total[a] for a in range(actions)]

    def _added(self, prepared: Prepared, weights: Array, concepts: Concepts, action: Array, change: Array) -> Array:
        """The weights after adding `change` to each concept's, once for every time that it occurs."""
        cells, count = concepts
        actions = np.int32(prepared.num_actions)

        def add(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            i, weights = carry
            cell = lax.select(i < 0, jnp.int32(NUM_OBJECT_CELLS), cells[lax.max(i, jnp.int32(0))])
            place = cell * actions + action
            return i + 1, put_row(weights, place, take_row(weights, place, 1) + change)

        return lax.while_loop(lambda carry: carry[0] < count, add, (jnp.int32(-1), weights))[1]

    def _along(
        self, prepared: Prepared, weights: Array, trail: Trail, change: Array, decay: Array, moment: Moment
    ) -> Array:
        """The weights after a change along the trail, less and less (accumulating traces)."""
        length = np.int32(self.trace_length)

        def add(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            back, weights, change = carry
            at = (trail.length - 1 - back) % length
            concepts = (trail.cells[at], trail.counts[at])
            weights = self._added(prepared, weights, concepts, trail.actions[at], change)
            return back + 1, weights, exact_product(decay, change, moment.zero)

        reach = lax.min(trail.length, jnp.int32(length))
        return lax.while_loop(lambda carry: carry[0] < reach, add, (jnp.int32(0), weights, change))[1]

    def _choose(self, values: list[Array], suggested: Array | None, word: Array, moment: Moment) -> Array:
        if suggested is not None:
            bonus = jnp.asarray(at_episode(self.pseudo_reward, moment.episode))
            nothing = jnp.float32(0)
            values = [value + lax.select(suggested == a, bonus, nothing) for a, value in enumerate(values)]
        return choices.epsilon_greedy(
            choices.greedy(values)[0], len(values), word, at_episode(self.epsilon, moment.episode)
        )


def _concepts(episode: Any) -> Concepts:
    """The concepts that hold now, packed to the front."""
    seen = objects(episode.world.player, episode.world.sprites, episode.world.num_sprites)
    cells, listed = object_cells(seen), seen.mask

    def pack(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        packed, count = carry
        return put_row(packed, count, cells[i][None]), count + listed[i].astype(jnp.int32)

    start = (jnp.zeros(len(cells) + 1, jnp.int32), jnp.int32(0))
    packed, count = lax.fori_loop(jnp.int32(0), episode.world.num_sprites, pack, start)
    return packed[: len(cells)], count


def _reached(trail: Trail, concepts: Concepts, step: Experience, length: int, live: Array) -> Trail:
    """The trail with one more step, where `live`."""
    at = trail.length % np.int32(length)
    cells, counts, actions = (
        lax.select(jnp.broadcast_to(live, new.shape), new, old[at])
        for new, old in zip((*concepts, step.action), trail[:3], strict=True)
    )
    return Trail(
        cells=lax.dynamic_update_slice(trail.cells, cells[None], (at, jnp.int32(0))),
        counts=put_row(trail.counts, at, counts[None]),
        actions=put_row(trail.actions, at, actions[None]),
        length=trail.length + jnp.asarray(live).astype(jnp.int32),
    )
