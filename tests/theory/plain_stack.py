"""Execution of a task hierarchy in plain Python, on a stack of names: shares nothing with the solvers."""

import numpy as np

from tests.strategies import ENDED, SHARES, Problem

Stack = tuple[str, ...]
Node = tuple[Stack, int]


class PlainStack:
    """Nodes are (stack, state); the last name on the stack has control."""

    def __init__(self, problem: Problem, policy: np.ndarray, termination: str = "immediate"):
        self.problem, self.hierarchy, self.policy = problem, problem.hierarchy, policy
        self.immediate = termination == "immediate"
        self._choices: dict[tuple[str, int], list[tuple[str, float]]] = {}
        self._after: dict[tuple[Stack, int, str], tuple[float, dict[Node, float]]] = {}
        self.cover = set(problem.hierarchy.leaf_cover())

    def active(self, name: str, state: int) -> bool:
        return bool(self.problem.active[self.hierarchy.index(name), state])

    def choices(self, stack: Stack, state: int) -> list[tuple[str, float]]:
        """The children that the subtask in control may invoke, with their probabilities."""
        if (stack[-1], state) not in self._choices:
            number = self.hierarchy.index(stack[-1])
            self._choices[stack[-1], state] = [
                (child, float(self.policy[number, state, slot]))
                for slot, child in enumerate(self.hierarchy[stack[-1]].children)
                if self.hierarchy.is_primitive(child) or self.active(child, state)
            ]
        return self._choices[stack[-1], state]

    def unwound(self, stack: Stack, state: int) -> Stack:
        """The stack when a step has led to a state: terminated subtasks end, with what they called."""
        if self.immediate:
            for depth, name in enumerate(stack):
                if not self.active(name, state):
                    return stack[:depth]
            return stack
        while stack and not self.active(stack[-1], state):
            stack = stack[:-1]
        return stack

    def after(self, stack: Stack, state: int, child: str) -> tuple[float, dict[Node, float]]:
        """Expected reward, and undiscounted probabilities of who has control next, of invoking a child."""
        if (stack, state, child) not in self._after:
            self._after[stack, state, child] = self._played(stack, state, child)
        return self._after[stack, state, child]

    def _played(self, stack: Stack, state: int, child: str) -> tuple[float, dict[Node, float]]:
        if not self.hierarchy.is_primitive(child):
            return 0.0, {((*stack, child), state): 1.0}
        action = self.hierarchy.actions.index(child)
        follows: dict[Node, float] = {}
        for next_state in self.problem.outcomes[state, action].tolist():
            if next_state == ENDED:
                continue
            left = self.unwound(stack, next_state)
            assert left, "the root has ended"
            follows[left, next_state] = follows.get((left, next_state), 0.0) + 1 / SHARES
        return float(self.problem.reward[state, action]), follows

    def discount(self, child: str) -> float:
        return self.problem.discount if self.hierarchy.is_primitive(child) else 1.0

    def next_in_cover(self, stack: Stack, state: int) -> dict[Node, float]:
        """Who of the leaf cover takes control (i' of eq. 3.6), from whoever has it."""
        if stack[-1] in self.cover:
            return {(stack, state): 1.0}
        actual: dict[Node, float] = {}
        for child, chance in self.choices(stack, state):
            for node, further in self.next_in_cover((*stack, child), state).items():
                actual[node] = actual.get(node, 0.0) + chance * further
        return actual

    def nodes(self) -> list[Node]:
        """Everything that can be reached from the root in some state, under any policy."""
        queue: list[Node] = [(("Root",), s) for s in range(len(self.problem.outcomes))]
        seen = set(queue)
        while queue:
            stack, state = queue.pop()
            for child, _ in self.choices(stack, state):
                for node in self.after(stack, state, child)[1].keys() - seen:
                    seen.add(node)
                    queue.append(node)
        return sorted(seen)

    def parts_by_playing(self, stack: Stack, state: int, child: str, steps: int) -> np.ndarray:
        """Reward while a child runs, from there while its caller runs, and from there on, over some choices.

        Straight from the definition (eq. 3.1): probabilities are pushed forward, and every reward is
        booked by what has ended so far.
        """
        booked = np.zeros(3)
        primitive = self.hierarchy.is_primitive(child)
        reward, follows = self.after(stack, state, child)
        booked[0] += reward
        ahead: dict[tuple[Node, int], float] = {}

        def phase(before: int, now: Stack) -> int:
            child_runs = not primitive and now[: len(stack) + 1] == (*stack, child)
            return max(before, 0 if child_runs else 1 if now[: len(stack)] == stack else 2)

        for node, chance in follows.items():
            ahead[node, phase(0, node[0])] = chance * self.discount(child)
        for _ in range(steps):
            after: dict[tuple[Node, int], float] = {}
            for ((now, at), before), weight in ahead.items():
                for choice, chance in self.choices(now, at):
                    reward, follows = self.after(now, at, choice)
                    booked[before] += weight * chance * reward
                    for node, further in follows.items():
                        key = node, phase(before, node[0])
                        after[key] = after.get(key, 0.0) + weight * chance * further * self.discount(choice)
            ahead = after
        return booked
