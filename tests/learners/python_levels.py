"""Hierarchies of any depth in plain Python: a list as the stack, one row of a table for each child.

Written from the definitions (thesis 3.1-3.2; Dietterich 2000, Tables 2 and 4; Parr and Russell
1997), without the library's tables, levels and slots. `tests.learners.test_against_python` and
`tests.learners.test_levels_against_python` compare.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import hrljax
from hrljax.core.random import WORD_RANGE
from hrljax.experiments.backup import PseudoRewardInBackup
from tests.words import drawn

F = np.float32
EPISODES = 60
"""Most episodes that schedules are read for."""


class Graph(NamedTuple):
    """A hierarchy over the numbers of states."""

    children: dict[str, list[Any]]  # of each subtask, the root first: names of subtasks and numbers of actions
    active: dict[str, np.ndarray]  # [S] bool
    goal: dict[str, np.ndarray]  # [S] bool


class PythonEnv:
    """What can happen in an environment, looked up by the kinds of a step's words."""

    def __init__(self, env: Any, params: Any):
        self.env, self.params = env, params
        cuts = [sorted({math.ceil(float(F(c)) * WORD_RANGE) for c in word}) for word in env.word_cuts(params)]
        self.cuts = [[cut for cut in word if 0 < cut < WORD_RANGE] for word in cuts]
        kinds = np.meshgrid(*[np.array([0, *word], np.uint32) for word in self.cuts], indexing="ij")
        self.shape = kinds[0].shape

        def outcome(state: Any, action: Any, words: Any) -> Any:
            after, reward, terminated, _ = env.transition(env.decode(state), action, words, params)
            return env.encode(after), reward, terminated

        grid = np.meshgrid(range(env.num_states), range(env.num_actions), range(kinds[0].size), indexing="ij")
        state, action, kind = (axis.ravel().astype(np.int32) for axis in grid)
        actual = jax.jit(jax.vmap(outcome))(state, action, tuple(jnp.asarray(k.ravel()[kind]) for k in kinds))
        self.outcomes = [np.asarray(column).reshape(grid[0].shape) for column in actual]

    def first_states(self, words: list[list[int]]) -> list[int]:
        drawn_words = jnp.asarray(np.array(words, np.uint32))
        initial = jax.vmap(lambda w: self.env.encode(self.env.initial(tuple(w), self.params)))
        return np.asarray(initial(drawn_words)).tolist()

    def step(self, state: int, action: int, words: list[int]) -> tuple[int, F, bool, tuple[bool, ...]]:
        """Next state, reward, whether the episode terminated, and no events."""
        kinds = [sum(word >= cut for cut in cuts) for word, cuts in zip(words, self.cuts, strict=True)]
        after, reward, terminated = (
            column[state, action, int(np.ravel_multi_index(kinds, self.shape))] for column in self.outcomes
        )
        return int(after), F(reward), bool(terminated), ()


def at(value: Any, episode: int) -> F:
    """A hyper-parameter in an episode; a schedule is evaluated over many, as the library does."""
    return F(jax.vmap(value)(jnp.arange(EPISODES))[episode] if callable(value) else value)


@dataclass
class Frame:
    """A subtask that runs, and the child that it has invoked."""

    task: str
    state: int = -1  # where the child was invoked
    child: Any = None
    discount: F = F(1)  # of the child's steps so far


class RandomChoice:
    """A root that chooses at random among the subtasks that can be invoked, and learns nothing."""

    def choose(self, state: int, invocable: list[str], word: int, is_first: bool) -> str:
        return invocable[word % len(invocable)]

    def observe(self, state: int, task: str, after: int, weight: F, terminated: bool) -> None: ...

    def plan(self, episode: int) -> None: ...


class Decomposed:
    """HORDQ and MAXQ; a row is Q_r, Q_c, Q_e, Q_p. Q_r of a subtask is found by recursion.

    `root` chooses for a root that does not learn.
    """

    def __init__(self, learner: Any, graph: Graph, root: Any = None):
        self.learner, self.graph, self.root_policy = learner, graph, root or RandomChoice()
        self.root = next(iter(graph.children))
        self.root_learns = learner.root is None
        self.has_exit = isinstance(learner, hrljax.HORDQ)
        num_states = len(graph.active[self.root])
        self.table = {
            (task, state, child): self.initial(task)
            for task, children in graph.children.items()
            for state in range(num_states)
            for child in children
        }
        self.steps_by_depth: dict[int, int] = {}
        fading = getattr(learner, "pseudo_reward", None)
        self.fading = fading if isinstance(fading, hrljax.Fading) else None
        self.visits, self.mean_reward, self.steps = np.zeros(num_states, F), F(0), F(0)

    def initial(self, task: str) -> np.ndarray:
        row = np.zeros(4, F)
        row[2 if self.has_exit and task != self.root else 1] = self.learner.initial_value
        return row

    # Values.

    def allowed(self, task: str, state: int) -> list[Any]:
        return [c for c in self.graph.children[task] if isinstance(c, int) or self.graph.active[c][state]]

    def values(self, task: str, state: int, child: Any) -> np.ndarray:
        reward, *rest = self.table[task, state, child]
        if isinstance(child, str):
            reward = self.until_end(child, state)
        return np.array([reward, *rest], F)

    def worth(self, values: np.ndarray, state: int) -> F:
        reward, completion, after_exit, pseudo = values
        pseudo = self.kappa(state) * pseudo
        return reward + completion + after_exit + pseudo if self.has_exit else reward + completion + pseudo

    def kappa(self, state: int) -> F:
        """The weight of the pseudo-reward's value: 1 where that holds the pseudo-reward itself."""
        if self.fading is None:
            return F(1)
        worth, after = F(self.fading.worth), F(self.fading.after)
        return worth * after * self.mean_reward / (after + self.visits[state])

    def see(self, state: int, reward: F) -> None:
        """What a pseudo-reward that fades goes by."""
        self.visits[state] += F(1)
        self.steps += F(1)
        self.mean_reward += (abs(reward) - self.mean_reward) / self.steps

    def best(self, task: str, state: int) -> Any:
        allowed = self.allowed(task, state)
        return allowed[int(np.argmax([self.worth(self.values(task, state, child), state) for child in allowed]))]

    def until_end(self, task: str, state: int) -> F:
        values = self.values(task, state, self.best(task, state))
        return values[0] + values[1]

    # Execution.

    def choose(self, task: str, state: int, word: int) -> Any:
        if word < math.ceil(float(self.epsilon) * WORD_RANGE):
            allowed = self.allowed(task, state)
            return allowed[word % len(allowed)]
        if self.learner.ties == "random":
            worth = [self.worth(self.values(task, state, child), state) for child in self.allowed(task, state)]
            tied = [c for c, value in zip(self.allowed(task, state), worth, strict=True) if value == max(worth)]
            return tied[word % len(tied)]
        return self.best(task, state)

    def root_choice(self, state: int, word: int, is_first: bool = False) -> str:
        """Of a root that does not learn."""
        self.decided_at, self.root_discount = state, F(1)
        return self.root_policy.choose(state, self.allowed(self.root, state), word, is_first)

    def descend(self, stack: list[Frame], state: int, words: list[int]) -> None:
        """The subtask on top chooses, and what it chooses, down to an action; one word for each level."""
        while True:
            top, level = stack[-1], len(stack) - self.root_learns
            top.state, top.child, top.discount = state, self.choose(top.task, state, words[level]), F(1)
            if isinstance(top.child, int):
                self.action = top.child
                return
            stack.append(Frame(top.child))

    def begin(self, episode: int, state: int, words: list[int]) -> None:
        for name in ("epsilon", "step_size", "pseudo_reward"):
            number = 1.0 if name == "pseudo_reward" and self.fading else getattr(self.learner, name, 0.0)
            setattr(self, name, at(number, episode))
        first = self.root if self.root_learns else self.root_choice(state, words[0], is_first=True)
        self.stack = [Frame(first)]
        self.descend(self.stack, state, words)
        self.root_policy.plan(episode)

    def learn(self, state: int, reward: F, after: int, terminated: bool, words: list[int]) -> None:
        self.steps_by_depth[len(self.stack)] = self.steps_by_depth.get(len(self.stack), 0) + 1
        ran = self.stack
        for frame in ran:
            frame.discount = frame.discount * F(self.learner.discount)
        stays = next(
            (
                depth
                for depth, frame in enumerate(ran)
                if not (self.root_learns and depth == 0) and not self.graph.active[frame.task][after]
            ),
            len(ran),
        )
        survivors = [Frame(**vars(frame)) for frame in ran[:stays]]
        if not self.root_learns:
            self.root_discount = self.root_discount * F(self.learner.discount)
            if not survivors or terminated:
                weight = F(0) if terminated else self.root_discount
                self.root_policy.observe(self.decided_at, ran[0].task, after, weight, terminated)
        if not survivors and not terminated:
            survivors = [Frame(self.root_choice(after, words[0]))]
        follows = np.zeros(4, F)
        on_policy = getattr(self.learner, "bootstrap", "greedy") == "on_policy"
        if not terminated:
            takes_over = survivors[-1]
            if on_policy:
                self.descend(survivors, after, words)
                child = takes_over.child
            else:
                child = self.best(takes_over.task, after)
            follows = self.values(takes_over.task, after, child)
        new = self.taught(state, reward, after, terminated, survivors[-1].child if on_policy and survivors else None)
        for depth, frame in enumerate(ran):
            child_ended = depth >= stays - 1 or depth == len(ran) - 1 or terminated
            if child_ended:
                updated = self.updated(frame, reward, after, depth >= stays, follows, depth == len(ran) - 1)
                new = {(frame.task, frame.state, frame.child): updated} | new
        self.table |= {place: row for place, row in new.items() if row is not None}
        if not terminated and not on_policy:
            self.descend(survivors, after, words)
        self.stack = survivors
        self.see(state, reward)  # after choices, which do not wait for it

    def taught(
        self, state: int, reward: F, after: int, terminated: bool, next_action: int | None
    ) -> dict[Any, np.ndarray]:
        """Rows that a step teaches besides those of the children that have ended."""
        return {}

    def updated(
        self, frame: Frame, reward: F, after: int, exited: bool, follows: np.ndarray, on_top: bool
    ) -> np.ndarray | None:
        """The row of a child that has ended, its parent with it or not; None if nothing is learned of it."""
        next_r, next_c, next_e, next_p = follows
        target = np.zeros(4, F)
        if isinstance(frame.child, int):
            target[0] = reward
        if exited:
            target[2] = frame.discount * (next_r + next_c + next_e)
            target[3] = self.pseudo_reward * F(self.graph.goal[frame.task][after])
        else:
            target[1:] = frame.discount * np.array([next_r + next_c, next_e, next_p])
        if isinstance(self.learner, PseudoRewardInBackup):
            target[1], target[3] = target[3] if exited else target[1], 0
        old = self.table[frame.task, frame.state, frame.child]
        return old + self.step_size * (target - old)

    # What greedy behaviour earns.

    def completed(self, stack: tuple[str, ...], state: int) -> tuple[tuple[str, ...], int]:
        """The stack that takes the next action, and the action, after the subtask on top has decided."""
        while isinstance(child := self.best(stack[-1], state), str):
            stack = (*stack, child)
        return stack, child

    def greedy_return(self, env: "PythonEnv") -> float:
        """By backward induction over (stack, state) pairs, in float64."""
        model, first = env.env.model(env.params), env.env.initial_distribution(env.params)
        states, value = range(len(first)), {}

        def entering(state: int) -> float:
            if self.root_learns:
                return value.get(((self.root,), state), 0.0)
            children = self.allowed(self.root, state)
            return sum(value.get(((child,), state), 0.0) for child in children) / len(children)

        def arriving(stack: tuple[str, ...], state: int) -> float:
            for depth, task in enumerate(stack):
                if not (self.root_learns and depth == 0) and not self.graph.active[task][state]:
                    stack = stack[:depth]
                    break
            return value.get((stack, state), 0.0) if stack else entering(state)

        bottoms = [(self.root,)] if self.root_learns else [(child,) for child in self.graph.children[self.root]]
        stacks = {self.completed(b, s)[0][:depth] for b in bottoms for s in states for depth in (1, 2, 3, 4)}
        plans = {(stack, state): self.completed(stack, state) for stack in stacks for state in states}
        while more := {stack[:depth] for stack, _ in plans.values() for depth in range(1, len(stack) + 1)} - stacks:
            stacks |= more
            plans |= {(stack, state): self.completed(stack, state) for stack in more for state in states}
        for _ in range(env.params.max_steps):
            updated = {}
            for (stack, state), (runs, action) in plans.items():
                outcomes = zip(*(column[state, action] for column in model), strict=True)
                updated[stack, state] = sum(
                    probability * (reward + (0.0 if over else arriving(runs, int(after))))
                    for after, probability, reward, over in outcomes
                    if probability
                )
            value = updated
        return float(sum(p * entering(s) for s, p in enumerate(first) if p))

    # Comparison.

    def compare(self, learned: Any) -> None:
        """Every number, also of what was never visited."""
        learners = [task for task in self.graph.children if self.root_learns or task != self.root]
        width = max(len(self.graph.children[task]) for task in learners)
        tables = np.asarray(learned.q).reshape(len(learners), -1, width, len(self.initial(self.root)))
        for number, task in enumerate(learners):
            for slot, child in enumerate(self.graph.children[task]):
                rows = np.stack([self.table[task, state, child] for state in range(tables.shape[1])])
                used = self.used_parts()
                np.testing.assert_array_equal(
                    tables[number, :, slot][:, used], rows[:, used], err_msg=f"{task}, {child}"
                )

    def used_parts(self) -> list[int]:
        return [0, 1, 2, 3] if self.has_exit else [0, 1, 3]  # MAXQ-Q reads no Q_e


class Machines(Decomposed):
    """HAMQ: one number for each choice; that of a subtask is the best of its own choices."""

    def initial(self, task: str) -> np.ndarray:
        return np.array([self.learner.initial_value], F)

    def values(self, task: str, state: int, child: Any) -> np.ndarray:
        if isinstance(child, str):
            return self.values(child, state, self.best(child, state))
        return self.table[task, state, child]

    def worth(self, values: np.ndarray, state: int) -> F:
        return values[0]

    def updated(
        self, frame: Frame, reward: F, after: int, exited: bool, follows: np.ndarray, on_top: bool
    ) -> np.ndarray | None:
        if not on_top:
            return None
        old = self.table[frame.task, frame.state, frame.child]
        target = reward + F(self.learner.discount) * follows[:1]
        return old + self.step_size * (target - old)

    def used_parts(self) -> list[int]:
        return [0]


class Walk(NamedTuple):
    """What a program went through."""

    program: Any
    steps: int
    episodes: np.ndarray  # [episodes, 3 + events]: return, length, how often each event happened, truncated

    @property
    def truncated(self) -> int:
        return int(self.episodes[:, -1].sum())


def train_in_python(program: Any, env: Any, episodes: int) -> Walk:
    """A program after so many episodes.

    Args:
        program: a learner in plain Python: ``begin(episode, state, words)``, ``learn(...)`` and ``action``; its
            ``learner`` is the library's.
        env: a `PythonEnv`, or another with ``env``, ``params``, ``first_states`` and ``step``.
        episodes: how many.
    """
    learner, of_env, of_first = program.learner, env.env.num_words, env.env.num_initial_words
    begin_words = drawn(episodes, of_first + learner.num_begin_words, 2)
    step_words = drawn(episodes * env.params.max_steps, of_env + learner.num_words, 0)
    steps, rows = 0, []
    for episode, state in enumerate(env.first_states([words[:of_first] for words in begin_words])):
        program.begin(episode, state, begin_words[episode][of_first:])
        time, total, happened, terminated = 0, 0.0, np.zeros(len(env.env.metrics)), False
        while not terminated and time < env.params.max_steps:
            words = step_words[steps]
            after, reward, terminated, events = env.step(state, program.action, words[:of_env])
            program.learn(state, reward, after, terminated, words[of_env:])
            state, time, steps, total = after, time + 1, steps + 1, total + float(reward)
            happened[: len(events)] += events
        rows.append([total, time, *happened, not terminated])
    return Walk(program, steps, np.array(rows))
