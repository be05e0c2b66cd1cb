"""What holds for every registered tabular environment: the contract, and simulator against model."""

from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.grid.maze import Maze
from hrljax.solvers import Model
from tests.maps import SMALL, occurring
from tests.words import CALM

VARIANTS = {
    "BoyanChain": (hrl.make("BoyanChain", length=12), {}),
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


@pytest.mark.slow
@each_variant
def test_the_environment_is_what_the_library_takes_it_for(variant: str):
    env, params = made(variant)
    assert {field.dtype.name for field in all_states(env)} == {"int32"}
    hrl.check(env, params)


@each_variant
def test_every_number_is_that_of_a_state(variant: str):
    """Those that do not occur, too."""
    env, _ = made(variant)
    np.testing.assert_array_equal(jax.vmap(env.encode)(all_states(env)), np.arange(env.num_states))


class Certain(Maze):
    """A maze without chance: it uses no words at all."""

    num_words = num_initial_words = 0

    def initial(self, words: tuple[jax.Array, ...], params: Any) -> Any:
        assert words == ()
        return super().initial((jnp.uint32(0),), params)

    def transition(self, state: Any, action: jax.Array, words: tuple[jax.Array, ...], params: Any) -> Any:
        assert words == ()
        return super().transition(state, action, (jnp.uint32(CALM),), params)

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
def test_numbers_that_are_traced_give_the_same_step(variant: str):
    env, params = made(variant)
    _, state = jax.jit(env.reset)(jax.random.key(0), params)
    traced = jax.jit(env.step)(jax.random.key(1), state, jnp.int32(0), params)
    fixed = jax.jit(partial(env.step, params=params))(jax.random.key(1), state, jnp.int32(0))
    jax.tree.map(np.testing.assert_array_equal, fixed, traced)
    assert [leaf.dtype for leaf in jax.tree.leaves(fixed)] == [leaf.dtype for leaf in jax.tree.leaves(traced)]
    assert set(fixed[-1]) == set(env.metrics)


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


@pytest.mark.parametrize("variant", [name for name in VARIANTS if name != "BoyanChain"])  # which has no subtasks
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
    assert active[graph.root.name][occurring(model_of(variant), env.initial_distribution(params))].all()
