"""What all hierarchical learners share: a stack of running subtasks that decides, runs and unwinds.

After a primitive step every subtask on the stack that is terminated in the new state leaves it, and
all that it had invoked (Dietterich 2000, section 3.2). The subtask on top then decides, what it
invokes decides, and so on down to a primitive action, all within the same step. The depth of the
stack is static, so a hierarchy of one level costs no more than a flat learner.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.core.flags import Flag, both, choose, either, opposite
from hrljax.core.random import threshold
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.layout import Kind, TaskGraph, task_graph
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.learners.base import Experience, LearnerState, Moment
from hrljax.learners.child_values import ChildValues, Values
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.roots.base import Decision, Root


class Pending(NamedTuple):
    """A child that runs: when it ends, the choice of it is learned from."""

    state: Array  # int32: where it was invoked
    slot: Array  # int32
    discount: Array  # float32: discount of its steps so far


class Control(NamedTuple):
    """Where the hierarchy is in its execution."""

    action: Array  # int32: next primitive action
    tasks: tuple[Array, ...]  # int32: subtask that runs on each level, -1 if none
    pending: tuple[Pending, ...]  # on each level but the last, whose children are primitive
    decision: Any  # the root's choice, without its subtask, and its discount; () if the root learns


class Tables(NamedTuple):
    """What a hierarchical learner has learned."""

    parts: Array  # [tasks * S * K * parts] float32: values by subtask, state and child's slot
    root: Any  # what the root has learned, if it has a policy of its own


class Choice(NamedTuple):
    """What a subtask decides."""

    action: Array  # int32: primitive action, or -1
    task: Array  # int32: subtask, or -1
    slot: Array  # int32
    values: Values  # of the child that is invoked


@dataclass(frozen=True, eq=False)
class Prepared:
    graph: TaskGraph
    root: Any


@dataclass(frozen=True)
class Ended:
    """What a step ended on one level; the flags are Python constants where they are always true."""

    used: Flag  # a subtask runs here
    child: Flag  # its child ended
    exited: Flag  # it ended itself


def readable(task: Array, used: Flag) -> Array:
    """The number of the subtask on a level; 0 where none runs there, to read something."""
    return task if used is True else lax.max(task, jnp.int32(0))


@dataclass(frozen=True)
class StackLearner(ChildValues):
    """Executes a hierarchy; subclasses say what is learned.

    Attributes: see `hrljax.HORDQ`.
    """

    hierarchy: Hierarchy
    root: Root | None = None
    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        owner = type(self).__name__
        checks.instance(f"{owner}: hierarchy", self.hierarchy, Hierarchy, "a Hierarchy such as env.hierarchy()")
        if self.root is None:
            return
        checks.instance(f"{owner}: root", self.root, Root, "None or a root such as ModelRoot()")
        if any(map(self.hierarchy.is_primitive, self.hierarchy.root.children)):
            raise ValueError(
                f"{owner}: the root {self.hierarchy.root.name!r} has a primitive child, so it must learn: root=None"
            )

    @property
    def num_words(self) -> int:  # type: ignore[override]
        """One for each decision between the root and a primitive action."""
        return self.hierarchy.depth

    @property
    def num_begin_words(self) -> int:  # type: ignore[override]
        return self.hierarchy.depth

    @property
    def planning_interval(self) -> int:
        return 0 if self.root is None else self.root.planning_interval

    # What a subclass says.

    @abstractmethod
    def _learned(
        self,
        graph: TaskGraph,
        parts: Array,
        control: Control,
        step: Experience,
        ended: list[Ended],
        follows: Values,
        moment: Moment,
    ) -> Array:
        """The tables after a step; `follows` are the values that bootstraps use, 0 after the last step."""

    @property
    def _is_on_policy(self) -> bool:
        """Whether bootstraps use the child that is invoked next instead of the greedy one."""
        return False

    # What a training loop calls.

    def prepare(self, env: AnyTabularEnvironment) -> Prepared:
        root = None if self.root is None else self.root.prepare(self.hierarchy, env)
        return Prepared(task_graph(self.hierarchy, env, self.root is None), root)

    def init(self, env: AnyTabularEnvironment, prepared: Prepared) -> LearnerState:
        graph = prepared.graph
        cells = graph.num_states * graph.num_slots

        def tiled(numbers: tuple[Any, ...], times: int) -> Array:
            return jnp.tile(jnp.stack([jnp.asarray(number, jnp.float32) for number in numbers]), times)

        parts = tiled(self._initial(is_root=False), graph.num_tasks * cells)
        if self.root is None:
            of_root = tiled(self._initial(is_root=True), cells)
            parts = jnp.concatenate([of_root, parts[len(of_root) :]])
        root = () if self.root is None else self.root.init(prepared.root)
        none = jnp.int32(0)
        idle = Pending(none, none, jnp.float32(1))
        control = Control(
            action=none,
            tasks=(none,) * graph.num_levels,
            pending=(idle,) * (graph.num_levels - 1),
            decision=() if self.root is None else (none, none, jnp.float32(1)),
        )
        return LearnerState(Tables(parts, root), control)

    def begin(
        self, prepared: Prepared, tables: Tables, first: Array, words: tuple[Array, ...], moment: Moment
    ) -> Control:
        nobody = jnp.int32(-1)
        graph = prepared.graph
        idle = Pending(jnp.int32(0), jnp.int32(0), jnp.float32(1))
        empty = Control(nobody, (nobody,) * graph.num_levels, (idle,) * (graph.num_levels - 1), ())
        if self.root is None:
            task, decision = jnp.int32(0), ()
        else:
            chosen, _ = self._decide_root(prepared, tables, first, words[0], moment)
            task, decision = chosen.task, (chosen.point, chosen.slot, jnp.float32(1))
        ended = [Ended(True, True, True)] * graph.num_levels
        control, _ = self._descend(prepared, tables, empty, ended, task, True, first, words, moment)
        return control._replace(decision=decision)

    def action(self, control: Control) -> Array:
        return control.action

    def learn(
        self, prepared: Prepared, state: LearnerState, step: Experience, words: tuple[Array, ...], moment: Moment
    ) -> LearnerState:
        tables, control = state
        after = step.next_state
        ended = self._ended(prepared.graph, control, step)
        discount = at_episode(self.discount, moment.episode)
        pending = tuple(p._replace(discount=p.discount * discount) for p in control.pending)
        task, fresh = control.tasks[0], False
        decision: Any = ()
        if self.root is not None:
            # The root chooses before the bootstrap, which is on the subtask that really runs next.
            fresh = ended[0].exited
            tables, chosen, so_far = self._root_step(prepared, tables, control, step, fresh, discount, words[0], moment)
            task, decision = chosen.task, (chosen.point, chosen.slot, so_far)
        running = control._replace(pending=pending)
        goes_on = ~step.terminated & moment.live

        def descend(parts: Array) -> tuple[Control, Values]:
            return self._descend(
                prepared, tables._replace(parts=parts), running, ended, task, fresh, after, words, moment, goes_on
            )

        # An off-policy learner chooses with what it has just learned, an on-policy one learns from its choice.
        if self._is_on_policy:
            following, follows = descend(tables.parts)
        else:
            following, follows = None, self._following(prepared.graph, tables.parts, control, ended, task, after)
        follows = jax.tree.map(lambda value: lax.select(step.terminated, jnp.float32(0), value), follows)
        parts = self._learned(prepared.graph, tables.parts, running, step, ended, follows, moment)
        following = following or descend(parts)[0]
        return LearnerState(tables._replace(parts=parts), following._replace(decision=decision))

    def plan(self, prepared: Prepared, tables: Tables, moment: Moment) -> Tables:
        if self.root is None:
            return tables
        return tables._replace(root=self.root.plan(prepared.root, tables.root, moment))

    def greedy_policy(
        self, env: AnyTabularEnvironment, prepared: Prepared, tables: Tables, zero: Array
    ) -> HierarchicalPolicy:
        graph = prepared.graph
        states = jnp.arange(env.num_states, dtype=jnp.int32)

        def slots(state: Array) -> Array:
            found = [self._best(graph, tables.parts, graph.kind(t), jnp.int32(t), state)[0] for t in all_tasks]
            return jnp.stack(found)

        all_tasks = range(graph.num_tasks)
        choice = None
        if self.root is not None:
            root, child_value = self.root, self._child_value(graph, tables.parts)
            choice = jax.vmap(lambda s: root.probabilities(prepared.root, tables.root, child_value, s, zero))(states)
        return HierarchicalPolicy(graph, jax.vmap(slots)(states).T, choice)

    # How the stack moves.

    def _ended(self, graph: TaskGraph, control: Control, step: Experience) -> list[Ended]:
        """What a step ended on each level, from the first to the last."""
        exits: list[Flag] = []
        used: list[Flag] = []
        for level, task in enumerate(control.tasks):
            used.append(True if graph.is_always_used(level) else task >= 0)
            if self.root is None and level == 0:
                exits.append(False)  # its end is the episode's
                continue
            over: Flag = ~graph.active(readable(task, used[-1]), step.next_state)
            over = either(over, exits[-1]) if level else over
            exits.append(both(used[-1], over))
        children: list[Flag] = []
        for level in range(graph.num_levels):
            if level == graph.num_levels - 1:
                children.append(True)
                continue
            below = level + 1
            alone = both(used[level], True if used[below] is False else opposite(used[below]))
            children.append(either(either(exits[below], alone), step.terminated))
        return [Ended(*flags) for flags in zip(used, children, exits, strict=True)]

    def _following(
        self, graph: TaskGraph, parts: Array, control: Control, ended: list[Ended], task: Array, state: Array
    ) -> Values:
        """Values of the greedy child of the first learning subtask that takes control after a step."""
        for running, end in zip(control.tasks[1:], ended[1:], strict=True):
            task = choose(both(end.used, opposite(end.exited)), running, task)

        def of_kind(kind: Kind) -> Values:
            best, row, _ = self._best(graph, parts, kind, task, state)
            return self._values_of(graph, parts, kind, task, state, row, best)

        return graph.by_kind(graph.all_levels, task, of_kind)

    def _descend(
        self,
        prepared: Prepared,
        tables: Tables,
        control: Control,
        ended: list[Ended],
        task: Array,
        fresh: Flag,
        state: Array,
        words: tuple[Array, ...],
        moment: Moment,
        goes_on: Flag = True,
    ) -> tuple[Control, Values]:
        """Fills the stack down to a primitive action; also the values of what the first to decide invokes.

        Args:
            task: the subtask on the first level, new there if `fresh`.
            ended: what the last step ended; `control` is from before it.
            goes_on: whether decisions have an effect.
        """
        graph = prepared.graph
        action, found, follows = control.action, False, None
        tasks: list[Array] = []
        pendings: list[Pending] = []
        for level in range(graph.num_levels):
            is_last = level == graph.num_levels - 1
            used: Flag = True if graph.is_always_used(level) else task >= 0
            decides = both(used, True if is_last else either(fresh, ended[level].child))
            below = jnp.int32(-1) if is_last else control.tasks[level + 1]
            kept = control.pending[level].slot if not is_last else jnp.int32(0)
            asked = readable(task, used)

            def decide(level: int = level, asked: Array = asked) -> Choice:
                word = words[level + graph.offset]
                return self._decide(graph, tables.parts, level, asked, state, word, moment)

            if isinstance(decides, bool):
                choice = decide()
            else:
                shape = jax.eval_shape(decide)
                nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shape.values)
                stay = Choice(action, below, kept, nothing)
                choice = lax.cond(both(decides, goes_on), decide, lambda stay=stay: stay)
            follows = choice.values if follows is None else choose(found, follows, choice.values)
            found = either(found, decides)
            tasks.append(task)
            action = choose(both(decides, True if is_last else choice.action >= 0), choice.action, action)
            if not is_last:
                going = control.pending[level]
                pendings.append(choose(decides, Pending(state, choice.slot, jnp.float32(1)), going))
                task = choose(used, choose(decides, choice.task, below), jnp.int32(-1))
                fresh = decides
        return Control(action, tuple(tasks), tuple(pendings), ()), follows

    def _decide(
        self, graph: TaskGraph, parts: Array, level: int, task: Array, state: Array, word: Array, moment: Moment
    ) -> Choice:
        epsilon = at_episode(self.epsilon, moment.episode)

        def of_kind(kind: Kind) -> Choice:
            best, row, allowed = self._best(graph, parts, kind, task, state)
            if kind.is_primitive:
                slot = choices.epsilon_greedy(best, kind.num_slots, word, epsilon)
            else:
                can = [jnp.bool_(True) if a is None else a for a in allowed]
                slot = lax.select(word < threshold(epsilon), choices.nth_allowed(can, word), best)
            values = self._values_of(graph, parts, kind, task, state, row, slot)
            return Choice(*graph.child_of(kind, slot), slot, values)

        return graph.by_kind([level], task, of_kind)

    # What a root with a policy of its own does.

    def _root_step(
        self,
        prepared: Prepared,
        tables: Tables,
        control: Control,
        step: Experience,
        exited: Flag,
        discount: Any,
        word: Array,
        moment: Moment,
    ) -> tuple[Tables, Decision, Array]:
        """Tells the root that its subtask has ended, if it has, and asks it for the next one."""
        assert self.root is not None
        point, slot, so_far = control.decision
        so_far = so_far * discount
        decision = Decision(control.tasks[0], point, slot)
        tables = self._hand_back(prepared, tables, decision, step, jnp.asarray(exited), so_far, moment)
        decision, found = lax.cond(
            jnp.asarray(exited) & ~step.terminated & moment.live,
            lambda: self._decide_root(prepared, tables, step.next_state, word, moment),
            lambda: (decision, self.root.kept(prepared.root, tables.root, decision)),  # type: ignore[union-attr]
        )
        tables = tables._replace(root=self.root.record(prepared.root, tables.root, decision, found))
        return tables, decision, lax.select(jnp.asarray(exited), jnp.float32(1), so_far)

    def _hand_back(
        self,
        prepared: Prepared,
        tables: Tables,
        decision: Decision,
        step: Experience,
        exited: Array,
        discount: Array,
        moment: Moment,
    ) -> Tables:
        root = self.root
        if root is None or not root.learns:
            return tables
        learned = moment.when(
            exited | step.terminated,
            lambda own, now: root.observe(
                prepared.root, own, decision, step.next_state, step.terminated, discount, now
            ),
            tables.root,
        )
        return tables._replace(root=learned)

    def _decide_root(
        self, prepared: Prepared, tables: Tables, state: Array, word: Array, moment: Moment
    ) -> tuple[Decision, Any]:
        assert self.root is not None
        child_value = self._child_value(prepared.graph, tables.parts)
        epsilon = at_episode(self.epsilon, moment.episode)
        return self.root.choose(prepared.root, tables.root, child_value, state, word, epsilon, moment.zero)
