"""Theorem 1: Q_r + Q_c + Q_e of a hierarchical policy satisfies the Bellman equation of primitive steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.solvers import decompose, joint_process
from hrljax.solvers.decomposition import Decomposed
from tests.strategies import Problem, problems, random_policy, random_problem
from tests.theory.plain_stack import PlainStack, Stack

TERMINATIONS = ("immediate", "on_return")


class Evaluated:
    """A random problem's random policy, with its parts by stack of names."""

    def __init__(self, problem: Problem, policy: np.ndarray, termination: str = "immediate"):
        self.play = PlainStack(problem, policy, termination)
        self.process = joint_process(
            problem.hierarchy, problem.active, problem.model, discount=problem.discount, termination=termination
        )
        self.values: Decomposed = decompose(self.process, self.process.weights(policy))
        self.context: dict[Stack, int] = {("Root",): 0}
        for number in range(1, self.process.contexts.size):
            name = problem.hierarchy.subtasks[self.process.contexts.task[number]].name
            caller = {c: stack for stack, c in self.context.items()}[self.process.contexts.parent[number]]
            self.context[(*caller, name)] = number

    def at(self, stack: Stack, state: int, child: str) -> tuple[int, int, int]:
        return self.context[stack], state, self.play.hierarchy[stack[-1]].children.index(child)

    def followed(self, table: np.ndarray, stack: Stack, state: int) -> float:
        """What the policy makes of a table of children."""
        return sum(p * table[self.at(stack, state, child)] for child, p in self.play.choices(stack, state))


def check_theorem_1(actual: Evaluated) -> int:
    """Residuals of the primitive equation and of the identities of composite children; how many of the latter."""
    play, q, values = actual.play, actual.values.q, actual.values
    composites = 0
    for stack, state in play.nodes():
        for child, _ in play.choices(stack, state):
            at = actual.at(stack, state, child)
            if play.hierarchy.is_primitive(child):
                reward, follows = play.after(stack, state, child)
                target = reward
                for (left, after), chance in follows.items():
                    for (next_stack, _), further in play.next_in_cover(left, after).items():
                        value = actual.followed(q, next_stack, after)
                        target += play.problem.discount * chance * further * value
                assert q[at] == pytest.approx(target, abs=1e-10)
                assert values.reward[at] == pytest.approx(reward, abs=1e-12)
            else:
                composites += 1
                called = (*stack, child)
                assert q[at] == pytest.approx(actual.followed(q, called, state), abs=1e-10)
                until_end = actual.followed(values.reward + values.completion, called, state)
                assert values.reward[at] == pytest.approx(until_end, abs=1e-10)  # eq. 3.3
        assert values.value[actual.context[stack], state] == pytest.approx(actual.followed(q, stack, state), abs=1e-10)
    return composites


@given(problem=problems(levels=(2, 3, 3, 4), max_states=5), seed=st.integers(0, 2**32 - 1), deterministic=st.booleans())
@settings(deadline=None, max_examples=20)
def test_the_parts_sum_to_a_solution_of_the_primitive_bellman_equation(
    problem: Problem, seed: int, deterministic: bool
):
    policy = random_policy(np.random.default_rng(seed), problem, deterministic)
    assert check_theorem_1(Evaluated(problem, policy)) > 0


@given(problem=problems(levels=(2, 3), max_states=5), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=15)
def test_theorem_1_does_not_depend_on_when_a_termination_is_noticed(problem: Problem, seed: int):
    check_theorem_1(Evaluated(problem, random_policy(np.random.default_rng(seed), problem), "on_return"))


@pytest.mark.parametrize("termination", TERMINATIONS)
@pytest.mark.parametrize("levels", [2, 3])
def test_each_part_is_the_reward_of_its_time(levels: int, termination: str):
    """Q_r while the child runs, Q_c while its caller does, Q_e afterwards: by playing them out."""
    generator = np.random.default_rng(levels)
    problem = random_problem(generator, levels, num_states=4, num_actions=2, discount=0.5, width=2)
    actual = Evaluated(problem, random_policy(generator, problem), termination)
    nodes = actual.play.nodes()
    used = np.zeros(3, np.bool_)
    for number in generator.permutation(len(nodes))[:8]:
        stack, state = nodes[number]
        for child, _ in actual.play.choices(stack, state):
            played = actual.play.parts_by_playing(stack, state, child, steps=50 * levels)
            at = actual.at(stack, state, child)
            parts = actual.values.reward[at], actual.values.completion[at], actual.values.exit[at]
            np.testing.assert_allclose(parts, played, atol=1e-12)
            used |= np.abs(parts) > 0.01
    assert used.all()


def test_the_root_leaves_nothing_for_after_its_end():
    problem = random_problem(np.random.default_rng(1), 3)
    actual = Evaluated(problem, random_policy(np.random.default_rng(2), problem))
    rows = actual.values.exit[0]
    assert np.all((rows == 0) | np.isnan(rows))
