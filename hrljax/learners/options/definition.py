"""Options as arrays: temporally extended actions with fixed policies (Sutton, Precup and Singh 1999)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hrljax.core import checks
from hrljax.envs.base import AnyTabularEnvironment, TabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.tables import tabulate
from hrljax.solvers.dynamic_programming import value_iteration
from hrljax.solvers.model import Model

_TIE = 1e-4
"""Actions whose values differ by no more, relative to a unit plus the value, are taken to be equally good."""


@dataclass(frozen=True, eq=False)
class Options:
    """Markov options with deterministic policies, over the numbers of an environment's states.

    An option is followed from a state of its initiation set until it terminates. Termination is
    asked after every step, not before the first, so that an option runs for at least one step. What
    a policy says where its option can neither begin nor go on is not used.

    Compares by value, so that equal ones share compiled code.

    Attributes:
        actions: names of the primitive actions, in the environment's order.
        names: of the options, ``[O]``.
        policy: ``[O, S]`` int32 primitive actions.
        termination: ``[O, S]`` bool.
        initiation: ``[O, S]`` bool.
        primitives: whether every primitive action is an option of one step as well, before the others.

    Raises:
        TypeError: an attribute is of the wrong kind.
        ValueError: a shape does not fit, there is no option, a name is used twice, an option takes an unknown
            action, or can be initiated nowhere, or terminates wherever it can be initiated. The
            message names the option.
    """

    actions: tuple[str, ...]
    names: tuple[str, ...]
    policy: np.ndarray
    termination: np.ndarray
    initiation: np.ndarray
    primitives: bool = True

    def __post_init__(self) -> None:
        for field in ("actions", "names"):
            object.__setattr__(self, field, checks.names(field, getattr(self, field)))
        checks.flag("primitives", self.primitives)
        for field, kind, what in (
            ("policy", np.integer, "integers"),
            ("termination", np.bool_, "bools"),
            ("initiation", np.bool_, "bools"),
        ):
            array = checks.as_array(field, getattr(self, field), kind, (len(self.names), None), what)
            if array.size and not -(2**31) <= array.min() <= array.max() < 2**31:
                raise ValueError(f"{field} must be numbers of actions, got {array.min()} to {array.max()}")
            array = array.astype(np.int32 if field == "policy" else np.bool_)  # a copy of our own
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        shapes = {field: getattr(self, field).shape for field in ("policy", "termination", "initiation")}
        if len(set(shapes.values())) > 1:
            raise ValueError(f"policy, termination and initiation must have one shape, got {shapes}")
        if not self.names and not self.primitives:
            raise ValueError("there is no option: give some, or primitives=True")
        taken = [*self.names, *(self.actions if self.primitives else ())]
        for number, name in enumerate(self.names):
            if taken.count(name) > 1:
                raise ValueError(f"the name {name!r} is used {taken.count(name)} times; names are unique")
            self._check(number, name)

    def _check(self, number: int, name: str) -> None:
        starts, ends, policy = self.initiation[number], self.termination[number], self.policy[number]
        wrong = (starts | ~ends) & ((policy < 0) | (policy >= len(self.actions)))
        if wrong.any():
            state = int(np.flatnonzero(wrong)[0])
            raise ValueError(
                f"option {name!r} takes action {policy[state]} in state {state}; "
                f"actions are 0 to {len(self.actions) - 1}"
            )
        if not starts.any():
            raise ValueError(f"option {name!r} can be initiated in no state")
        if ends[starts].all():
            raise ValueError(
                f"option {name!r} terminates in every state in which it can be initiated; "
                "one step of a primitive action is an option by primitives=True"
            )

    def _contents(self) -> tuple[Any, ...]:
        arrays = (self.policy, self.termination, self.initiation)
        return (self.actions, self.names, self.primitives, self.policy.shape, *(array.tobytes() for array in arrays))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Options) and self._contents() == other._contents()

    def __hash__(self) -> int:
        return hash(self._contents())

    def __repr__(self) -> str:
        primitive = ("primitive actions",) if self.primitives else ()
        return f"Options({', '.join((*primitive, *self.names))})"

    @property
    def num_states(self) -> int:
        return self.policy.shape[1]

    @property
    def num_primitives(self) -> int:
        """Options that are primitive actions; their numbers come first."""
        return len(self.actions) if self.primitives else 0

    @property
    def num_options(self) -> int:
        return self.num_primitives + len(self.names)

    def with_primitives(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Policy, termination and initiation of all options, primitive actions included, ``[num_options, S]``.

        The policy is -1 where an option can neither begin nor go on.
        """
        of_options = np.where(self.initiation | ~self.termination, self.policy, np.int32(-1))
        actions = np.arange(self.num_primitives, dtype=np.int32)
        shape = (self.num_primitives, self.num_states)
        everywhere = np.ones(shape, np.bool_)
        return (
            np.concatenate([np.broadcast_to(actions[:, None], shape), of_options]),
            np.concatenate([everywhere, self.termination]),
            np.concatenate([everywhere, self.initiation]),
        )


def primitive_options(env: AnyTabularEnvironment) -> Options:
    """Every primitive action as an option of one step, and no other option.

    Raises:
        TypeError: `env` is no tabular environment.
    """
    checks.instance("env", env, TabularEnvironment, "a tabular environment such as hrljax.make('Bus')")
    none = np.zeros((0, env.num_states), np.bool_)
    return Options(env.action_names, (), none.astype(np.int32), none, none)


def options_from(
    hierarchy: Hierarchy,
    env: AnyTabularEnvironment,
    names: Sequence[str] | None = None,
    *,
    primitives: bool = True,
    pseudo_reward: float = 100.0,
    discount: float = 1.0,
    params: Any = None,
) -> Options:
    """Subtasks as options that reach their goals in the best way, found by value iteration.

    An option can be initiated where its subtask is active, terminates where it is not, and chooses
    among the subtask's children. Its policy maximises the expected reward until then, plus the
    pseudo-reward if it ends in the subtask's goal. Ties go to the first action.

    Args:
        hierarchy: over the environment's actions.
        env: its exact model is solved.
        names: of subtasks whose children are all primitive; all of these but the root if None.
        primitives: whether the primitive actions are options as well.
        pseudo_reward: finite; it has to outweigh what it costs to reach the goal.
        discount: in [0, 1]; 1 needs a policy that ends the subtask, or the episode, from wherever it is active.
        params: numbers of the environment, `env.default_params` if None.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: a number is out of range, a name is no such subtask, or there is none; as `Options`.
    """
    checks.instance("hierarchy", hierarchy, Hierarchy, "a Hierarchy such as env.hierarchy()")
    pseudo_reward = checks.number("pseudo_reward", pseudo_reward)
    simple = [t.name for t in hierarchy.subtasks[1:] if all(map(hierarchy.is_primitive, t.children))]
    names = simple if names is None else checks.names("names", names)
    for name in names:
        if name not in simple:
            raise ValueError(
                f"names: {name!r} is no subtask with primitive children only; those are {', '.join(simple) or 'none'}"
            )
    if not names:
        raise ValueError("the hierarchy has no subtask below its root with primitive children only")
    tables = tabulate(hierarchy, env)
    model = env.model(params)
    policies, active = [], []
    for name in names:
        task = hierarchy[name]
        children = np.array(sorted(hierarchy.actions.index(child) for child in task.children), np.int32)
        goes_on, goal = tables.active[hierarchy.index(name)], tables.goal[hierarchy.index(name)]
        q = value_iteration(within(model, children, goes_on, pseudo_reward * goal), discount).q
        policies.append(np.where(goes_on, children[first_best(np.asarray(q))], np.int32(0)))
        active.append(goes_on)
    initiation = np.stack(active)
    return Options(hierarchy.actions, tuple(names), np.stack(policies), ~initiation, initiation, primitives)


def within(model: Model, actions: np.ndarray, active: np.ndarray, paid: np.ndarray) -> Model:
    """The decision process of a subtask: it ends where the subtask does, and is over elsewhere."""
    after, probability, reward, terminated = (column[:, actions] for column in model)
    leaves = ~active[after]
    inside = active[:, None, None]
    return Model(
        next_state=after,
        probability=probability,
        reward=np.where(inside, reward + np.where(leaves, paid[after], 0.0), 0.0),
        terminated=terminated | leaves | ~inside,
    )


def first_best(q: np.ndarray, unit: float = 1.0) -> np.ndarray:
    """``[S]``: the first of the actions that are best but for rounding, of values in the order of a unit or more."""
    best = q.max(-1, keepdims=True)
    return np.argmax(q >= best - _TIE * (unit + np.abs(best)), axis=-1)
