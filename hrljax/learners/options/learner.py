"""Learning over options: SMDP Q-learning and intra-option Q-learning (Sutton, Precup and Singh 1999)."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.core.numerics import exact_product, put_row, take_row
from hrljax.core.random import threshold
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.layout import Kind, TaskGraph
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.hierarchy.tables import TaskTables, state_in_words
from hrljax.learners import updates
from hrljax.learners.base import Experience, Learner, LearnerState, Moment
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.options.definition import Options

Update = Literal["smdp", "intra_option"]


class Running(NamedTuple):
    """The option that runs."""

    option: Array  # int32
    action: Array  # int32: what it does now
    state: Array  # int32: where it was initiated
    reward: Array  # float32: discounted sum of its rewards so far
    discount: Array  # float32: discount to the power of its steps so far


@dataclass(frozen=True, eq=False)
class OptionTables:
    """What a step reads of the options: one row for each state."""

    rows: np.ndarray  # [S * O] int32: action (-1 if the option cannot run here) << 2 | terminates << 1 | can begin
    num_options: int
    initiation: np.ndarray  # [O, S] bool
    graph: TaskGraph  # for exact evaluation

    def row(self, state: Array) -> Array:
        return take_row(jnp.asarray(self.rows), state * self.num_options, self.num_options)


@dataclass(frozen=True)
class OptionQ(Learner):
    """Q-learning over options, called and followed until they terminate.

    `"smdp"` learns the value of an option when it terminates, from the rewards since it was
    initiated (Sutton, Precup and Singh 1999, section 3.2; Bradtke and Duff 1995). An option that
    the end of an episode's steps cuts off is not learned from. `"intra_option"` learns in every step
    of every option that would have taken the same action (section 6): the value of going on
    bootstraps on the option itself, that of terminating on the best option that can begin.

    Attributes:
        options: what can be called, `hrljax.options_from` or arrays of your own.
        update: ``"smdp"`` or ``"intra_option"``.
        step_size: in (0, 1], or a schedule of the episode.
        epsilon: probability of a uniformly random option at every choice, or a schedule of the episode.
        discount: in [0, 1], of a primitive step.
        initial_value: of every state and option.
    """

    options: Options
    update: Update = field(default="smdp", kw_only=True)
    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)

    name = "options"
    num_words = 1
    num_begin_words = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.instance("OptionQ: options", self.options, Options, "Options such as options_from(...)")
        self._check_choice("update", Update)

    def prepare(self, env: AnyTabularEnvironment) -> OptionTables:
        """Raises ValueError if the options are not over the environment, or in some state none can begin."""
        return option_tables(self.options, env)

    def init(self, env: AnyTabularEnvironment, prepared: OptionTables) -> LearnerState:
        """Tables: ``[S * O]`` float32 values of options, state by state."""
        none, value = jnp.int32(0), jnp.asarray(self.initial_value, jnp.float32)
        control = Running(none, none, none, jnp.float32(0), jnp.float32(1))
        return LearnerState(jnp.full(env.num_states * prepared.num_options, value), control)

    def begin(
        self, prepared: OptionTables, tables: Array, first: Array, words: tuple[Array, ...], moment: Moment
    ) -> Running:
        return self._called(prepared, tables, first, words[0], moment)

    def action(self, control: Running) -> Array:
        return control.action

    def learn(
        self, prepared: OptionTables, state: LearnerState, step: Experience, words: tuple[Array, ...], moment: Moment
    ) -> LearnerState:
        q, running = state
        count, after = prepared.num_options, step.next_state
        discount = at_episode(self.discount, moment.episode)
        there = prepared.row(after)
        ends = (there & 2) != 0
        running = running._replace(
            reward=running.reward + exact_product(running.discount, step.reward, moment.zero),
            discount=exact_product(discount, running.discount, moment.zero),
        )
        over = _entry(ends, running.option) | step.terminated
        following = take_row(q, after * count, count)
        is_called = over & ~step.terminated  # some option is
        needed = is_called if self.update == "smdp" else ~step.terminated
        best = lax.cond(needed, lambda: _best(following, there)[1], lambda: jnp.float32(0))
        step_size = at_episode(self.step_size, moment.episode)
        if self.update == "smdp":
            place = running.state * count + running.option
            old = take_row(q, place, 1)
            target = updates.td_target(running.reward, running.discount, best, moment.zero)[None]
            learns = over & moment.live
        else:
            place = step.state * count
            old = take_row(q, place, count)
            goes_on = ~ends & ~step.terminated
            follows = lax.select(goes_on, following, jnp.broadcast_to(best, following.shape))
            target = updates.td_target(step.reward, discount, follows, moment.zero)
            learns = ((prepared.row(step.state) >> 2) == step.action) & moment.live
        q = put_row(q, place, updates.increment(old, target, step_size, learns, moment.zero))
        control = lax.cond(
            is_called,
            lambda: self._called(prepared, q, after, words[0], moment),
            lambda: running._replace(action=_entry(there >> 2, running.option)),
        )
        return LearnerState(q, control)

    def greedy_policy(
        self, env: AnyTabularEnvironment, prepared: OptionTables, tables: Array, zero: Array
    ) -> HierarchicalPolicy:
        q = tables.reshape(-1, prepared.num_options).T
        can_begin = jnp.asarray(prepared.initiation)
        called = jnp.argmax(jnp.where(can_begin, q, jnp.full_like(q, -np.inf)), axis=0).astype(jnp.int32)
        inside = np.maximum(self.options.policy, 0)
        slots = jnp.concatenate([called[None], jnp.asarray(inside)])
        return HierarchicalPolicy(prepared.graph, slots, None)

    def _called(self, prepared: OptionTables, q: Array, state: Array, word: Array, moment: Moment) -> Running:
        """The option that is called in a state."""
        here, count = prepared.row(state), prepared.num_options
        greedy = _best(take_row(q, state * count, count), here)[0]
        can_begin = [(here[o] & 1) != 0 for o in range(count)]
        explores = word < threshold(at_episode(self.epsilon, moment.episode))
        option = lax.select(explores, choices.nth_allowed(can_begin, word), greedy)
        return Running(option, _entry(here >> 2, option), state, jnp.float32(0), jnp.float32(1))


def _entry(row: Array, index: Array) -> Array:
    """``row[index]`` of a short row."""
    return choices.pick([row[i] for i in range(len(row))], index)


def _best(values: Array, row: Array) -> tuple[Array, Array]:
    """The best option (int32) that can begin, and its value."""
    never = jnp.float32(-np.inf)
    return choices.greedy([lax.select((row[o] & 1) != 0, values[o], never) for o in range(len(values))])


def option_tables(options: Options, env: AnyTabularEnvironment) -> OptionTables:
    """The options as rows, and as the subtasks of a root that picks one and lets it run.

    Raises:
        ValueError: actions or the number of states differ from the environment's, or no option can
            begin in a state in which one may have to be called.
    """
    if options.actions != env.action_names:
        raise ValueError(f"the options are over actions {options.actions}, {env.name} has {env.action_names}")
    if options.num_states != env.num_states:
        raise ValueError(f"the options are over {options.num_states} states, {env.name} has {env.num_states}")
    policy, termination, initiation = options.with_primitives()
    rows = (policy << 2) | (termination.astype(np.int32) << 1) | initiation.astype(np.int32)
    if not options.primitives:
        _check_always_one(options, env)
    own, of_root = len(options.names), options.num_primitives
    none = (-1,)
    actions = tuple(range(of_root)) + none * own
    root = Kind(actions, none * of_root + tuple(range(1, own + 1)))
    plain = Kind(tuple(range(env.num_actions)), none * env.num_actions)
    active = np.concatenate([np.ones((1, env.num_states), np.bool_), ~options.termination])
    # A value needs of the tables only where subtasks go on.
    unused = {name: np.zeros(0) for name in TaskTables.__dataclass_fields__ if name != "active"}
    tables = TaskTables(active, **unused)
    levels = ((0,), tuple(range(1, own + 1))) if own else ((0,),)
    kind_of = (0,) + (1,) * own
    graph = TaskGraph(tables, env.num_states, env.num_actions, 0, (root, plain), kind_of, levels)
    return OptionTables(np.ascontiguousarray(rows.T).ravel(), options.num_options, initiation, graph)


def _check_always_one(options: Options, env: AnyTabularEnvironment) -> None:
    """Follows the options from every first state, and raises where one has to be called and none can begin."""
    successors = env.model().successors()
    calls = list(np.flatnonzero(env.initial_distribution()))
    called = set(calls)
    seen: set[tuple[int, int]] = set()
    while calls:
        start = int(calls.pop())
        startable = np.flatnonzero(options.initiation[:, start])
        if not len(startable):
            raise ValueError(f"no option can be initiated in {state_in_words(env, start)}")
        runs = [(int(o), start) for o in startable]
        while runs:
            option, state = runs.pop()
            if (option, state) in seen:
                continue
            seen.add((option, state))
            for after in successors[state, options.policy[option, state]]:
                if after < 0:
                    continue
                if not options.termination[option, after]:
                    runs.append((option, int(after)))
                elif after not in called:
                    called.add(after)
                    calls.append(after)
