"""What the model-based root is made of, against plain Python: the model, a sweep, the decision points."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.envs.bus.env import Bus
from hrljax.hierarchy.definition import Abstraction, Hierarchy
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.roots.backups import sweep
from hrljax.learners.roots.decision_points import DecisionPoints, planning_points
from hrljax.learners.roots.multi_time_model import updated
from hrljax.solvers.model import Model

F = np.float32


def test_the_model_moves_every_outcome_by_the_step_size_or_one_nth():
    generator, trials, width = np.random.default_rng(0), 300, 5
    entries = generator.random((trials, width + 1)).astype(F)
    entries[:, -1] = generator.integers(0, 30, trials)
    outcomes = np.stack([generator.permutation(width + 3)[:width] for _ in range(trials)]).astype(np.int32)
    outcomes[:, -1] = -1
    outcome = outcomes[np.arange(trials), generator.integers(0, width - 1, trials)]
    weight = np.where(generator.random(trials) < 0.2, 0, generator.random(trials)).astype(F)
    step_size, live = generator.uniform(0.05, 0.5, trials).astype(F), generator.random(trials) < 0.8

    def one(row, those, *rest):
        return jnp.stack(updated(list(row), list(those), *rest, jnp.uint32(0)))

    actual = jax.jit(jax.vmap(one))(*map(jnp.asarray, (entries, outcomes, outcome, weight, step_size, live)))
    for i in range(trials):
        size = max(step_size[i], F(1) / (entries[i, -1] + F(1)))
        expected = entries[i].copy()
        for m in range(width):
            expected[m] += size * ((weight[i] if outcomes[i, m] == outcome[i] else F(0)) - expected[m])
        expected[-1] += 1
        np.testing.assert_array_equal(actual[i], expected if live[i] else entries[i])


def test_trials_with_one_nth_step_sizes_give_the_average_outcome():
    """Counted from empty entries: probabilities are those of the sample, and never sum to less."""
    reached = np.random.default_rng(1).integers(0, 3, 9)
    entries = [jnp.float32(0)] * 4
    fixed = {"outcomes": [jnp.int32(x) for x in range(3)], "weight": jnp.float32(1), "learns": jnp.bool_(True)}
    step = jax.jit(partial(updated, **fixed))
    for outcome in reached:
        entries = step(entries, outcome=jnp.int32(outcome), step_size=jnp.float32(0.1), zero=jnp.uint32(0))
    np.testing.assert_allclose(entries, [*np.bincount(reached, minlength=3) / 9, 9], rtol=1e-6)


def test_a_sweep_backs_up_every_point_from_the_old_values():
    generator = np.random.default_rng(2)
    num_x, num_y, slots, width = 5, 8, 3, 4
    can_invoke = generator.random((num_x, slots, num_y)) < 0.5
    outcomes = np.stack([generator.permutation(num_x)[:width] for _ in range(num_x * slots)])
    outcomes[generator.random(outcomes.shape) < 0.3] = -1
    nowhere = np.zeros(1, np.int32)
    points = DecisionPoints(
        num_x, num_y, 4, nowhere, nowhere, nowhere, np.zeros(num_x * slots, np.int32), can_invoke, outcomes.ravel()
    )
    model = generator.random((num_x * slots, width + 1, num_y)).astype(F)
    model[:, :-1][np.broadcast_to(outcomes[..., None] < 0, (num_x * slots, width, num_y))] = 0
    model[:, -1] = generator.integers(0, 3, (num_x * slots, num_y))
    until_end, values = (generator.normal(size=shape).astype(F) for shape in ((num_x * slots, num_y), (num_x, num_y)))
    unknown = F(0.25)

    expected = np.full((num_x, num_y), unknown)
    for x in range(num_x):
        for y in range(num_y):
            worth = []
            for pair in x * slots + np.flatnonzero(can_invoke[x, :, y]):
                after = F(0)
                for m in range(width):
                    after += model[pair, m, y] * values[outcomes[pair, m], y]
                worth.append(until_end[pair, y] + after if model[pair, -1, y] else unknown)
            expected[x, y] = max(worth, default=unknown)
    actual = jax.jit(partial(sweep, points))(model, until_end, values, unknown, jnp.uint32(0))
    np.testing.assert_array_equal(actual, expected)
    assert (expected == unknown).any()
    assert (expected != unknown).any()


SMALL = """\
+---+---+---+---+
| 1   1P| 2   2 |
+   +   +   +   +
| 1S  1 A 2   2P|
+---+   +---+   +
| 3   3   4   4 |
+---+---+---+---+
"""


@pytest.fixture(scope="module", params=["default", "small"])
def world(request: pytest.FixtureRequest, bus: Bus, bus_model: Model) -> tuple[Bus, Model]:
    if request.param == "default":
        return bus, bus_model
    return Bus(SMALL), Bus(SMALL).model()


def test_decision_points_are_where_the_root_can_decide(world: tuple[Bus, Model]):
    """By a search over (subtask, state) pairs from the beginnings of episodes."""
    env, model = world
    points, active = planning_points(env.hierarchy(), env), tabulate(env.hierarchy(), env).active[1:]
    follows = [set(row[row >= 0].tolist()) for row in model.successors().reshape(env.num_states, -1)]
    decides = set(np.flatnonzero(env.initial_distribution()).tolist())
    seen, queue = set(), [(task, state) for state in decides for task in np.flatnonzero(active[:, state])]
    while queue:
        task, state = queue.pop()
        for after in follows[state]:
            decides |= set() if active[task, after] else {after}
            running = [task] if active[task, after] else np.flatnonzero(active[:, after]).tolist()
            new = {(t, after) for t in running} - seen
            seen |= new
            queue += new
    for state in decides:
        x, y = divmod(int(points.point[state]), points.num_y)
        assert (points.state[points.point[state]], points.planning[state]) == (state, x)
        invocable = points.tasks.reshape(points.num_x, -1)[x, points.can_invoke[x, :, y]]
        assert invocable.tolist() == np.flatnonzero(active[:, state]).tolist()
    numbers = points.point[sorted(decides)]
    assert len(set(numbers.tolist())) == len(decides)
    assert points.num_y % 8 == 0


def test_outcomes_of_a_subtask_are_the_planning_parts_that_it_can_end_in(world: tuple[Bus, Model]):
    """By a search over states from every state of a planning part, whatever its environment part."""
    env, model = world
    points, active = planning_points(env.hierarchy(), env), tabulate(env.hierarchy(), env).active[1:]
    follows = [set(row[row >= 0].tolist()) for row in model.successors().reshape(env.num_states, -1)]
    pairs = [(x, slot) for x, slot in np.argwhere(points.can_invoke.any(2))]
    outcomes, tasks = points.outcomes.reshape(len(points.tasks), -1), points.tasks
    for x, slot in pairs[:: max(1, len(pairs) // 40)]:
        pair = x * points.num_slots + slot
        seen = set(np.flatnonzero(points.planning == x).tolist())
        queue, ends = list(seen), set()
        while queue:
            for after in follows[queue.pop()] - seen:
                if active[tasks[pair], after]:
                    seen.add(after)
                    queue.append(after)
                else:
                    ends.add(int(points.planning[after]))
        known = outcomes[pair][outcomes[pair] >= 0].tolist()
        assert known == sorted(ends)
        assert set(outcomes[pair, len(known) :]) <= {-1}


def replanned(env: Bus, abstraction: Abstraction | None) -> Hierarchy:
    root, *others = env.hierarchy().subtasks
    return Hierarchy(env.action_names, [dataclasses.replace(root, abstraction=abstraction), *others])


def test_a_root_cannot_plan_without_telling_all_states_apart(bus: Bus):
    with pytest.raises(ValueError, match="needs an abstraction; subtask 'Root' has none"):
        planning_points(replanned(bus, None), bus)
    blind = bus.hierarchy().root.abstraction._replace(environment=lambda state: state.road)
    with pytest.raises(ValueError, match="abstraction of 'Root' gives two states the same two parts"):
        planning_points(replanned(bus, blind), bus)
