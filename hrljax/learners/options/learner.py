"""Learning over options: SMDP Q-learning and intra-option Q-learning (Sutton, Precup and Singh 1999)."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.core.numerics import take_row
from hrljax.core.random import threshold
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.layout import ChildSet, StackLayout
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.hierarchy.tables import state_in_words
from hrljax.learners.base import Context, Learner, LearnerState, Transition, Words
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter, later_option
from hrljax.learners.options.definition import Options
from hrljax.learners.updates import Move, moved, td_target

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
    layout: StackLayout  # for exact evaluation

    def row(self, state: Array) -> Array:
        return take_row(jnp.asarray(self.rows), state * self.num_options, self.num_options)


@dataclass(frozen=True)
class OptionQ(Learner[OptionTables, Array, Running]):
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
        epsilon: probability of a uniformly random option at every choice, or a schedule of the episode. Else
            the best one that can begin.
        discount: in [0, 1], of a primitive step.
        initial_value: of every state and option.
        ties: of equally good options, as of `QLearning`.
    """

    options: Options
    update: Update = field(default="smdp", kw_only=True)
    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)
    ties: choices.Ties = later_option("first")

    name = "options"
    num_words = 1
    num_begin_words = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.instance("OptionQ: options", self.options, Options, "Options such as options_from(...)")
        self._check_choice("update", Update)
        self._check_choice("ties", choices.Ties)

    def prepare(self, env: AnyTabularEnvironment) -> OptionTables:
        """Raises ValueError if the options are not over the environment, or in some state none can begin."""
        return option_tables(self.options, env)

    def init(self, env: AnyTabularEnvironment, prepared: OptionTables) -> LearnerState:
        """Tables: ``[S * O]`` float32 values of options, state by state."""
        none, value = jnp.int32(0), jnp.asarray(self.initial_value, jnp.float32)
        control = Running(none, none, none, jnp.float32(0), jnp.float32(1))
        return LearnerState(jnp.full(env.num_states * prepared.num_options, value), control)

    def begin(self, prepared: OptionTables, tables: Array, first: Array, words: Words, context: Context) -> Running:
        return self._called(prepared, tables, first, words[0], context)

    def action(self, control: Running) -> Array:
        return control.action

    def learn(
        self, prepared: OptionTables, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        running, over = self.stepped(prepared, state.control, transition, context)
        q = self.taught(prepared, state.tables, running, over, transition, context)
        return LearnerState(q, self.continued(prepared, q, running, over, transition, words[0], context))

    def stepped(
        self, prepared: OptionTables, running: Running, transition: Transition, context: Context
    ) -> tuple[Running, Array]:
        """The option that runs after one more step, and whether it is over."""
        gamma = context.discounted(at_episode(self.discount, context.episode))
        running = running._replace(
            reward=running.reward + context.product(running.discount, transition.reward),
            discount=gamma(running.discount),
        )
        ends = (prepared.row(transition.next_state) & 2) != 0
        return running, _entry(ends, running.option) | transition.terminated

    def taught(
        self,
        prepared: OptionTables,
        q: Array,
        running: Running,
        over: Array,
        transition: Transition,
        context: Context,
    ) -> Array:
        """The values after a step; `running` and `over` are those after it."""
        count, after = prepared.num_options, transition.next_state
        gamma = context.discounted(at_episode(self.discount, context.episode))
        row = prepared.row(after)
        q_after = take_row(q, after * count, count)
        is_called = over & ~transition.terminated  # some option is
        needed = is_called if self.update == "smdp" else ~transition.terminated
        best = lax.cond(needed, lambda: best_option(q_after, row)[1], lambda: jnp.float32(0))
        if self.update == "smdp":
            start = running.state * count + running.option
            target = td_target(running.reward, context.discounted(running.discount), best)[None]
            move = Move(start, target, over)
        else:
            goes_on = ((row & 2) == 0) & ~transition.terminated
            q_next = lax.select(goes_on, q_after, jnp.broadcast_to(best, q_after.shape))
            takes_it_too = (prepared.row(transition.state) >> 2) == transition.action
            move = Move(transition.state * count, td_target(transition.reward, gamma, q_next), takes_it_too)
        return moved(q, [move], at_episode(self.step_size, context.episode), context)

    def continued(
        self,
        prepared: OptionTables,
        q: Array,
        running: Running,
        over: Array,
        transition: Transition,
        word: Array,
        context: Context,
    ) -> Running:
        """The option that runs from here on."""
        after = transition.next_state
        return lax.cond(
            over & ~transition.terminated,
            lambda: self._called(prepared, q, after, word, context),
            lambda: running._replace(action=_entry(prepared.row(after) >> 2, running.option)),
        )

    def greedy_policy(
        self, env: AnyTabularEnvironment, prepared: OptionTables, tables: Array, context: Context
    ) -> HierarchicalPolicy:
        q = tables.reshape(-1, prepared.num_options).T
        can_begin = jnp.asarray(prepared.initiation)
        called = jnp.argmax(jnp.where(can_begin, q, jnp.full_like(q, -np.inf)), axis=0).astype(jnp.int32)
        inside = np.maximum(self.options.policy, 0)
        slots = jnp.concatenate([called[None], jnp.asarray(inside)])
        return HierarchicalPolicy(prepared.layout, slots, None)

    def _called(self, prepared: OptionTables, q: Array, state: Array, word: Array, context: Context) -> Running:
        """The option that is called in a state."""
        row, count = prepared.row(state), prepared.num_options
        values = _worth(take_row(q, state * count, count), row)
        greedy = choices.greedy_by(self.ties, values, choices.greedy(values)[0], word)
        can_begin = [(row[o] & 1) != 0 for o in range(count)]
        explores = word < threshold(at_episode(self.epsilon, context.episode))
        option = lax.select(explores, choices.nth_allowed(can_begin, word), greedy)
        return Running(option, _entry(row >> 2, option), state, jnp.float32(0), jnp.float32(1))


def _entry(row: Array, index: Array) -> Array:
    """``row[index]`` of a short row."""
    return choices.pick([row[i] for i in range(len(row))], index)


def best_option(values: Array, row: Array) -> tuple[Array, Array]:
    """The best option (int32) that can begin, and its value."""
    return choices.greedy(_worth(values, row))


def _worth(values: Array, row: Array) -> list[Array]:
    """The values of options, -inf of those that cannot begin."""
    never = jnp.float32(-np.inf)
    return [lax.select((row[o] & 1) != 0, values[o], never) for o in range(len(values))]


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
    num_options, of_root, none = len(options.names), options.num_primitives, (-1,)
    numbers = tuple(range(1, num_options + 1))
    root = ChildSet(tuple(range(of_root)) + none * num_options, none * of_root + numbers)
    plain = ChildSet(tuple(range(env.num_actions)), none * env.num_actions)
    active = np.concatenate([np.ones((1, env.num_states), np.bool_), ~options.termination])
    layout = StackLayout(
        active=active,
        goal=np.zeros(active.shape, np.float32),
        num_actions=env.num_actions,
        offset=0,
        child_sets=(root, plain),
        child_set_of=(0,) + (1,) * num_options,
        levels=((0,), numbers) if numbers else ((0,),),
    )
    return OptionTables(np.ascontiguousarray(rows.T).ravel(), options.num_options, initiation, layout)


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
