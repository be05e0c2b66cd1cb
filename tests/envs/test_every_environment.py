"""What holds for every registered tabular environment: the contract, and simulator against model."""

from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hrljax as hrl
from hrljax import random
from hrljax.envs.maze import Maze
from hrljax.random import WORD_RANGE
from hrljax.solvers import Model
from tests.maps import SMALL

VARIANTS = {
    "Bus": (hrl.make("Bus", map=SMALL.map), {}),
    "Gridworld": (hrl.make("Gridworld"), {}),
    "Gridworld-slippery-cliff": (hrl.make("Gridworld", map="cliff"), {"slip_probability": 0.3}),
    "Maze": (hrl.make("Maze"), {}),
    "Maze-slippery": (hrl.make("Maze"), {"slip_probability": 0.5}),
    "Taxi": (hrl.make("Taxi"), {}),
    "Taxi-both-gymnasium": (hrl.make("Taxi", stochastic=True, fickle=True, rules="gymnasium"), {}),
    "Taxi-fickle": (hrl.make("Taxi", fickle=True), {"fickle_probability": 0.75, "slip_probability": 0.1}),
}
each_variant = pytest.mark.parametrize("variant", VARIANTS)


def made(variant: str) -> tuple[Any, Any]:
    env, numbers = VARIANTS[variant]
    return env, env.default_params._replace(**numbers)


@cache
def model_of(variant: str) -> Model:
    env, params = made(variant)
    return env.model(params)


@cache
def all_states(env: Any) -> Any:
    """Fields ``[S]``, NumPy's so that they can be constants of several programs."""
    with jax.ensure_compile_time_eval():
        return jax.tree.map(np.asarray, jax.vmap(env.decode)(jnp.arange(env.num_states, dtype=jnp.int32)))


def occurring(env: Any, params: Any, model: Model) -> np.ndarray:
    """``[S]`` bool: states in which an episode can have a next step."""
    successors = model.successors().reshape(env.num_states, -1)
    occurs, before = env.initial_distribution(params) > 0, np.zeros(env.num_states, np.bool_)
    while (occurs != before).any():
        before = occurs.copy()
        following = successors[before]
        occurs[following[following >= 0]] = True
    return occurs


def described(tree: Any) -> list[tuple[Any, ...]]:
    return [(x.shape, x.dtype.name, x.weak_type) for x in jax.tree.leaves(tree)]


def test_every_registered_environment_has_a_variant_here():
    assert {env.name for env, _ in VARIANTS.values()} | {"Mario"} == set(hrl.registered())  # Mario is not tabular


@pytest.mark.parametrize("name", ["Bus", "Gridworld", "Maze", "Taxi"])
def test_environments_are_made_by_name_and_refuse_what_they_do_not_know(name: str):
    env = hrl.make(name)
    assert env.name == name
    assert env == hrl.make(name)
    assert hash(env) == hash(hrl.make(name))
    with pytest.raises(TypeError, match="has no option 'nonsense'; its options are"):
        hrl.make(name, nonsense=1)


@each_variant
def test_numbers_and_states_are_one_to_one(variant: str):
    env, _ = made(variant)
    states = all_states(env)
    assert all(field.dtype == jnp.int32 for field in states)
    assert not np.any(np.asarray(states.time))
    np.testing.assert_array_equal(jax.vmap(env.encode)(states), np.arange(env.num_states))
    late = states._replace(time=states.time + 7)
    np.testing.assert_array_equal(jax.vmap(env.encode)(late), np.arange(env.num_states))


@each_variant
def test_a_model_is_a_distribution_over_states(variant: str):
    env, params = made(variant)
    model = model_of(variant)
    assert model.next_state.shape[:2] == (env.num_states, env.num_actions)
    assert model.next_state.min() >= 0
    assert model.next_state.max() < env.num_states
    assert model.probability.min() >= 0
    np.testing.assert_allclose(model.probability.sum(-1), 1, atol=1e-12)
    np.testing.assert_allclose(env.initial_distribution(params).sum(), 1, atol=1e-12)


class Certain(Maze):
    """A maze without chance: it uses no words at all."""

    num_words = num_initial_words = 0

    def initial(self, words: tuple[jax.Array, ...], params: Any) -> Any:
        assert words == ()
        return super().initial((jnp.uint32(0),), params)

    def transition(self, state: Any, action: jax.Array, words: tuple[jax.Array, ...], params: Any) -> Any:
        assert words == ()
        return super().transition(state, action, (jnp.uint32(WORD_RANGE - 1),), params)

    def initial_word_cuts(self, params: Any) -> tuple[()]:
        return ()

    word_cuts = initial_word_cuts


def test_an_environment_may_use_no_words():
    for ours, mazes in zip(Certain().model(), hrl.make("Maze").model(), strict=True):
        np.testing.assert_array_equal(ours, mazes)
    assert np.flatnonzero(Certain().initial_distribution()).tolist() == [0]
    assert Certain().initial_distribution().sum() == 1
    options = {"seeds": 2, "num_episodes": 3, "progress": False}
    returns = [hrl.sweep(Certain(), hrl.SARSA(), mapping=m, **options)["return"].values for m in ("native", "vmap")]
    np.testing.assert_array_equal(*returns)


@each_variant
def test_some_policy_ends_the_episode_from_every_state(variant: str):
    """So that the optimum with discount 1 is finite everywhere, in states that never occur too."""
    env, _ = made(variant)
    model = model_of(variant)
    successors = model.successors()
    happens = model.probability > 0
    ends, before = np.zeros(env.num_states, np.bool_), None
    while before is None or (ends != before).any():
        before = ends
        ends = ends | (happens & (model.terminated | ends[np.maximum(successors, 0)] & (successors >= 0))).any((1, 2))
    assert ends.all()


@each_variant
def test_dtypes_are_those_of_reset_in_every_step(variant: str):
    env, params = made(variant)
    integer, real, boolean = (((), name, False) for name in ("int32", "float32", "bool"))
    obs, state = jax.jit(env.reset)(jax.random.key(0), params)
    assert described((obs, state)) == [integer] * (1 + len(state))
    after = jax.jit(env.step)(jax.random.key(1), state, jnp.int32(0), params)
    assert described(after[:2]) == described((obs, state))
    assert described(after[2:]) == [real, boolean, boolean, *[boolean] * len(env.metrics)]
    assert set(after[-1]) == set(env.metrics)
    assert env.observation_space.contains(np.asarray(obs)[()])
    assert obs == env.encode(state)
    fixed = jax.jit(partial(env.step, params=params))(jax.random.key(1), state, jnp.int32(0))
    jax.tree.map(np.testing.assert_array_equal, fixed, after)


@each_variant
def test_an_episode_is_truncated_at_the_limit_unless_it_ends(variant: str):
    env, params = made(variant)
    limited = params._replace(max_steps=5)
    step = jax.jit(jax.vmap(env.step, (None, 0, None, None)), static_argnums=3)
    states = all_states(env)
    for time, at_limit in ((3, False), (4, True)):
        late = states._replace(time=states.time + time)
        *_, terminated, truncated, _ = step(jax.random.key(3), late, jnp.int32(0), limited)
        np.testing.assert_array_equal(truncated, ~np.asarray(terminated) & at_limit)


@each_variant
def test_resets_happen_as_often_as_the_initial_distribution_says(variant: str):
    env, params = made(variant)
    keys = jax.random.split(jax.random.key(1), 40_000)
    starts, _ = jax.jit(jax.vmap(env.reset, (0, None)))(keys, params)
    assert_as_likely(np.bincount(starts, minlength=env.num_states), env.initial_distribution(params))


@each_variant
def test_steps_happen_as_often_as_the_model_says(variant: str):
    env, params = made(variant)
    model = model_of(variant)
    kinds = (model.probability > 0).sum(-1) * occurring(env, params, model)[:, None]
    rows = np.argsort(-kinds.ravel(), kind="stable")
    step = jax.jit(jax.vmap(env.step, (0, None, None, None)))
    keys = jax.random.split(jax.random.key(3), 20_000)
    for row in rows[np.linspace(0, np.count_nonzero(kinds) - 1, 5).astype(int)].tolist():
        number, action = divmod(row, env.num_actions)
        state = env.decode(jnp.int32(number))
        observed, _, reward, terminated, _, _ = step(keys, state, jnp.int32(action), params)
        seen = np.stack([np.asarray(x, np.float64) for x in (observed, reward, terminated)])
        outcomes = np.stack([x[number, action] for x in (model.next_state, model.reward, model.terminated)])
        likely = model.probability[number, action] > 0
        matches = np.all(outcomes[:, likely, None] == seen[:, None], 0)
        assert np.all(matches.sum(0) == 1)
        assert_as_likely(matches.sum(1), model.probability[number, action, likely])


def assert_as_likely(counts: np.ndarray, probability: np.ndarray):
    """A chi-squared test that lets chance deviate by four standard deviations."""
    expected = probability * counts.sum()
    assert not counts[probability == 0].any()
    counts, expected = counts[probability > 0], expected[probability > 0]
    freedom = len(counts) - 1
    assert np.sum((counts - expected) ** 2 / expected) <= freedom + 4 * np.sqrt(2 * freedom)


@partial(jax.jit, static_argnums=(0, 1))
def all_outcomes(env: Any, params: Any, words: tuple[jax.Array, ...]):
    over_actions = jax.vmap(env.transition, (None, 0, None, None))
    actions = jnp.arange(env.num_actions, dtype=jnp.int32)
    return jax.vmap(over_actions, (0, None, None, None))(all_states(env), actions, words, params)


@partial(jax.jit, static_argnums=(0, 1))
def first_state(env: Any, params: Any, words: tuple[jax.Array, ...]):
    return env.initial(words, params)


@given(variant=st.sampled_from(sorted(VARIANTS)), data=st.data())
@settings(deadline=None, max_examples=80, derandomize=True)
def test_words_on_the_same_side_of_all_cuts_have_one_outcome(variant: str, data: st.DataObject):
    env, params = made(variant)
    for outcome, cuts in ((all_outcomes, env.word_cuts(params)), (first_state, env.initial_word_cuts(params))):
        these, those = [], []
        for number, of_word in enumerate(cuts):
            edges = [0, *(int(random.threshold(cut)) for cut in of_word)]
            near = st.sampled_from(edges).flatmap(lambda e: st.integers(max(e - 1, 0), min(e + 1, WORD_RANGE - 1)))
            word = data.draw(st.integers(0, WORD_RANGE - 1) | near, label=f"word {number}")
            these.append(jnp.uint32(word))
            those.append(jnp.uint32(max(edge for edge in edges if edge <= word)))
        results = (outcome(env, params, tuple(words)) for words in (these, those))
        jax.tree.map(np.testing.assert_array_equal, *results)


@each_variant
def test_subtasks_can_go_on_wherever_an_episode_does(variant: str):
    """Every active subtask has a child to invoke, and an active root wherever an episode can go on."""
    env, params = made(variant)
    graph = env.hierarchy()
    assert graph.actions == env.action_names
    states = all_states(env)
    active = {task.name: ~np.asarray(jax.vmap(task.termination)(states)) for task in graph.subtasks}
    active |= {name: np.ones(env.num_states, np.bool_) for name in env.action_names}
    for task in graph.subtasks:
        assert active[task.name].dtype == np.bool_
        assert active[task.name].any()
        assert np.any([active[child] for child in task.children], axis=0)[active[task.name]].all(), task.name
        if task.goal is not None:
            goal = np.asarray(jax.vmap(task.goal)(states))
            assert not (goal & active[task.name]).any(), task.name
    assert active[graph.root.name][occurring(env, params, model_of(variant))].all()
