"""Flat learners side by side with plain-Python programs, on a small Bus domain; and under every mapping."""

from collections.abc import Callable
from functools import cache
from typing import Any, Protocol

import chex
import jax
import jax.numpy as jnp
import numpy as np

import hrljax
from hrljax.envs.bus.env import BusParams
from hrljax.learners.base import Context, Transition
from tests.maps import SMALL
from tests.words import KEY, drawn

F = np.float32
EPISODES = 40
PARAMS = BusParams(max_steps=60)
PAIRS = SMALL.num_states * 4


class Program(Protocol):
    """A learner in plain Python; pairs are ``state * 4 + action``."""

    q: np.ndarray  # [PAIRS] float32

    def begin(self, state: int, words: list[int]) -> int: ...

    def learn(self, state: int, action: int, reward: F, after: int, terminated: bool, words: list[int]) -> int: ...


def choose(q: np.ndarray, state: int, word: int, epsilon: float) -> int:
    """Epsilon-greedily; `epsilon` is a multiple of 1/8."""
    return word % 4 if word < epsilon * 2**24 else int(np.argmax(q[state * 4 : state * 4 + 4]))


def settled(learner: Any, q: np.ndarray, sweep: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, bool]:
    """Values after sweeps until one changes none by more than the learner's tolerance; whether one did not."""
    for _ in range(learner.planning_sweeps):
        before, q = q, sweep(q)
        if np.abs(q - before).max() <= F(learner.planning_tolerance):
            return q, True
    return q, False


@jax.jit
def env_step(state: jax.Array, action: jax.Array, words: jax.Array) -> tuple[jax.Array, ...]:
    after, reward, terminated, _ = SMALL.transition(SMALL.decode(state), action, tuple(words), PARAMS)
    return SMALL.encode(after), reward, terminated


env_initial = jax.jit(lambda word: SMALL.encode(SMALL.initial((word,), PARAMS)))


@cache
def trained(
    learner: Any, params: BusParams = PARAMS, episodes: int = EPISODES, evaluate_every: int | None = None
) -> hrljax.Run:
    """A run alone, one episode a bin."""
    options = {"params": params, "bin_size": 1, "evaluate_every": evaluate_every}
    return jax.jit(lambda key: hrljax.train(SMALL, learner, key, episodes, **options))(KEY)


def assert_runs_as(program: Program, learner: Any) -> None:
    """Every return and every action value has the bits of the program's."""
    step_words = drawn(EPISODES * PARAMS.max_steps, 3 + learner.num_words, 0)
    begin_words = drawn(EPISODES, 1 + learner.num_begin_words, 2)
    returns, lengths, steps = [], [], 0
    for words in begin_words:
        state, time, total, terminated = int(env_initial(np.uint32(words[0]))), 0, 0.0, False
        action = program.begin(state, words[1:])
        while not terminated and time < PARAMS.max_steps:
            words = step_words[steps]
            after, reward, terminated = env_step(np.int32(state), np.int32(action), np.array(words[:3], np.uint32))
            after, reward, terminated = int(after), F(reward), bool(terminated)
            action = program.learn(state, action, reward, after, terminated, words[3:])
            state, time, steps, total = after, time + 1, steps + 1, total + float(reward)
        returns.append(total)
        lengths.append(time)
    run = trained(learner)
    np.testing.assert_array_equal(run.metrics["return"], np.array(returns, F))
    np.testing.assert_array_equal(run.metrics["length"], np.array(lengths, F))
    np.testing.assert_array_equal(learner.action_values(run.learned), program.q)
    assert 0 < np.asarray(run.metrics["truncated"]).sum() < EPISODES


def assert_same_run(one: Any, other: Any, params: BusParams = PARAMS) -> None:
    """Two learners give the same curves and the same action values, bit for bit."""
    a, b = trained(one, params), trained(other, params)
    for name, values in a.metrics.items():
        np.testing.assert_array_equal(values, b.metrics[name], err_msg=name)
    values = one.action_values(a.learned)
    np.testing.assert_array_equal(values, other.action_values(b.learned))
    assert len(np.unique(values)) > 50


def assert_same_under_every_mapping(learner: Any, axes: dict[str, list[float]], episodes: int = 12) -> None:
    """Native loops and `vmap` give the same curves."""
    options = {"seeds": 3, "num_episodes": episodes, "bin_size": 1, "params": PARAMS, "axes": axes, "progress": False}
    native, vmap = (
        hrljax.sweep(SMALL, learner, **options, mapping=mapping, chunk_size=size)
        for mapping, size in (("native", 2), ("vmap", 6))
    )
    assert native.attrs["mapping"] == "native"
    assert len(np.unique(native["steps"])) > 3
    for variable in native:
        np.testing.assert_array_equal(native[variable].values, vmap[variable].values, err_msg=str(variable))


def assert_learns_only_when_live(learner: Any) -> None:
    """Under vmap, a step that does not count changes no table, whatever was learned from the same step before."""

    @jax.jit
    def run(live_steps: jax.Array, live: jax.Array) -> tuple[Any, Any]:
        prepared = learner.prepare(SMALL)
        words = tuple(jnp.uint32(9 * i) for i in range(learner.num_words))

        def step(state: Any, live: jax.Array) -> Any:
            here = Transition(jnp.int32(5), jnp.int32(2), jnp.float32(-3), jnp.int32(9), jnp.bool_(False))
            context = Context(jnp.int32(0), live, jnp.uint32(0), vmapped=True)
            return learner.learn(prepared, state, here, words, context)

        start = learner.init(SMALL, prepared)
        before = jax.lax.fori_loop(0, live_steps, lambda _, state: step(state, jnp.bool_(True)), start)
        return before.tables, step(before, live).tables

    assert not np.array_equal(*(learner.action_values(tables) for tables in run(jnp.int32(1), jnp.bool_(True))))
    for live_steps in range(1, 4):
        before, after = jax.tree.map(np.asarray, run(jnp.int32(live_steps), jnp.bool_(False)))
        chex.assert_trees_all_equal(before, after)
