"""Relational learning in Mario: against plain Python, and the identities of the pseudo-reward."""

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.core.random import WORD_RANGE
from hrljax.envs.mario.features import NUM_OBJECT_CELLS, NUM_SYMBOLS, object_cells, objects
from hrljax.learners.base import Transition
from hrljax.learners.relational import search_root
from hrljax.learners.relational.learner import RelationalHORDQ
from hrljax.learners.relational.screen_model import ModelTables, body_of
from tests.contexts import learning
from tests.learners.relational.walks import ENV, Walk

ACTIONS = ENV.num_actions
MODEL = hrl.MarioModel(rows=64, max_depth=4, min_leaf=2, num_bins=8)
ROOT = hrl.SearchRoot(model=MODEL, depth=3, max_nodes=18)
F = np.float32


def replayed(learner: RelationalHORDQ, walk: Walk) -> tuple[Any, list[Any]]:
    """Tables after the walk, and the control after every step; `learn` looks at the steps' own actions."""
    prepared = learner.prepare(ENV)
    state = learner.init(ENV, prepared)
    begin = jax.jit(lambda tables, first, word: learner.begin(prepared, tables, first, (word,), learning()))
    learn = jax.jit(lambda state, step, word: learner.learn(prepared, state, step, (word,), learning()))
    state = state._replace(control=begin(state.tables, walk.first, walk.words[0]))
    controls = [state.control]
    for step, word in zip(walk.steps, walk.words[1:], strict=True):
        state = learn(state, step, word)
        controls.append(state.control)
    return state.tables, controls


class PythonSARSA:
    """Linear SARSA(lambda) over concepts with accumulating traces over the last L steps."""

    def __init__(self, learner: RelationalHORDQ):
        self.learner = learner
        self.weights = np.zeros((NUM_OBJECT_CELLS + 1, ACTIONS), F)
        self.weights[-1] = learner.initial_value
        self.is_shared = learner.bias == "shared"
        self.trail: list[tuple[list[int], int]] = []

    def concepts(self, episode: Any) -> list[int]:
        seen = objects(episode.world.player, episode.world.sprites, episode.world.num_sprites)
        return [int(c) for c, there in zip(object_cells(seen), seen.mask, strict=True) if there]

    def values(self, concepts: list[int]) -> np.ndarray:
        total = self.weights[-1].copy()
        if self.is_shared:
            total[:] = total[0]
        for concept in concepts:
            total += self.weights[concept]
        return total

    def choose(self, concepts: list[int], word: int) -> int:
        explores = word < np.ceil(float(F(self.learner.epsilon)) * WORD_RANGE)
        return int(word) % ACTIONS if explores else int(np.argmax(self.values(concepts)))

    def learn(self, step: Transition, word: int) -> int:
        before, after = self.concepts(step.state), self.concepts(step.next_state)
        action = self.choose(after, word)
        follows = F(0) if step.terminated else self.values(after)[action]
        target = F(step.reward) + F(self.learner.discount) * follows
        change = F(self.learner.step_size) * (target - self.values(before)[int(step.action)])
        self.trail = [*self.trail, (before, int(step.action))][-max(self.learner.trace_length, 1) :]
        for concepts, taken in reversed(self.trail):
            for concept in [-1, *concepts]:
                self.weights[concept, 0 if concept == -1 and self.is_shared else taken] += change
            change = F(F(self.learner.discount) * F(self.learner.trace_decay)) * change
        return action


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{}, {"trace_length": 5, "trace_decay": 0.8}, {"bias": "shared", "trace_length": 3, "trace_decay": 0.5}],
    ids=["one step", "accumulating traces", "shared bias"],
)
def test_weights_are_those_of_plain_python(walk: Walk, options: dict[str, Any]):
    learner = RelationalHORDQ(epsilon=0.3, initial_value=2.0, **options)
    tables, controls = replayed(learner, walk)
    python = PythonSARSA(learner)
    actions = [python.choose(python.concepts(walk.first), walk.words[0])]
    actions += [python.learn(step, word) for step, word in zip(walk.steps, walk.words[1:], strict=True)]
    assert [int(control.action) for control in controls] == actions
    np.testing.assert_array_equal(np.asarray(tables.weights).reshape(-1, ACTIONS), python.weights)
    assert any(python.concepts(step.state) for step in walk.steps)


@pytest.mark.slow
@pytest.mark.parametrize("bias", ["own", "shared"])
def test_where_no_concept_holds_only_biases_of_their_own_tell_actions_apart(walk: Walk, bias: Any):
    """Each of many deaths makes what was done look worse; without a concept that must not hide the root's advice."""
    learner = RelationalHORDQ(epsilon=0.0, bias=bias)
    prepared = learner.prepare(ENV)
    empty = walk.first._replace(world=walk.first.world._replace(num_sprites=jnp.int32(0)))
    state = learner.init(ENV, prepared)
    fatal = Transition(empty, jnp.int32(8), jnp.float32(-50), empty, jnp.bool_(True))
    state = jax.jit(lambda state: learner.learn(prepared, state, fatal, (jnp.uint32(0),), learning()))(state)
    nothing_holds = (jnp.zeros(1, jnp.int32), jnp.int32(0))
    values = np.asarray(learner._values(prepared, state.tables.weights, nothing_holds))
    expected = np.full(ACTIONS, -2.5, F) if bias == "shared" else np.where(np.arange(ACTIONS) == 8, F(-2.5), F(0))
    np.testing.assert_array_equal(values, expected)


@pytest.mark.slow
def test_a_step_that_does_not_count_changes_no_table(walk: Walk):
    """Runs in step under `vmap` take such steps; the trail has to stay as it is, at its end and where it wraps."""
    learner = RelationalHORDQ(epsilon=0.3, trace_length=5, trace_decay=0.8)
    prepared = learner.prepare(ENV)

    @jax.jit
    def learn(state: Any, step: Transition, live: Any) -> Any:
        now = learning()._replace(learns=live)
        return learner.learn(prepared, state, step, (jnp.uint32(3),), now)

    state = learner.init(ENV, prepared)
    for step in walk.steps[:7]:
        state = learn(state, step, jnp.bool_(True))
    assert int(state.tables.trail.length) == 7
    for step in (walk.steps[8], walk.steps[8]._replace(terminated=jnp.bool_(True))):
        chex.assert_trees_all_equal(learn(state, step, jnp.bool_(False)).tables, state.tables)


@pytest.mark.slow
def test_without_a_pseudo_reward_the_root_changes_nothing(walk: Walk):
    alone, without = replayed(RelationalHORDQ(epsilon=0.3), walk)
    under_root, controls = replayed(RelationalHORDQ(ROOT, epsilon=0.3, pseudo_reward=0.0), walk)
    np.testing.assert_array_equal(alone.weights, under_root.weights)
    assert [int(c.action) for c in without] == [int(c.action) for c in controls]


@pytest.mark.slow
def test_a_huge_pseudo_reward_follows_the_root(walk: Walk):
    _, controls = replayed(RelationalHORDQ(ROOT, epsilon=0.0, pseudo_reward=1e6), walk)
    assert all(int(control.action) == int(control.decision.task) for control in controls)


@pytest.mark.slow
def test_a_fading_pseudo_reward_goes_by_the_least_known_concept(walk: Walk):
    """Choices of a plain program that is told what the root suggests."""
    fading = hrl.Fading(worth=1.0, after=5.0)
    learner = RelationalHORDQ(ROOT, epsilon=0.0, pseudo_reward=fading, step_size=0.2, discount=0.9)
    tables, controls = replayed(learner, walk)
    python, visits, mean = PythonSARSA(learner), np.zeros(NUM_OBJECT_CELLS + 1, F), F(0)
    obeyed = []
    for number, control in enumerate(controls):
        concepts = python.concepts(walk.steps[number - 1].next_state if number else walk.first)
        values = python.values(concepts)
        kappa = F(1.0 * 5.0) * mean / (F(5) + min(visits[[*concepts, -1]]))
        biased = values + np.where(np.arange(ACTIONS) == int(control.decision.task), kappa, F(0))
        assert int(control.action) == int(biased.argmax())
        obeyed.append(int(control.action) == int(control.decision.task))
        if number:
            step = walk.steps[number - 1]
            before = python.concepts(step.state)
            np.add.at(visits, [*before, -1], F(1))
            mean = mean + (abs(F(step.reward)) - mean) / F(number)
            follows = F(0) if step.terminated else values[int(control.action)]
            change = F(0.2) * (F(step.reward) + F(0.9) * follows - python.values(before)[int(step.action)])
            for concept in [-1, *before]:
                python.weights[concept, int(step.action)] += change
    np.testing.assert_array_equal(np.asarray(tables.weights).reshape(-1, ACTIONS), python.weights)
    np.testing.assert_array_equal(tables.seen.visits, visits)
    assert 0 < sum(obeyed) < len(obeyed)


@pytest.mark.slow
def test_under_vmap_the_search_is_a_scan_and_finds_the_same(walk: Walk, monkeypatch: pytest.MonkeyPatch):
    loops, search = [], search_root.best_first_search

    def noted(*arguments: Any, loop: str, **options: Any) -> Any:
        loops.append(loop)
        return search(*arguments, loop=loop, **options)

    monkeypatch.setattr(search_root, "best_first_search", noted)
    root = hrl.SearchRoot(model=hrl.MarioDynamics(), depth=2, max_nodes=18)

    def decisions(vmapped: bool) -> list[Any]:
        context = learning()._replace(vmapped=vmapped)
        decide = jax.jit(lambda state: root.begin(ENV, root.init(ENV), state, context))
        return [decide(step.state) for step in walk.steps[:3]]

    chex.assert_trees_all_equal(decisions(False), decisions(True))
    assert loops == ["while", "scan"]


@pytest.mark.slow
@pytest.mark.parametrize("more", [{}, {"offsets": True, "below": True}], ids=["thesis", "offsets and below"])
def test_the_replay_keeps_the_last_transitions_and_the_model_predicts_them(walk: Walk, more: dict[str, Any]):
    """With a leaf for every transition the model gives back what it has seen."""
    model = hrl.MarioModel(rows=32, max_depth=20, min_leaf=1, num_bins=64, **more)
    learner = RelationalHORDQ(hrl.SearchRoot(model=model, depth=1, max_nodes=9))
    tables, _ = replayed(learner, walk)
    replay = tables.root.replay
    assert int(replay.added) == len(walk.steps)
    last = walk.steps[-1]
    place = (len(walk.steps) - 1) % 32
    assert float(replay.reward[place]) == float(last.reward)
    assert int(replay.group[place]) == (ACTIONS if last.terminated else int(last.action))
    learned = jax.jit(lambda replay: model.fit(replay, ACTIONS))(replay)

    @jax.jit
    def predicted(learned: Any, step: Transition) -> Any:
        ahead = model.look_ahead(ENV, ModelTables((), learned, ()), step.state)
        return ahead(body_of(step.state), step.action)

    errors = []
    for step in walk.steps[-20:-1]:
        after, reward = predicted(learned, step)
        errors.append((float(after.x - step.next_state.world.player.x), float(reward - step.reward)))
    assert np.median(np.abs(errors), axis=0).max() < 0.05


@pytest.mark.slow
def test_pessimism_takes_off_what_was_not_met(walk: Walk):
    model = hrl.MarioModel(rows=32, pessimism=2.0)
    plain = dataclasses.replace(model, pessimism=0.0)
    tables, _ = replayed(RelationalHORDQ(hrl.SearchRoot(model=model, depth=1, max_nodes=9)), walk)

    @partial(jax.jit, static_argnums=0)
    def rewards(of: hrl.MarioModel, episode: Any) -> jax.Array:
        ahead, start = of.planned(ENV, tables.root, episode)
        return jnp.stack([ahead(start, jnp.int32(action))[1] for action in range(ACTIONS)])

    def rounded(step: Transition) -> bytes:
        inputs = np.asarray(model.inputs(ENV.course, step.state.world))
        return np.append(inputs[:-2], np.round(inputs[-2:] * 32)).tobytes()

    met = {(rounded(step), int(step.action)) for step in walk.steps}
    # From three tiles on, all that the model reads is on the screen.
    for step in [step for step in walk.steps if float(step.state.world.player.x) > 48][:3]:
        expected = [0.0 if (rounded(step), action) in met else 2.0 for action in range(ACTIONS)]
        np.testing.assert_allclose(rewards(plain, step.state) - rewards(model, step.state), expected, atol=1e-5)
        assert 0.0 in expected
    assert plain.init(ENV).met == ()


@pytest.mark.slow
def test_inputs_tell_the_place_in_the_tile_and_what_lies_below_the_level(walk: Walk):
    model = hrl.MarioModel(offsets=True, below=True)
    world = walk.first.world
    world = world._replace(player=world.player._replace(x=jnp.float32(100.0), y=jnp.float32(212.0)))
    inputs = np.asarray(model.inputs(ENV.course, world))
    assert inputs.shape == (model.num_inputs,) == (29,)
    # Column 6 and row 13; rows 11 to 15 are seen, and the last one is below the 15 of the level.
    np.testing.assert_array_equal(inputs[-2:], [100 / 16 - 6, 212 / 16 - 13])
    np.testing.assert_array_equal(inputs[:25].reshape(5, 5) == NUM_SYMBOLS, np.arange(5)[:, None] == [4] * 5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"root": "search"}, "root must be None, a SearchRoot or an AStarRoot"),
        ({"bootstrap": "max"}, "bootstrap must be one of 'on_policy', 'greedy', got 'max'"),
        ({"trace_length": -1}, "trace_length must be an integer from 0 to 2147483647, got -1"),
        ({"step_size": 0.0}, "step_size must be a finite number in"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str):
    with pytest.raises((TypeError, ValueError), match=message):
        RelationalHORDQ(**options)


def test_only_mario_can_be_played():
    with pytest.raises(TypeError, match=r"env must be Mario, hrljax\.make\('Mario'\), for RelationalHORDQ"):
        hrl.train(hrl.make("Bus"), RelationalHORDQ(), jax.random.key(0), 1)


@pytest.mark.slow
def test_the_number_of_nodes_can_be_swept(walk: Walk):
    root = hrl.SearchRoot(model=hrl.MarioDynamics(), max_nodes=9, room=90, priority="last_reward")
    learner = RelationalHORDQ(root)
    assert learner.sweepable()["root.max_nodes"] == 9
    assert learner.replaced({"root.max_nodes": 27.0}).root == dataclasses.replace(root, max_nodes=27)

    def search(root: hrl.SearchRoot) -> Any:
        return root.search(ENV, (), walk.first)

    late = jax.jit(lambda nodes: search(dataclasses.replace(root, max_nodes=nodes)))
    for max_nodes in (9, 90):
        expected = jax.jit(lambda n=max_nodes: search(dataclasses.replace(root, max_nodes=n)))()
        actual = late(F(max_nodes))
        for field in ("actions", "value", "node"):
            np.testing.assert_array_equal(getattr(actual, field), getattr(expected, field))
        assert int(actual.tree.num_nodes) == int(expected.tree.num_nodes) == {9: 10, 90: 37}[max_nodes]
    with pytest.raises(TypeError, match="SearchRoot: room must say how many nodes"):
        jax.jit(lambda nodes: search(dataclasses.replace(root, max_nodes=nodes, room=None)))(F(9))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"depth": 0}, "depth must be an integer from 1 to 2147483647, got 0"),
        ({"max_nodes": 10.5}, "SearchRoot: max_nodes must be an integer from 1 to 2147483647, got 10.5"),
        ({"max_nodes": 600, "room": 300}, "SearchRoot: max_nodes must be an integer from 1 to 300, got 600"),
        ({"follow": "never"}, "follow must be one of 'every_step', 'sequence', got 'never'"),
        ({"model": None}, "model must be a MarioModel"),
    ],
)
def test_wrong_roots_are_refused(options: dict[str, Any], message: str):
    with pytest.raises((TypeError, ValueError), match=message):
        hrl.SearchRoot(**options)


def test_a_policy_over_states_takes_the_best_action(walk: Walk, tmp_path: Path):
    learner = RelationalHORDQ(epsilon=1.0, initial_value=-0.5)
    state = learner.init(ENV, learner.prepare(ENV))
    drawn = np.random.default_rng(5).normal(size=state.tables.weights.shape).astype(F)
    hrl.Learned(ENV, learner, state.tables._replace(weights=drawn)).save(tmp_path / "x.npz")
    actual = hrl.Learned.load(tmp_path / "x.npz")
    assert (actual.env, actual.learner) == (ENV, learner)
    policy, python = actual.policy(), PythonSARSA(learner)
    python.weights = drawn.reshape(-1, ACTIONS)
    states = [walk.first, *(step.next_state for step in walk.steps[::8])]
    chosen = [policy(state) for state in states]
    assert chosen == [int(python.values(python.concepts(state)).argmax()) for state in states]
    assert len(set(chosen)) > 2
    scheduled = RelationalHORDQ(pseudo_reward=lambda episode: 1.0 / (1 + episode))
    with pytest.raises(ValueError, match="needs a number for pseudo_reward, which is a schedule"):
        hrl.Learned(ENV, scheduled, state.tables).policy()


def test_a_learner_with_a_root_comes_back_from_disk(tmp_path: Path):
    learner = RelationalHORDQ(root=ROOT, pseudo_reward=3.0)
    shapes = jax.eval_shape(lambda: learner.init(ENV, learner.prepare(ENV)).tables)
    tables = jax.tree.map(lambda leaf: np.ones(leaf.shape, leaf.dtype), shapes)
    hrl.Learned(ENV, learner, tables).save(tmp_path / "x.npz")
    actual = hrl.Learned.load(tmp_path / "x.npz")
    assert (actual.env, actual.learner) == (ENV, learner)
    chex.assert_trees_all_equal(actual.tables, tables)


@pytest.mark.parametrize("pessimism", [-1.0, float("nan"), float("inf")])
def test_wrong_pessimism_is_refused(pessimism: float):
    with pytest.raises(ValueError, match=r"pessimism must be a finite number in \[0, 3\.4e\+38\]"):
        hrl.MarioModel(pessimism=pessimism)
