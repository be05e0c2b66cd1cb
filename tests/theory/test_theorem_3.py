"""Theorem 3: HORDQ's update rules converge to the optimal values when all actions are children of every leaf.

That the sum of the parts is exactly Q-learning's table is `tests/learners/test_identities.py`.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array, lax

from hrljax.learners import updates
from hrljax.learners.hordq import Q, hordq_target
from tests.contexts import learning
from tests.strategies import SHARES, Problem, random_problem

PSEUDO = 3
POWER = 0.85
"""Step sizes n^-0.85 of the n-th visit: their sum diverges, that of their squares does not."""
STAGES = (2_000, 300_000)


def small_problem() -> Problem:
    generator = np.random.default_rng(2)
    while True:
        problem = random_problem(generator, 2, num_states=8, num_actions=3, discount=0.7, ending=0.0, width=2)
        if len(problem.hierarchy.leaf_cover()) == 2 and np.all(problem.active[1:].mean(1) < 0.7):
            return problem


@pytest.fixture(scope="module")
def curves() -> Any:
    """By whether exit values are learned: greatest errors of the values after the updates of `STAGES`."""
    problem = small_problem()
    with jax.enable_x64(True):
        run = jax.jit(lambda exits: errors(problem, exits))
        return {exits: np.asarray(run(jnp.bool_(exits))) for exits in (True, False)}


def errors(problem: Problem, exits: Array) -> Array:
    """One long episode: a random root, leaves that act at random, bootstraps on the greedy child."""
    num_states, num_actions = problem.reward.shape
    active = jnp.asarray(problem.active[1:])
    outcomes, reward = jnp.asarray(problem.outcomes), jnp.asarray(problem.reward, jnp.float64)
    discount, zero = jnp.float64(problem.discount), jnp.uint32(0)
    first_chance = jnp.asarray(problem.active[1] / problem.active[1:].sum(0))  # that the root invokes the first leaf
    optimal = jnp.asarray(problem.optimal_q())[None]

    def step(carry: tuple[Array, Array, Array, Array], key: Array) -> tuple[Any, None]:
        tables, visits, task, state = carry
        a, b, c = jax.random.split(key, 3)
        action = jax.random.randint(a, (), 0, num_actions)
        after = outcomes[state, action, jax.random.randint(b, (), 0, SHARES)]
        exited = ~active[task, after]
        invoked = (jax.random.uniform(c) >= first_chance[after]).astype(jnp.int32)
        next_task = jnp.where(exited, invoked, task)
        row = tables[next_task, after]
        child = jnp.argmax(row[:, :PSEUDO].sum(-1))
        empty = jnp.float64(0)
        gamma = learning().discounted(discount)
        target = hordq_target(reward[state, action], gamma, exited, empty, Q(*row[child]))
        target = target._replace(e=jnp.where(exits, target.e, empty))
        at = task, state, action
        visits = visits.at[at].add(1)
        new = updates.increment(tables[at], jnp.stack(target), visits[at] ** -POWER, jnp.bool_(True), zero)
        return (tables.at[at].set(new), visits, next_task, after), None

    visits = jnp.zeros((2, num_states, num_actions), jnp.float64)
    first = jnp.argmax(active[:, 0]).astype(jnp.int32)
    carry = jnp.zeros((*visits.shape, 4), jnp.float64), visits, first, jnp.int32(0)
    actual = []
    keys = jax.random.split(jax.random.key(0), STAGES[-1])
    for low, high in zip((0, *STAGES), STAGES, strict=False):
        carry, _ = lax.scan(step, carry, keys[low:high])
        off = jnp.abs(carry[0][..., :PSEUDO].sum(-1) - optimal)
        actual.append(jnp.where(active[..., None], off, 0).max())
    return jnp.stack(actual)


def test_the_sum_of_the_parts_converges_to_the_optimal_values(curves: Any):
    early, late = curves[True]
    assert late < 0.04
    assert early > 4 * late


def test_without_exit_values_the_same_rules_do_not(curves: Any):
    assert curves[False].min() > 0.8
