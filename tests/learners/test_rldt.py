"""RL-DT: against plain Python, and what its parts mean."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.core import random
from hrljax.learners.base import Transition
from hrljax.learners.effects import FactoredModel, Rewards, backed_up
from hrljax.learners.rldt import RLDT, SPITI
from hrljax.trees.classification import Data
from tests.learners.python_run import (
    PAIRS,
    assert_learns_only_when_live,
    assert_runs_as,
    assert_same_under_every_mapping,
    choose,
)
from tests.maps import SMALL
from tests.trees.python_trees import grown, leaves

F = np.float32
STATES = SMALL.num_states


class Planner:
    """Trees as lists of nodes, outcomes combined one by one."""

    def __init__(self, learner: RLDT):
        self.learner: Any = learner
        self.model = learner.prepare(SMALL)
        self.spec, self.states = self.model.trees, self.model.states
        pairs = np.arange(PAIRS)
        self.inputs = np.concatenate([self.states.values[pairs // 4], pairs[:, None] % 4], 1)
        self.q = np.full(PAIRS, learner.least_value, F)
        self.exploring = np.full(PAIRS, learner.optimistic_value, F)
        self.counts = [np.zeros((PAIRS, n), int) for n in self.spec.num_classes]
        self.rewards: list[F] = []
        self.forest: list[list[Any]] = []
        self.is_fresh, self.surprised, self.waited = True, False, 0
        self.plans = self.explored = 0

    def begin(self, state: int, words: list[int]) -> int:
        return self.chosen(state, words[0])

    def is_exploring(self, state: int) -> bool:
        promised = self.q[state * 4 : state * 4 + 4].max()
        return self.learner.explores and bool(promised < F(self.learner.satisfying_value))

    def chosen(self, state: int, word: int) -> int:
        self.explored += self.is_exploring(state)
        return choose(self.exploring if self.is_exploring(state) else self.q, state, word, self.learner.epsilon)

    def learn(self, state: int, action: int, reward: F, after: int, terminated: bool, words: list[int]) -> int:
        pair, step = state * 4 + action, self.classes(state, reward, after, terminated)
        surprised = any(self.probability(kind, pair, which) < F(self.learner.refit_below) for kind, which in step)
        for kind, which in step:
            self.counts[kind][pair, which] += 1
        self.is_fresh &= self.visits()[pair] != self.learner.known_after
        self.surprised |= surprised
        self.waited += 1
        needs = self.surprised or (self.is_exploring(after) and not self.is_fresh)
        if needs and self.waited >= self.learner.refit_interval:
            self.plan(after, words[1:])
        return self.chosen(after, words[0])

    def visits(self) -> np.ndarray:
        return self.counts[-1].sum(1)

    def classes(self, state: int, reward: F, after: int, terminated: bool) -> list[tuple[int, int]]:
        """Kinds of trees that learn from a step, and its class of each."""
        if reward not in self.rewards and len(self.rewards) < self.learner.max_rewards:
            self.rewards.append(reward)
        step = []
        for v, size in enumerate(self.states.sizes if not terminated else ()):
            change = self.states.values[after, v] - self.states.values[state, v] + size - 1
            step.append((v, int(change if self.learner.effects == "relative" else self.states.values[after, v])))
        kinds = len(self.counts)
        nearest = int(np.argmin([abs(reward - known) for known in self.rewards]))
        return [*step, (kinds - 2, nearest), (kinds - 1, int(terminated))]

    def probability(self, kind: int, pair: int, which: int) -> F:
        if not self.forest:
            return F(0)
        chance = F(0)
        for nodes in self.forest[kind]:
            counts = nodes[int(leaves(nodes, self.inputs[pair : pair + 1])[0])][2]
            chance += F(counts[which]) * (F(1) / F(max(sum(counts), 1)))
        return chance * F(1 / len(self.forest[kind]))

    def plan(self, state: int, words: list[int]) -> None:
        self.plans += 1
        self.surprised, self.waited = False, 0
        self.forest = [
            [self.tree(kind, number, words) for number in range(self.learner.num_trees)]
            for kind in range(len(self.counts))
        ]
        backed_up = self.outcomes()
        self.q = self.settled(self.q, lambda q: backed_up(q))
        if self.learner.explores:
            self.is_fresh = self.is_exploring(state)
            if self.is_fresh:
                known = self.visits() >= self.learner.known_after
                self.exploring = self.settled(
                    self.exploring, lambda q: np.where(known, backed_up(q), F(self.learner.optimistic_value))
                )

    def tree(self, kind: int, number: int, words: list[int]) -> list[Any]:
        seen = np.flatnonzero(self.visits())
        kept = None
        if words:
            key = tuple(map(jnp.uint32, words))
            first = (number * len(self.counts) + kind) * self.learner.max_nodes
            numbers = jnp.arange(self.learner.max_nodes, dtype=jnp.uint32) + np.uint32(first)
            kept = np.asarray(drawn(key, numbers, len(self.spec.sizes))) >= F(self.learner.left_out) * 2**24
        return grown(self.spec, self.inputs[seen], self.counts[kind][seen], self.learner.least_score, kept)

    def outcomes(self) -> Any:
        """The backup of action values under the model."""
        chances = []
        for of_kind in self.forest:
            total = F(0)
            for nodes in of_kind:
                counts = np.array([node[2] for node in nodes])
                shares = counts.astype(F) * (F(1) / np.maximum(counts.sum(1), 1).astype(F))[:, None]
                total = total + shares[leaves(nodes, self.inputs)]
            chances.append(total * F(1 / len(of_kind)))
        *variables, of_rewards, of_ends = chances
        reward = np.zeros(PAIRS, F)
        for number, value in enumerate(self.rewards):
            reward += value * of_rewards[:, number]
        combined: list[list[tuple[F, int]]] = []
        for pair in range(PAIRS):
            options = [self.options(v, chance[pair], pair) for v, chance in enumerate(variables)]
            combined.append(self.combinations(options, pair // 4))
        sums = np.array([np.add.accumulate([F(0), *(w for w, _ in row)], dtype=F)[-1] for row in combined])
        follows = of_ends[:, 0] / np.maximum(sums, F(1e-6))
        width = max(map(len, combined))
        padded = [row + [(F(0), 0)] * (width - len(row)) for row in combined]
        weights, states = (np.array([[o[i] for o in row] for row in padded], t) for i, t in ((0, F), (1, int)))

        def backed_up(q: np.ndarray) -> np.ndarray:
            value, after = q.reshape(-1, 4).max(1), np.zeros(PAIRS, F)
            for m in range(width):
                after += weights[:, m] * value[states[:, m]]
            q = reward + F(self.learner.discount) * (follows * after)
            return np.clip(q, F(self.learner.least_value), F(self.learner.optimistic_value))

        return backed_up

    def options(self, v: int, chance: np.ndarray, pair: int) -> list[tuple[Any, int]]:
        """The likeliest next values of a variable."""
        size, now = self.states.sizes[v], int(self.states.values[pair // 4, v])
        likeliest = [c for c in np.argsort(-chance, kind="stable")[:4].tolist() if chance[c] > 0]
        if self.learner.effects == "relative":
            return [(chance[c], min(max(now + c - size + 1, 0), size - 1)) for c in likeliest]
        return [(chance[c], c) for c in likeliest]

    def combinations(self, options: list[list[tuple[F, int]]], state: int) -> list[tuple[F, int]]:
        """Weights and next states, the first variable changing fastest."""
        rows: list[list[tuple[F, int]]] = [[]]
        for of_variable in options[::-1]:
            rows = [[option, *rest] for rest in rows for option in of_variable]
        result = []
        for row in rows[: self.learner.max_outcomes]:
            weight = F(1)
            for chance, _ in row:
                weight *= chance
            after = int(self.states.number[self.states.place([value for _, value in row])])
            result.append((weight, state if after < 0 else after))
        return result

    def settled(self, q: np.ndarray, sweep: Any) -> np.ndarray:
        for _ in range(self.learner.planning_sweeps):
            before, q = q, sweep(q)
            if np.abs(q - before).max() <= F(self.learner.planning_tolerance):
                break
        return q


def drawn(key: Any, numbers: jax.Array, count: int) -> jax.Array:
    return jax.jit(jax.vmap(lambda i: jnp.stack(random.words(key, i, count))))(numbers)


@pytest.mark.parametrize(
    "learner",
    [
        RLDT(
            epsilon=0.125,
            satisfying_value=-30.0,
            least_value=-50.0,
            discount=0.97,
            known_after=2,
            refit_interval=130,
            planning_sweeps=20,
            planning_tolerance=0.5,
            max_nodes=41,
        ),
        pytest.param(
            SPITI(
                ties="first",
                epsilon=0.75,
                least_value=-50.0,
                least_score=3.0,
                refit_interval=300,
                num_trees=2,
                left_out=0.25,
                max_rewards=1,
                max_outcomes=5,
                max_nodes=21,
            ),
            marks=pytest.mark.slow,
        ),
    ],
    ids=str,
)
def test_a_run_gives_the_numbers_of_plain_python(learner: RLDT):
    program = Planner(learner)
    assert_runs_as(program, learner)
    assert program.plans > 3
    assert bool(program.explored) == learner.explores
    assert len(np.unique(program.q)) > 50


def test_a_seed_has_one_result_under_every_mapping():
    learner = RLDT(epsilon=0.125, satisfying_value=-30.0, least_value=-50.0, refit_interval=20, max_nodes=63)
    assert_same_under_every_mapping(learner, {"least_score": [1e-4, 0.2]})


@pytest.mark.slow
def test_a_forest_has_one_result_under_every_mapping():
    learner = SPITI(epsilon=0.75, num_trees=2, refit_interval=40, max_nodes=31, least_value=-50.0)
    assert_same_under_every_mapping(learner, {"left_out": [0.0, 0.5]})


def test_a_step_that_is_not_live_changes_nothing():
    assert_learns_only_when_live(RLDT(discount=0.5, known_after=2, planning_sweeps=1))


def counted(model: FactoredModel, steps: list[tuple[int, int, float, int, bool]]) -> tuple[jax.Array, Rewards]:
    """The counts of steps: state, action, reward, next state, whether it ended."""
    counts, rewards = model.no_counts(), Rewards(jnp.zeros(model.num_rewards, jnp.float32), jnp.int32(0))
    for state, action, reward, after, ended in steps:
        numbers = jnp.int32(state), jnp.int32(action), jnp.float32(reward), jnp.int32(after)
        step = Transition(*numbers, jnp.bool_(ended))
        classes, rewards = model.classes(step, rewards)
        pair = jnp.int32(state * model.num_actions + action)
        counts = model.counted(counts, pair, classes, step.terminated, jnp.bool_(True))
    return counts, rewards


CORRIDOR = hrljax.make("Gridworld", map="S....\n....G")
"""Ten cells in two rows of five; east is action 1, south action 2."""


@pytest.mark.parametrize(("effects", "after_east"), [("relative", [1, 2, 3, 4, 4]), ("absolute", [2, 2, 2, 2, 2])])
def test_one_step_tells_what_the_same_step_does_elsewhere(effects: Any, after_east: list[int]):
    """Of relative effects: one column further, up to the wall; of absolute ones: to where it led."""
    model = RLDT(effects=effects).prepare(CORRIDOR)
    counts, rewards = counted(model, [(1, 1, -1.0, 2, False)])
    data = Data(jnp.asarray(model.cells), counts, jnp.full(40, 5, jnp.int32), jnp.int32(1))
    forest = model.trees.fit(data, jnp.float32(1e-4), jnp.uint32(0))
    outcomes = model.predicted(forest, rewards, jnp.uint32(0))
    pairs = np.arange(5) * 4 + 1
    np.testing.assert_array_equal(outcomes.next_state[pairs], after_east)
    np.testing.assert_array_equal(outcomes.reward, np.full(40, -1, F))
    np.testing.assert_array_equal(outcomes.follows, np.ones(40, F))
    assert int(outcomes.most) == 1


def test_outcomes_are_products_of_what_the_variables_become():
    """From cell 6 to the east: three times in four a column further, once a row up too; the end is once in five."""
    model = RLDT().prepare(CORRIDOR)
    steps = [(6, 1, -1.0, 7, False)] * 3 + [(6, 1, -3.0, 2, False), (6, 1, -1.0, 0, True)]
    counts, rewards = counted(model, steps)
    assert int(model.seen_before(counts, jnp.int32(25))) == 5
    data = Data(jnp.asarray(model.cells), counts, jnp.full(40, 25, jnp.int32), jnp.int32(1))
    forest = model.trees.fit(data, jnp.float32(1e-4), jnp.uint32(0))
    outcomes = model.predicted(forest, rewards, jnp.uint32(0))
    assert outcomes.next_state.reshape(-1, 40)[:2, 25].tolist() == [7, 2]
    np.testing.assert_allclose(outcomes.weight.reshape(-1, 40)[:2, 25], [0.75, 0.25], rtol=1e-6)
    assert float(outcomes.reward[25]) == pytest.approx(-1.4)
    assert float(outcomes.follows[25]) == pytest.approx(0.8)
    values = jnp.arange(10, dtype=jnp.float32)
    expected = -1.4 + 0.5 * 0.8 * (0.75 * 7 + 0.25 * 2)
    assert float(backed_up(outcomes, values, jnp.float32(0.5), jnp.uint32(0))[25]) == pytest.approx(expected)


def test_rewards_beyond_the_last_place_count_as_the_nearest():
    model = RLDT(max_rewards=2).prepare(CORRIDOR)
    steps = [(0, 1, reward, 1, False) for reward in (-1.0, 5.0, 3.0, 0.0, -1.0)]
    counts, rewards = counted(model, steps)
    first = model.trees.first_class[2]
    assert rewards.values.tolist() == [-1, 5]
    assert counts[1 * model.trees.width + first :][:2].tolist() == [3, 2]


def test_no_value_is_greater_than_what_any_policy_can_earn():
    """Of a corridor in which every step earns 1, so that trees believe in going to and fro for ever."""
    options = {"num_episodes": 2, "params": CORRIDOR.default_params._replace(step_reward=1.0, max_steps=30)}
    learner = RLDT(optimistic_value=7.0, least_value=-10.0, max_nodes=15)
    learned = jax.jit(lambda key: hrljax.train(CORRIDOR, learner, key, **options))(jax.random.key(0)).learned
    assert float(learned.values.max()) == 7.0


@pytest.mark.slow
def test_spiti_finds_a_passenger_that_chance_alone_delivers():
    """On the Taxi, where trees expect of untried actions what tried ones do."""
    env = hrljax.make("Taxi")
    options = {"seeds": 2, "num_episodes": 150, "bin_size": 50, "evaluate_every": 1, "progress": False}
    curves = hrljax.sweep(env, SPITI(optimistic_value=20.0), **options)
    optimum = env.initial_distribution() @ hrljax.solvers.value_iteration(env.model()).value
    np.testing.assert_allclose(curves["greedy_return"].max("checkpoint"), optimum, atol=1e-3)


def test_the_optimum_is_reached_in_a_few_episodes():
    """Of four rooms, where R-MAX has to try every action in every cell."""
    env = hrljax.make("Gridworld")
    options = {"seeds": 2, "num_episodes": 12, "bin_size": 4, "evaluate_every": 1, "progress": False}
    curves = hrljax.sweep(env, RLDT(), **options)
    optimum = env.initial_distribution() @ hrljax.solvers.value_iteration(env.model()).value
    np.testing.assert_allclose(curves["greedy_return"][:, -1], optimum, atol=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"effects": "both"}, "RLDT: effects must be one of 'relative', 'absolute'"),
        ({"score": "gini"}, "RLDT: score must be one of 'gain_ratio', 'chi_squared'"),
        ({"num_trees": 0}, "RLDT: num_trees must be an integer from 1 to 100, got 0"),
        ({"explores": "yes"}, "RLDT: explores must be one of False, True, got 'yes'"),
        ({"max_nodes": 0}, "RLDT: max_nodes must be an integer from 1 to 32768, got 0"),
        ({"refit_below": 1.5}, r"RLDT: refit_below must be a finite number in \[0, 1\], got 1\.5"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str):
    with pytest.raises((TypeError, ValueError), match=message):
        RLDT(**options)
