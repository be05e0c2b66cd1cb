"""H-DYNA: against plain Python bit for bit, and what it is without planning, and without options."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.core import random
from hrljax.learners.options.definition import primitive_options
from hrljax.learners.options.h_dyna import HDyna
from tests.learners.options.test_learner import EPISODES, GRID, PARAMS, ROOMS, PythonOptions, random_options
from tests.learners.python_levels import PythonEnv, train_in_python
from tests.words import KEY

F = np.float32
NUMBERS = {"step_size": 0.3, "epsilon": 0.3, "discount": 0.93, "initial_value": -8.0}


class PythonHDyna(PythonOptions):
    """A dictionary of last outcomes, in the order of first ones."""

    def __init__(self, learner: HDyna, options: Any):
        super().__init__(learner, options)
        self.models: dict[tuple[int, int], tuple[F, F, int]] = {}
        self.draw = jax.jit(self.drawn)

    def drawn(self, key: jax.Array) -> jax.Array:
        positions = jnp.arange(self.learner.planning_steps, dtype=jnp.uint32)
        return jax.vmap(lambda i: random.words((key[0], key[1]), i, 1)[0])(positions)

    def plan(self, after: int, over: bool, terminated: bool, words: list[int]) -> None:
        if over and (self.learner.models == "all" or self.option >= self.first):
            discount = F(0) if terminated else self.discount
            self.models[self.initiated, self.option] = self.rewards, discount, after
        for word in np.asarray(self.draw(np.array(words[1:], np.uint32))).tolist():
            if self.models:
                pair = list(self.models)[word % len(self.models)]
                reward, discount, end = self.models[pair]
                follows = self.q[end, self.best(end)] if discount else F(0)
                self.q[pair] += F(self.learner.step_size) * (reward + discount * follows - self.q[pair])


@pytest.mark.parametrize(
    ("update", "models"),
    [
        ("smdp", "all"),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (("smdp", "abstract"), ("intra_option", "all"))),
    ],
)
def test_a_run_gives_the_numbers_of_plain_python(update: Any, models: Any):
    options = random_options(True)
    learner = HDyna(options, update=update, **NUMBERS, planning_steps=3, models=models)
    run = jax.jit(lambda key: hrljax.train(GRID, learner, key, EPISODES, params=PARAMS))(KEY)
    walk = train_in_python(PythonHDyna(learner, options), PythonEnv(GRID, PARAMS), EPISODES)
    program = walk.program
    assert int(run.steps) == walk.steps
    learned = run.learned
    np.testing.assert_array_equal(np.asarray(learned.values).reshape(program.q.shape), program.q)
    pairs = [state * 7 + option for state, option in program.models]
    assert int(learned.num_visited) == len(pairs) > 20
    np.testing.assert_array_equal(learned.visited[: len(pairs)], pairs)
    outcomes = list(program.models.values())
    for table, column in zip(
        (learned.reward, learned.discount, learned.after), zip(*outcomes, strict=True), strict=True
    ):
        np.testing.assert_array_equal(np.asarray(table)[pairs], column)


@pytest.mark.slow
def test_without_planning_it_is_q_learning_over_options():
    def learned(learner: Any) -> Any:
        return jax.jit(lambda key: hrljax.train(GRID, learner, key, 50, params=PARAMS))(KEY)

    one = learned(HDyna(random_options(True), **NUMBERS, planning_steps=0))
    other = learned(hrljax.OptionQ(random_options(True), **NUMBERS))
    np.testing.assert_array_equal(one.learned.values, other.learned)
    np.testing.assert_array_equal(one.metrics["return"], other.metrics["return"])


@pytest.mark.slow
def test_with_primitive_options_alone_it_is_dyna_q():
    """On the same random words: both draw from all pairs that were ever visited, and remember what happened last."""

    def swept(learner: Any) -> Any:
        options = {"seeds": 3, "num_episodes": 40, "bin_size": 1, "params": PARAMS, "progress": False}
        return hrljax.sweep(GRID, learner, **options)

    one = swept(HDyna(primitive_options(GRID), **NUMBERS, planning_steps=4))
    other = swept(hrljax.DynaQ(**NUMBERS, planning_steps=4))
    for name in ("return", "length", "truncated"):
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


@pytest.mark.slow
def test_a_seed_has_one_result_under_every_mapping():
    learner = HDyna(random_options(True), **NUMBERS, planning_steps=3)
    options = {"seeds": 3, "num_episodes": 12, "bin_size": 1, "params": PARAMS, "progress": False}
    native, vmap = (hrljax.sweep(GRID, learner, mapping=mapping, **options) for mapping in ("native", "vmap"))
    for variable in native:
        np.testing.assert_array_equal(native[variable], vmap[variable], err_msg=str(variable))


@pytest.mark.slow
def test_models_of_options_spare_steps():
    """In four rooms with the ways to the hallways: fewer steps than without models over 50 episodes."""
    ways = hrljax.options_from(ROOMS.hierarchy(), ROOMS)
    learners = {
        "h-dyna": HDyna(ways, step_size=0.5),
        "options": hrljax.OptionQ(ways, step_size=0.5),
    }
    steps = {
        name: float(hrljax.sweep(ROOMS, learner, seeds=10, num_episodes=50, progress=False)["steps"].mean())
        for name, learner in learners.items()
    }
    assert steps["h-dyna"] < 0.8 * steps["options"], steps


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"planning_steps": -1}, "planning_steps must be an integer from 0"),
        ({"models": "none"}, "models must be one of"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=message):
        HDyna(random_options(True), **options)
