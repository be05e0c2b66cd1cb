"""Relational temporal-difference learning in Mario, alone or under a root that plans (thesis 4.2.4-4.2.5).

Concepts are the things on the screen as (type, dx, dy) in whole tiles from Mario. The value of an
action is linear: a weight for every concept and action, times how often the concept occurs, and a
weight that always counts, the action's own or one for all actions (Asgharbeygi, Stracuzzi and Langley 2006).

The root suggests an action t; its one subtask Action(t) takes one primitive action and ends, so its
Q_c is 0, and its pseudo-reward is exactly a bonus for following the root, which biases the choice
and never enters the values.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import chex
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.core.numerics import put_row, take, take_row
from hrljax.envs.base import AnyEnvironment
from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.env import Mario
from hrljax.learners.base import Context, Learner, LearnerState, Transition, Words
from hrljax.learners.fading import Fading, Seen
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.relational.concepts import Concepts, ConceptSet, ThingsOnScreen
from hrljax.learners.relational.search_root import Plan, PlanningRoot
from hrljax.learners.roots.base import Decision
from hrljax.learners.updates import td_target

Bootstrap = Literal["on_policy", "greedy"]
Bias = Literal["own", "shared"]


class Trail(NamedTuple):
    """The last L updates that eligibility reaches back to, in a ring."""

    cells: Array  # [L, most that hold] int32
    counts: Array  # [L] int32
    actions: Array  # [L] int32
    length: Array  # int32: entries of this episode


class Tables(NamedTuple):
    """What a relational learner has learned."""

    weights: Array  # [(concepts + 1) * A] float32; the last row always counts; only its first entry if shared
    trail: Trail | None  # None without traces
    root: chex.ArrayTree  # of the root; () without one
    seen: Seen | None = None  # what a pseudo-reward that fades goes by, concept by concept


Suggestion: TypeAlias = "Decision[Plan] | None"
"""What the root suggested last; None without a root."""


class Control(NamedTuple):
    """What the agent is about to do."""

    action: Array  # int32
    decision: Suggestion


class Prepared(NamedTuple):
    env: Mario
    num_actions: int


@dataclass(frozen=True)
class RelationalHORDQ(Learner[Prepared, Tables, Control]):
    """HORDQ with relational features in the one subtask Action(t), under a root that plans (thesis 4.2.5).

    With a pseudo-reward of 0 it is relational SARSA; with a very large one it follows its root.

    Attributes:
        root: what suggests actions; None for relational SARSA alone.
        pseudo_reward: bonus for the suggested action when choosing; a number, a schedule of the episode or
            `hrljax.Fading`, by how often the least known of the concepts that hold has occurred.
        step_size: in (0, 1], or a schedule; for every concept that holds.
        epsilon: probability of a random action, or a schedule. Else it takes the best one, of equally good ones
            the first.
        discount: in [0, 1].
        trace_decay: lambda of accumulating traces, in [0, 1]; needs a `trace_length`.
        trace_length: steps that traces reach back, 0 for none (static).
        initial_value: of every action at first.
        concepts: what has weights: the thesis's things on the screen, or others of
            `hrljax.learners.relational.concepts`.
        bootstrap: ``"on_policy"`` on the action taken next (SARSA), ``"greedy"`` on the best action
            without the bonus.
        bias: the weight that always counts is every action's ``"own"``, or one is ``"shared"`` by all: then actions
            differ only by what the concepts that hold say of them, and where none does, the root is followed.
    """

    root: PlanningRoot | None = None
    pseudo_reward: "Hyperparameter | Fading" = hyperparameter(0.0, schedule=True, settings=Fading)
    step_size: Hyperparameter = hyperparameter(0.05, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.01, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(0.7, 0, 1)
    trace_decay: Hyperparameter = hyperparameter(0.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)
    trace_length: int = 0
    bootstrap: Bootstrap = "on_policy"
    bias: Bias = "own"
    concepts: ConceptSet = ThingsOnScreen()

    name = "relational HORDQ"
    is_tabular = False
    num_words = 1
    num_begin_words = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.root is not None:
            checks.instance("RelationalHORDQ: root", self.root, PlanningRoot, "None, a SearchRoot or an AStarRoot")
        checks.instance("RelationalHORDQ: concepts", self.concepts, ConceptSet, "ThingsOnScreen() or NearestThings()")
        self._check_choice("bootstrap", Bootstrap)
        self._check_choice("bias", Bias)
        self._check_integer("trace_length", 0)

    @property
    def planning_interval(self) -> int:
        return 0 if self.root is None else self.root.planning_interval

    def prepare(self, env: AnyEnvironment) -> Prepared:
        env = checks.instance("env", env, Mario, "Mario, hrljax.make('Mario'), for RelationalHORDQ")
        return Prepared(env, env.num_actions)

    def init(self, env: Mario, prepared: Prepared) -> LearnerState:
        actions = prepared.num_actions
        weights = jnp.zeros((self.concepts.num + 1) * actions, jnp.float32)
        initial = jnp.broadcast_to(jnp.asarray(self.initial_value, jnp.float32), (actions,))
        weights = put_row(weights, jnp.int32(self.concepts.num * actions), initial)
        trail: Trail | None = None
        if self.trace_length:
            places = jnp.zeros(self.trace_length, jnp.int32)
            cells = jnp.zeros((self.trace_length, self.concepts.most), jnp.int32)
            trail = Trail(cells, places, places, jnp.int32(0))
        root: chex.ArrayTree = () if self.root is None else self.root.init(prepared.env)
        seen = (
            self.pseudo_reward.nothing_seen(self.concepts.num + 1) if isinstance(self.pseudo_reward, Fading) else None
        )
        return LearnerState(Tables(weights, trail, root, seen), Control(jnp.int32(0), None))

    def begin(self, prepared: Prepared, tables: Tables, first: Episode, words: Words, context: Context) -> Control:
        decision: Suggestion = None
        if self.root is not None:
            decision = self.root.begin(prepared.env, tables.root, first, context)
        concepts = self.concepts.held(prepared.env, first)
        values = self._values(prepared, tables.weights, concepts)
        bonus = self._bonus(tables.seen, concepts, context)
        return Control(self._choose(values, bonus, decision, words[0], context), decision)

    def action(self, control: Control) -> Array:
        return control.action

    def learn(
        self, prepared: Prepared, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        tables: Tables = state.tables
        decision, root = state.control.decision, tables.root
        discount = jnp.asarray(at_episode(self.discount, context.episode))
        if self.root is not None and decision is not None:
            # Action(t) ends with every step.
            root, decision = self.root.step(
                prepared.env, root, decision, transition, True, discount, transition.next_state, context
            )
        before, after = (self.concepts.held(prepared.env, at) for at in (transition.state, transition.next_state))
        values = self._values(prepared, tables.weights, after)
        action = self._choose(values, self._bonus(tables.seen, after, context), decision, words[0], context)
        q_next = choices.pick(values, action) if self.bootstrap == "on_policy" else choices.greedy(values)[1]
        q_next = lax.select(transition.terminated, jnp.float32(0), q_next)
        target = td_target(transition.reward, context.discounted(discount), q_next)
        old = choices.pick(self._values(prepared, tables.weights, before), transition.action)
        step_size = jnp.asarray(at_episode(self.step_size, context.episode))
        change = context.product(lax.select(jnp.asarray(context.learns), step_size, jnp.float32(0)), target - old)
        if tables.trail is not None:
            trail = _reached(tables.trail, before, transition, self.trace_length, context.learns)
            decay = context.product(discount, jnp.asarray(self.trace_decay, jnp.float32))
            weights = self._along(prepared, tables.weights, trail, change, decay, context)
            is_over = transition.terminated & context.learns
            trail = trail._replace(length=lax.select(is_over, jnp.int32(0), trail.length))
        else:
            trail, weights = None, self._added(prepared, tables.weights, before, transition.action, change)
        seen = self._after_seeing(tables.seen, before, transition, context)
        return LearnerState(Tables(weights, trail, root, seen), Control(action, decision))

    def plan(self, prepared: Prepared, tables: Tables, context: Context) -> Tables:
        if self.root is None:
            return tables
        return tables._replace(root=self.root.plan(prepared.env, tables.root, context))

    def _values(self, prepared: Prepared, weights: Array, concepts: Concepts) -> list[Array]:
        """Value of every action, sums in the order of the list of concepts."""
        cells, count = concepts
        actions = prepared.num_actions

        def add(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            i, total = carry
            return i + 1, total + take_row(weights, cells[i] * np.int32(actions), actions)

        alone = take_row(weights, jnp.int32(self.concepts.num * actions), actions)
        alone = jnp.broadcast_to(alone[0], alone.shape) if self.bias == "shared" else alone
        _, total = lax.while_loop(lambda carry: carry[0] < count, add, (jnp.int32(0), alone))
        return [total[a] for a in range(actions)]

    def _added(self, prepared: Prepared, weights: Array, concepts: Concepts, action: Array, change: Array) -> Array:
        """The weights after adding `change` to each concept's, once for every time that it occurs."""
        cells, count = concepts
        actions = np.int32(prepared.num_actions)

        def add(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            i, weights = carry
            cell = lax.select(i < 0, jnp.int32(self.concepts.num), cells[lax.max(i, jnp.int32(0))])
            place = cell * actions + action
            if self.bias == "shared":
                place = lax.min(place, jnp.int32(self.concepts.num) * actions)
            return i + 1, put_row(weights, place, take_row(weights, place, 1) + change)

        return lax.while_loop(lambda carry: carry[0] < count, add, (jnp.int32(-1), weights))[1]

    def _along(
        self, prepared: Prepared, weights: Array, trail: Trail, change: Array, decay: Array, context: Context
    ) -> Array:
        """The weights after a change along the trail, less and less (accumulating traces)."""
        length = np.int32(self.trace_length)

        def add(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            back, weights, change = carry
            at = (trail.length - 1 - back) % length
            concepts = (trail.cells[at], trail.counts[at])
            weights = self._added(prepared, weights, concepts, trail.actions[at], change)
            return back + 1, weights, context.product(decay, change)

        reach = lax.min(trail.length, jnp.int32(length))
        return lax.while_loop(lambda carry: carry[0] < reach, add, (jnp.int32(0), weights, change))[1]

    def _after_seeing(
        self, seen: Seen | None, concepts: Concepts, transition: Transition, context: Context
    ) -> Seen | None:
        """What the pseudo-reward goes by after a step in which concepts held."""
        if seen is None or not isinstance(self.pseudo_reward, Fading):
            return None
        cells, count = concepts
        once = jnp.asarray(context.learns).astype(jnp.float32)

        def add(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            i, visits = carry
            return i + 1, put_row(visits, cells[i], take_row(visits, cells[i], 1) + once)

        # The action alone is a concept that always holds.
        counted = self.pseudo_reward.after_seeing(seen, jnp.int32(self.concepts.num), transition.reward, context)
        return counted._replace(visits=lax.while_loop(lambda c: c[0] < count, add, (jnp.int32(0), counted.visits))[1])

    def _bonus(self, seen: Seen | None, concepts: Concepts, context: Context) -> Array:
        """The pseudo-reward where concepts hold."""
        if seen is None or not isinstance(self.pseudo_reward, Fading):
            return jnp.asarray(at_episode(self.pseudo_reward, context.episode))
        cells, count = concepts
        visits = seen.visits

        def least(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            i, fewest = carry
            return i + 1, lax.min(fewest, take(visits, cells[i]))

        start = jnp.int32(0), visits[self.concepts.num]
        _, fewest = lax.while_loop(lambda carry: carry[0] < count, least, start)
        return self.pseudo_reward.at(seen, fewest, context)

    def _choose(self, values: list[Array], bonus: Array, decision: Suggestion, word: Array, context: Context) -> Array:
        """The greedy action, with the bonus for what the root suggests, or with probability epsilon any."""
        if decision is not None:
            no_bonus = jnp.float32(0)
            values = [value + lax.select(decision.task == a, bonus, no_bonus) for a, value in enumerate(values)]
        best = choices.greedy(values)[0]
        return choices.epsilon_greedy(best, len(values), word, at_episode(self.epsilon, context.episode))


def _reached(trail: Trail, concepts: Concepts, transition: Transition, length: int, learns: Array) -> Trail:
    """The trail with one more step, where `learns`."""
    at = trail.length % np.int32(length)
    cells, counts, actions = (
        lax.select(jnp.broadcast_to(learns, new.shape), new, old[at])
        for new, old in zip((*concepts, transition.action), trail[:3], strict=True)
    )
    return Trail(
        cells=lax.dynamic_update_slice(trail.cells, cells[None], (at, jnp.int32(0))),
        counts=put_row(trail.counts, at, counts[None]),
        actions=put_row(trail.actions, at, actions[None]),
        length=trail.length + jnp.asarray(learns).astype(jnp.int32),
    )
