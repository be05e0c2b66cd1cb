"""HORDQ with shared values in plain Python: one Q(s, a), and for each subtask what it earns until its end."""

from typing import Any

import numpy as np

from tests.learners.python_levels import Decomposed, F, Frame, Graph

SHARED = "all subtasks"


class Shared(Decomposed):
    """A row is P_i and U_i of a child; those of `SHARED` are Q(s, a)."""

    def __init__(self, learner: Any, graph: Graph, num_actions: int, root: Any = None):
        super().__init__(learner, graph, root)
        self.actions = range(num_actions)
        initial = np.array([learner.initial_value], F)
        num_states = len(graph.active[self.root])
        self.table |= {(SHARED, state, action): initial for state in range(num_states) for action in self.actions}

    def initial(self, task: str) -> np.ndarray:
        return np.zeros(2, F)

    def values(self, task: str, state: int, child: Any) -> np.ndarray:
        """Q, P and U."""
        goal, until_end = self.table[task, state, child]
        if isinstance(child, int):
            return np.array([self.table[SHARED, state, child][0], goal, until_end], F)
        value, _, of_child = self.values(child, state, self.best(child, state))
        return np.array([value, goal, of_child + until_end], F)

    def worth(self, values: np.ndarray, state: int) -> F:
        value, goal, _ = values
        return value + self.kappa(state) * goal

    def kappa(self, state: int) -> F:
        return super().kappa(state) if self.fading else self.pseudo_reward

    def until_end(self, task: str, state: int) -> F:
        return self.values(task, state, self.best(task, state))[2]

    def taught(self, state: int, reward: F, after: int, terminated: bool, next_action: Any) -> dict[Any, np.ndarray]:
        discount, action = F(self.learner.discount), self.stack[-1].child
        if terminated:
            follows = F(0)
        elif next_action is None:
            follows = max(self.table[SHARED, after, b][0] for b in self.actions)
        else:
            follows = self.table[SHARED, after, next_action][0]
        target = np.array([reward + discount * follows], F)
        old = self.table[SHARED, state, action]
        new = {(SHARED, state, action): old + self.step_size * (target - old)}
        if self.learner.taught == "active":
            for task, active in self.graph.active.items():
                if active[state] and action in self.graph.children[task] and self.ends(task):
                    bootstrap = np.zeros(3, F)
                    if active[after] and not terminated:
                        bootstrap = self.values(task, after, self.best(task, after))
                    frame = Frame(task, state, action, discount)
                    new[task, state, action] = self._moved(frame, reward, after, not active[after], bootstrap)
        return new

    def ends(self, task: str) -> bool:
        return not (self.root_learns and task == self.root)

    def updated(
        self, frame: Frame, reward: F, after: int, exited: bool, follows: np.ndarray, on_top: bool
    ) -> np.ndarray | None:
        is_action = isinstance(frame.child, int)
        if not self.ends(frame.task) or (is_action and self.learner.taught == "active"):
            return None
        return self._moved(frame, reward if is_action else F(0), after, exited, follows[:3])

    def _moved(self, frame: Frame, reward: F, after: int, exited: bool, follows: np.ndarray) -> np.ndarray:
        _, next_p, next_u = follows
        goal = F(self.graph.goal[frame.task][after]) if exited else frame.discount * next_p
        target = np.array([goal, reward + frame.discount * (F(0) if exited else next_u)], F)
        old = self.table[frame.task, frame.state, frame.child]
        return old + self.step_size * (target - old)

    def compare(self, learned: Any) -> None:
        learned = np.asarray(learned.q)
        num_states = len(self.graph.active[self.root])
        of_all, rest = np.split(learned, [num_states * len(self.actions)])
        expected = [self.table[SHARED, state, action][0] for state in range(num_states) for action in self.actions]
        np.testing.assert_array_equal(of_all, np.array(expected, F))
        learners = [task for task in self.graph.children if self.root_learns or task != self.root]
        width = max(len(self.graph.children[task]) for task in learners)
        tables = rest.reshape(len(learners), num_states, width, -1)  # U is there only where the root asks for it
        for number, task in enumerate(learners):
            for slot, child in enumerate(self.graph.children[task]):
                rows = np.stack([self.table[task, state, child] for state in range(num_states)])
                np.testing.assert_array_equal(
                    tables[number, :, slot], rows[:, : tables.shape[-1]], err_msg=f"{task}, {child}"
                )
