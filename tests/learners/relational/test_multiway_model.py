"""The model with multiway trees: what it keeps and gives back, ends that it foresees, the screen's edges."""

import dataclasses
from functools import cache
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.engine import compiler
from hrljax.envs.mario.competition import unbegun
from hrljax.learners.base import Transition
from hrljax.learners.relational.multiway_model import MultiwayModel
from hrljax.learners.relational.screen_model import Foreseen, ScreenModel, body_of
from tests.learners.relational.walks import ENV, Walk

F = np.float32
MODEL = MultiwayModel(rows=64, pessimism=5.0)


@pytest.fixture
def walk(walk: Walk) -> list[Transition]:
    """The steps alone."""
    return walk.steps


@cache
def observing(model: MultiwayModel, learns: bool = True) -> Any:
    return jax.jit(lambda tables, step: model.observe(ENV, tables, step, jnp.bool_(learns)))


@cache
def refitting(model: MultiwayModel) -> Any:
    return jax.jit(lambda tables: model.refit(ENV, tables))


def observed(model: MultiwayModel, walks: list[list[Transition]]) -> Any:
    tables = model.init(ENV)
    for step in (step for walk in walks for step in walk):
        tables = observing(model)(tables, step)
    return tables


def looking(model: MultiwayModel, tables: Any) -> Any:
    """A step ahead of a moment of an episode."""

    def look(state: Any, action: jax.Array) -> tuple[Any, ...]:
        ahead, start = model.planned(ENV, tables, state)
        return ahead(start, action)

    return jax.jit(look)


@pytest.mark.slow
def test_equal_transitions_are_one_row_with_a_weight(walk: list[Transition]):
    tables = observed(MODEL, [walk, walk[:5], walk])
    kept = tables.replay
    different = {
        np.concatenate([MODEL.inputs(ENV.course, s.state.world), [s.action, s.reward, s.terminated]]).tobytes()
        for s in walk
    }
    count = int(kept.filled)
    assert count == len(different)
    assert float(jnp.sum(kept.weights[:count])) == 2 * len(walk) + 5
    once = observed(MODEL, [walk]).replay
    np.testing.assert_array_equal(kept.values[: -MODEL._width], once.values[: -MODEL._width])


@pytest.mark.slow
def test_a_transition_that_does_not_count_changes_nothing_that_is_read(walk: list[Transition]):
    before, after = observed(MODEL, [walk[:3]]), observed(MODEL, [walk[:3]])
    for step in walk:
        after = observing(MODEL, learns=False)(after, step)
    np.testing.assert_array_equal(before.replay.values[: -MODEL._width], after.replay.values[: -MODEL._width])
    np.testing.assert_array_equal(before.replay.weights[:-1], after.replay.weights[:-1])
    chex.assert_trees_all_equal(before.replay.places, after.replay.places)
    assert int(before.replay.filled) == int(after.replay.filled)


def test_what_comes_when_all_rows_are_taken_is_forgotten(walk: list[Transition]):
    full = observed(dataclasses.replace(MODEL, rows=8), [walk, walk[:2]]).replay
    assert int(full.filled) == 8
    assert float(full.weights[0]) >= 2
    whole = observed(MODEL, [walk]).replay
    width = MODEL._width
    np.testing.assert_array_equal(full.values[: 8 * width], whole.values[: 8 * width])


@pytest.mark.slow
@pytest.mark.parametrize("loops", ["jit", "native"])
def test_what_was_met_comes_back_exactly_and_the_last_step_is_an_end(walk: list[Transition], loops: str):
    tables = observed(MODEL, [walk])
    options = compiler.nested_options() if loops == "native" else None
    tables = jax.jit(lambda tables: MODEL.refit(ENV, tables), compiler_options=options)(tables)
    ahead = looking(MODEL, tables)
    never = jnp.int32(1)  # the walk never takes it
    for step in walk:
        after, reward, ended = ahead(step.state, step.action)
        assert bool(ended) == bool(step.terminated)
        np.testing.assert_allclose(reward, step.reward, rtol=1e-6)
        assert float(ahead(step.state, never)[1]) <= max(float(s.reward) for s in walk) - 5 + 1e-5
        if not step.terminated:
            truth = body_of(step.next_state)
            np.testing.assert_allclose(after, truth, rtol=1e-5, atol=1e-4)


@pytest.fixture(scope="module")
def confused() -> tuple[list[Transition], Any]:
    """Steps from one moment that only the action before tells apart, and a model that has met them."""
    model = dataclasses.replace(MODEL, memory=True, weighted=False)
    state = unbegun(ENV.course, 0)
    right, jump = (ENV.keys(jnp.int32(action)) for action in (5, 4))
    steps = []
    for keys, distance, reward in ((right, 16.0, 1.0), (jump, 32.0, 2.0), (right, 8.0, 3.0)):
        player = state.world.player
        after = state._replace(world=state.world._replace(player=player._replace(x=player.x + F(distance))))
        before = state._replace(keys=keys)
        steps.append(Transition(before, jnp.int32(5), jnp.float32(reward), after, jnp.bool_(False)))
    tables = observed(model, [steps])
    return steps, refitting(model)(tables)


@pytest.mark.slow
def test_a_memory_tells_what_the_last_of_equal_steps_brought(confused: tuple[list[Transition], Any]):
    """27 inputs are the same; trees give the mean, the memory what came last after the same action."""
    steps, tables = confused
    model = dataclasses.replace(MODEL, memory=True, weighted=False)
    assert int(tables.replay.filled) == 3
    ahead = looking(model, tables)
    for step, distance, reward in ((steps[0], 8.0, 3.0), (steps[1], 32.0, 2.0)):
        after, predicted, ended = ahead(step.state, step.action)
        assert (float(predicted), bool(ended)) == (reward, False)
        assert float(after.x) == float(step.state.world.player.x) + distance
        assert int(after.keys) == int(ENV.keys(step.action))
    never = steps[0].state._replace(keys=ENV.keys(jnp.int32(0)))
    np.testing.assert_allclose(ahead(never, jnp.int32(5))[1], 2.0 - 5.0, rtol=1e-6)


@pytest.mark.slow
def test_trees_without_weights_are_left_alone_until_something_new_was_met(confused: tuple[list[Transition], Any]):
    steps, tables = confused
    model = dataclasses.replace(MODEL, memory=True, weighted=False)
    observe, refit = observing(model), refitting(model)
    marked = tables._replace(learned=jax.tree.map(jnp.zeros_like, tables.learned))
    again = refit(observe(marked, steps[0]))
    chex.assert_trees_all_equal(again.learned, marked.learned)
    other = refit(observe(marked, steps[0]._replace(reward=jnp.float32(9))))
    assert int(other.replay.filled) == 4
    assert np.asarray(other.learned.outcome.means).any()
    assert not other.replay.has_news


@pytest.mark.slow
def test_a_plan_that_is_cut_off_above_a_pit_knows_what_came_after(walk: list[Transition]):
    """The steps before the walk's end carry it, less and less; those long before do not."""
    model = dataclasses.replace(MODEL, memory=True, weighted=False, death_decay=0.5)
    tables = refitting(model)(observed(model, [walk]))
    ahead = looking(model, tables)
    assert float(walk[-1].reward) < -20
    for back in (1, 2, 3, 20):
        step = walk[-1 - back]
        *_, beyond = ahead(step.state, step.action)
        expected = 0.5**back * float(walk[-1].reward) if back < 16 else 0.0
        assert float(beyond) == pytest.approx(expected)


def test_pessimism_may_be_swept(walk: list[Transition]):
    """A number that is known late gives what a constant does."""
    tables = observed(MODEL, [walk])

    def reward(model: MultiwayModel) -> Any:
        ahead, start = model.planned(ENV, tables, walk[3].state)
        return jnp.stack([ahead(start, jnp.int32(action))[1] for action in range(3)])

    late = jax.jit(lambda pessimism: reward(dataclasses.replace(MODEL, pessimism=pessimism)))
    for pessimism in (0.5, 5.0):
        expected = jax.jit(lambda p=pessimism: reward(dataclasses.replace(MODEL, pessimism=p)))()
        np.testing.assert_array_equal(late(F(pessimism)), expected)
    learner = hrl.RelationalHORDQ(hrl.SearchRoot(model=MODEL))
    assert learner.sweepable()["root.model.pessimism"] == 5.0
    assert learner.replaced({"root.model.pessimism": 2.0}).root.model == dataclasses.replace(MODEL, pessimism=2.0)


@pytest.mark.parametrize("x", [3.0, 17.0, 40.0])
def test_a_look_ahead_reads_what_is_learned_from_at_the_left_end_too(walk: list[Transition], x: float):
    """The level goes on beyond its end, in both."""

    class Reader(MultiwayModel):
        def foreseen(self, tables: Any, inputs: jax.Array, last_keys: jax.Array, action: jax.Array) -> Foreseen:
            return Foreseen([jnp.float32(0)] * 4, inputs[action], False)

    episode = walk[0].state
    world = episode.world
    moved = world._replace(player=world.player._replace(x=jnp.float32(x), x_old=jnp.float32(x), y=jnp.float32(200)))
    model: ScreenModel = Reader()
    ahead, start = model.planned(ENV, model.init(ENV), episode._replace(world=moved))
    read = jax.jit(jax.vmap(lambda i: ahead(start, i)[1]))(jnp.arange(27))
    np.testing.assert_array_equal(read, model.inputs(ENV.course, moved))
    assert np.any(np.asarray(read[:25]) != 0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"reading": "E"}, "MultiwayModel: reading must be one of 'A', 'B', 'C', 'D', got 'E'"),
        ({"memory": "yes"}, "MultiwayModel: memory must be"),
        ({"death_decay": 1.0}, "MultiwayModel: death_decay must be"),
        ({"rows": 0}, "MultiwayModel: rows must be an integer from 1 to 1048576, got 0"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, Any], message: str):
    with pytest.raises((TypeError, ValueError), match=message):
        MultiwayModel(**settings)
