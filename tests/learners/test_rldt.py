"""RL-DT: against plain Python, and what its parts mean."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import hrljax
from hrljax.engine import compiler
from hrljax.learners.base import Transition
from hrljax.learners.effects import FactoredModel, Numbers, Outcomes, backed_up
from hrljax.learners.rldt import RLDT, SPITI
from hrljax.trees.classification import Data
from tests.learners.python_planner import Planner
from tests.learners.python_run import (
    assert_learns_only_when_live,
    assert_runs_as,
    assert_same_under_every_mapping,
    choose,
)
from tests.maps import SMALL, optimum

F = np.float32


class Learning(Planner):
    """A flat learner that does what the plan says."""

    def __init__(self, learner: RLDT):
        super().__init__(learner, learner.prepare(SMALL), learner.num_trees)

    def begin(self, state: int, words: list[int]) -> int:
        return self.chosen(state, words[0])

    def chosen(self, state: int, word: int) -> int:
        return choose(self.worth(state), 0, word, self.learner.epsilon)

    def learn(self, state: int, action: int, reward: F, after: int, terminated: bool, words: list[int]) -> int:
        self.see(state, action, reward, after, F(not terminated), terminated, words[1:])
        return self.chosen(after, words[0])


@pytest.mark.slow
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
    ],
    ids=str,
)
def test_a_run_gives_the_numbers_of_plain_python(learner: RLDT):
    program = Learning(learner)
    assert_runs_as(program, learner)
    assert program.plans > 3
    assert bool(program.explored) == learner.explores
    assert len(np.unique(program.q)) > 50


@pytest.mark.slow
def test_a_seed_has_one_result_under_every_mapping():
    learner = RLDT(epsilon=0.125, satisfying_value=-30.0, least_value=-50.0, refit_interval=20, max_nodes=63)
    assert_same_under_every_mapping(learner, {"least_score": [1e-4, 0.2]})


@pytest.mark.slow
def test_a_forest_has_one_result_under_every_mapping():
    learner = SPITI(epsilon=0.75, num_trees=2, refit_interval=40, max_nodes=31, least_value=-50.0)
    assert_same_under_every_mapping(learner, {"left_out": [0.0, 0.5]})


@pytest.mark.slow
def test_a_step_that_is_not_live_changes_nothing():
    assert_learns_only_when_live(RLDT(discount=0.5, known_after=2, planning_sweeps=1))


def counted(model: FactoredModel, steps: list[tuple[int, int, float, int, bool]]) -> tuple[jax.Array, Numbers]:
    """The counts of steps: state, action, reward, next state, whether it ended."""
    counts, seen = model.no_counts(), model.no_numbers()
    for state, action, reward, after, ended in steps:
        numbers = jnp.int32(state), jnp.int32(action), jnp.float32(reward), jnp.int32(after)
        step = Transition(*numbers, jnp.bool_(ended))
        classes, seen = model.classes(step, jnp.float32(not ended), seen)
        pair = jnp.int32(state * model.num_actions + action)
        row = model.row_after(model.row(counts, pair), classes, step.terminated)
        counts = model.with_row(counts, pair, row)
    return counts, seen


def test_a_row_of_counts_is_written_in_place():
    """All counts of a step's loop are one array: to copy it in every step takes ten times as long as the step."""
    model = RLDT().prepare(CORRIDOR)
    unlike = [jnp.int32(0) for _ in model.trees.num_classes]

    def step(pair: jax.Array, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        counts, new = carry
        row = model.row(counts, pair)
        new = new + (model.times_taken(row) == 0).astype(jnp.int32)
        return model.with_row(counts, pair, model.row_after(row, unlike, jnp.bool_(False))), new

    def steps(counts: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Each of 40 pairs twice."""
        return lax.fori_loop(jnp.int32(0), jnp.int32(80), lambda i, carry: step(i // 2, carry), (counts, jnp.int32(0)))

    counts = model.no_counts()
    compiled = jax.jit(steps, donate_argnums=0, compiler_options=dict(compiler.NESTED_OPTIONS)).lower(counts).compile()
    assert not re.findall(rf"s32\[{len(counts)}\]\S* copy\(", compiled.as_text() or "")
    counts, new = compiled(counts)
    assert int(new) == 40
    assert model.times_taken(model.rows(counts)).tolist() == [2] * 40


def predicted(model: FactoredModel, steps: list[tuple[int, int, float, int, bool]], pair: int) -> Outcomes:
    """What trees say that have learned from steps, all of one pair of a state and an action."""

    @jax.jit
    def of_trees() -> Outcomes:
        counts, seen = counted(model, steps)
        data = Data(jnp.asarray(model.cells), counts, jnp.full(40, pair, jnp.int32), jnp.int32(1))
        forest = model.trees.fit(data, jnp.float32(1e-4), jnp.uint32(0))
        return model.predicted(forest, seen, jnp.uint32(0))

    return of_trees()


CORRIDOR = hrljax.make("Gridworld", map="S....\n....G")
"""Ten cells in two rows of five; east is action 1, south action 2."""


@pytest.mark.parametrize(("effects", "after_east"), [("relative", [1, 2, 3, 4, 4]), ("absolute", [2, 2, 2, 2, 2])])
def test_one_step_tells_what_the_same_step_does_elsewhere(effects: Any, after_east: list[int]):
    """Of relative effects: one column further, up to the wall; of absolute ones: to where it led."""
    model = RLDT(effects=effects).prepare(CORRIDOR)
    outcomes = predicted(model, [(1, 1, -1.0, 2, False)], pair=5)
    pairs = np.arange(5) * 4 + 1
    np.testing.assert_array_equal(outcomes.next_state[pairs], after_east)
    np.testing.assert_array_equal(outcomes.reward, np.full(40, -1, F))
    np.testing.assert_array_equal(outcomes.follows, np.ones(40, F))
    assert int(outcomes.most) == 1


def test_outcomes_are_products_of_what_the_variables_become():
    """From cell 6 to the east: three times in four a column further, once a row up too; the end is once in five."""
    model = RLDT().prepare(CORRIDOR)
    steps = [(6, 1, -1.0, 7, False)] * 3 + [(6, 1, -3.0, 2, False), (6, 1, -1.0, 0, True)]
    counts, _ = jax.jit(lambda: counted(model, steps))()
    assert int(model.times_taken(model.row(counts, jnp.int32(25)))) == 5
    assert model.times_taken(model.rows(counts)).tolist() == [5 if pair == 25 else 0 for pair in range(40)]
    outcomes = predicted(model, steps, pair=25)
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
    counts, seen = jax.jit(lambda: counted(model, steps))()
    first = model.trees.first_class[2]
    assert seen.rewards.values.tolist() == [-1, 5]
    assert counts[1 * model.trees.width + first :][:2].tolist() == [3, 2]


@pytest.mark.slow
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
    np.testing.assert_allclose(curves["greedy_return"].max("checkpoint"), optimum(env), atol=1e-3)


@pytest.mark.slow
def test_the_optimum_is_reached_in_a_few_episodes():
    """Of four rooms, where R-MAX has to try every action in every cell."""
    env = hrljax.make("Gridworld")
    options = {"seeds": 2, "num_episodes": 12, "bin_size": 4, "evaluate_every": 1, "progress": False}
    curves = hrljax.sweep(env, RLDT(), **options)
    np.testing.assert_allclose(curves["greedy_return"][:, -1], optimum(env), atol=1e-3)


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
