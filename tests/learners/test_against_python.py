"""Learners against the same algorithms in plain Python, scalar by scalar: equal numbers, not close ones."""

import math
from typing import Any

import jax
import numpy as np
import optax
import pytest

import hrljax
from hrljax.engine.run import bin_sizes, metric_names
from hrljax.envs.bus.env import Bus, BusParams
from hrljax.experiments.backup import PseudoRewardInBackup
from tests.learners.python_levels import Decomposed, Graph, train_in_python
from tests.learners.python_shared import Shared
from tests.words import KEY

F = np.float32
EPISODES, BIN_SIZE = 60, 7
PARAMS = BusParams(max_steps=150)
FLAGS = 6  # bits of a state number below the cell: damaged, three passengers, two sites


class PythonBus:
    """The Bus domain with the default options."""

    params = PARAMS

    def __init__(self, bus: Bus):
        self.env, layout = bus, bus.layout
        self.neighbour, self.site, self.area = layout.neighbour.tolist(), layout.site.tolist(), layout.area.tolist()
        self.passengers, self.start = layout.passengers, layout.start
        self.areas = range(len(layout.area_names))
        edges = {(self.area[c], self.area[n]) for c, row in enumerate(self.neighbour) for n in row}
        self.adjacent = {(a, b) for a, b in edges if a != b}

    def first_states(self, words: list[list[int]]) -> list[int]:
        return [self.start << FLAGS | word * 3 >> 24 for (word,) in words]

    def step(self, state: int, action: int, words: list[int]) -> tuple[int, F, bool, tuple[bool, bool]]:
        """Next state, reward, whether the episode terminated; whether the bus was damaged, whether it broke down."""
        cell, damaged, picked, road = state >> FLAGS, state >> 5 & 1, state >> 2 & 7, state & 3
        slip, mishap, change = (word / 2**24 for word in words)
        move = (action + sum(slip < 0.025 * i for i in (1, 2, 3))) % 4
        broke = bool(damaged) and mishap < 0.25
        hit = not damaged and road > 0 and self.site[cell][move] == road
        if not broke:
            cell = self.neighbour[cell][move]
            picked |= sum(1 << i for i, where in enumerate(self.passengers) if where == cell)
        road = (road + (change < 0.05) + (change < 0.025)) % 3
        after = cell << FLAGS | (damaged or hit) << 5 | picked << 2 | road
        return after, F(-51 if broke else -1), broke or (picked == 7 and cell == self.start), (hit, broke)

    def tasks(self) -> Graph:
        """The root over the areas, each of which is entered from a neighbouring one."""
        area = np.repeat(self.area, 1 << FLAGS)
        names = list(self.env.layout.area_names)
        active = {name: np.array([(a, task) in self.adjacent for a in area]) for task, name in enumerate(names)}
        goal = {name: area == task for task, name in enumerate(names)}
        everywhere = np.ones(len(area), np.bool_)
        children = {"Root": names, **{name: list(range(4)) for name in names}}
        return Graph(children, {"Root": everywhere, **active}, {"Root": ~everywhere, **goal})


def explores(word: int, epsilon: F) -> bool:
    return word < math.ceil(float(epsilon) * 2**24)


class Flat:
    """Q-learning and SARSA(0)."""

    def __init__(self, learner: Any):
        self.learner, self.on_policy = learner, isinstance(learner, hrljax.SARSA)
        self.q = np.full((2304, 4), learner.initial_value, F)
        self.epsilon, self.step_size = F(learner.epsilon), F(learner.step_size)

    def choose(self, state: int, word: int) -> int:
        if explores(word, self.epsilon):
            return word % 4
        tied = np.flatnonzero(self.q[state] == self.q[state].max())
        return int(tied[word % len(tied) if self.learner.ties == "random" else 0])

    def begin(self, episode: int, state: int, words: list[int]) -> None:
        self.action = self.choose(state, words[0])

    def learn(self, state: int, reward: float, after: int, terminated: bool, words: list[int]) -> None:
        action = self.action
        follows = self.choose(after, words[0]) if self.on_policy else int(np.argmax(self.q[after]))
        value = F(0) if terminated else self.q[after, follows]
        target = F(reward) + F(self.learner.discount) * value
        self.q[state, action] += self.step_size * (target - self.q[state, action])
        self.action = follows if self.on_policy else self.choose(after, words[0])

    def compare(self, learned: Any) -> None:
        np.testing.assert_array_equal(np.asarray(learned).reshape(2304, 4), self.q)


class PlannedRoot:
    """The model-based root, in dictionaries over (planning part, environment part)."""

    def __init__(self, learner: Any, bus: PythonBus):
        self.bus, self.settings, self.epsilon = bus, learner.root, F(learner.epsilon)
        self.program: Any = None  # whose subtasks it plans
        self.unknown = F(self.settings.unknown_value)
        self.probability: dict[tuple, dict[int, F]] = {}  # outcomes by (x, y, task)
        self.count: dict[tuple, int] = {}
        self.value: dict[tuple, F] = {}
        self.until_end: dict[tuple, F] = {}
        self.tasks: dict[tuple, list[str]] = {}
        self.recorded: set[tuple] = set()  # points decided at within an episode; values of others feed nothing

    @staticmethod
    def split(state: int) -> tuple[int, int]:
        return state >> FLAGS << 3 | state >> 2 & 7, state >> 3 & 4 | state & 3

    @staticmethod
    def joined(x: int, y: int) -> int:
        return x >> 3 << FLAGS | (y & 4) << 3 | (x & 7) << 2 | y & 3

    def backup(self, point: tuple[int, int], task: str, until_end: F) -> F:
        if not self.count.get((*point, task)):
            return self.unknown
        after = F(0)
        for x, probability in sorted(self.probability[*point, task].items()):
            after = after + probability * self.value.get((x, point[1]), self.unknown)
        return until_end + after

    def choose(self, state: int, invocable: list[str], word: int, is_first: bool) -> str:
        point = self.split(state)
        until_end = {task: self.program.until_end(task, state) for task in invocable}
        worth = [self.backup(point, task, until_end[task]) for task in invocable]
        self.tasks[point] = invocable
        if not is_first:
            self.recorded.add(point)
            self.value[point] = max(worth)
            self.until_end |= {(*point, task): value for task, value in until_end.items()}
        return invocable[word % len(invocable) if explores(word, self.epsilon) else int(np.argmax(worth))]

    def observe(self, state: int, task: str, after: int, weight: F, terminated: bool) -> None:
        trial = (*self.split(state), task)
        size = max(F(self.settings.step_size), F(1) / F(self.count.get(trial, 0) + 1))
        self.count[trial] = self.count.get(trial, 0) + 1
        known, reached = self.probability.setdefault(trial, {}), self.split(after)[0]
        for x in known.keys() | (set() if terminated else {reached}):
            old = known.get(x, F(0))
            known[x] = old + size * ((weight if x == reached else F(0)) - old)

    def plan(self, episode: int) -> None:
        for _ in range(self.settings.sweeps if episode % self.settings.interval == 0 else 0):
            self.value |= {
                point: max(self.backup(point, task, self.until_end.get((*point, task), F(0))) for task in tasks)
                for point, tasks in self.tasks.items()
            }

    def compare(self, learned: Any) -> None:
        bus, names = self.bus.env, self.bus.env.layout.area_names
        points = self.settings.prepare(bus.hierarchy(), bus)
        shape = (points.num_x, points.num_slots, points.num_outcomes + 1, points.num_y)
        model = np.asarray(learned.model).reshape(shape)
        until_end = np.asarray(learned.until_end).reshape(*shape[:2], -1)
        tasks, outcomes = points.tasks.reshape(shape[:2]), points.outcomes.reshape(*shape[:2], -1)
        assert model[:, :, -1].sum() == sum(self.count.values()) > 100
        for point in self.tasks:
            number = points.point[self.joined(*point)]
            x, y = divmod(int(number), points.num_y)
            slots = np.flatnonzero(points.can_invoke[x, :, y])
            assert [names[task] for task in tasks[x, slots]] == self.tasks[point]
            for slot, task in zip(slots, self.tasks[point], strict=True):
                seen = self.probability.get((*point, task), {})
                expected = {points.planning[self.joined(after, 0)]: p for after, p in seen.items()}
                assert expected.keys() <= set(outcomes[x, slot].tolist())
                row = [expected.get(outcome, F(0)) for outcome in outcomes[x, slot]]
                np.testing.assert_array_equal(model[x, slot, :, y], [*row, self.count.get((*point, task), 0)])
                if point in self.recorded:
                    assert until_end[x, slot, y] == self.until_end[*point, task]
            if point in self.recorded:
                assert learned.values[number] == self.value[point]


HIERARCHY = Bus().hierarchy()
LEARNERS = {
    "Q-learning": hrljax.QLearning(initial_value=-25.0, discount=0.97),
    "SARSA": hrljax.SARSA(step_size=0.3, epsilon=0.2, discount=0.97, initial_value=-3.0),
    "Q-learning, random ties": hrljax.QLearning(initial_value=-25.0, ties="random"),
    "SARSA, random ties": hrljax.SARSA(ties="random"),
    "HORDQ": hrljax.HORDQ(HIERARCHY, hrljax.RandomRoot(), pseudo_reward=5.0, discount=0.97, initial_value=-25.0),
    "HORDQ on policy": hrljax.HORDQ(
        HIERARCHY,
        hrljax.RandomRoot(),
        pseudo_reward=7.0,
        bootstrap="on_policy",
        step_size=optax.linear_schedule(0.5, 0.1, 40),
    ),
    "HORDQ in the backup": PseudoRewardInBackup(HIERARCHY, hrljax.RandomRoot(), pseudo_reward=5.0, discount=0.9),
    "HORDQ planned": hrljax.HORDQ(HIERARCHY, hrljax.ModelRoot(), pseudo_reward=5.0, discount=0.99, initial_value=-25.0),
    "shared": hrljax.SharedHORDQ(HIERARCHY, hrljax.RandomRoot(), discount=0.97, initial_value=-25.0),
    "shared planned": hrljax.SharedHORDQ(HIERARCHY, hrljax.ModelRoot(), discount=0.99, initial_value=-25.0),
    "shared planned, all active": hrljax.SharedHORDQ(
        HIERARCHY, hrljax.ModelRoot(), pseudo_reward=5.0, taught="active", bootstrap="on_policy"
    ),
    "MAXQ": hrljax.MAXQ(
        HIERARCHY, hrljax.RandomRoot(), pseudo_reward=60.0, epsilon=optax.linear_schedule(0.5, 0.1, 40), discount=0.97
    ),
}


def in_python(learner: Any, bus: PythonBus) -> Any:
    """The same learner as a plain program."""
    if isinstance(learner, hrljax.QLearning | hrljax.SARSA):
        return Flat(learner)
    root = PlannedRoot(learner, bus) if isinstance(learner.root, hrljax.ModelRoot) else None
    if isinstance(learner, hrljax.SharedHORDQ):
        program: Any = Shared(learner, bus.tasks(), 4, root)
    else:
        program = Decomposed(learner, bus.tasks(), root)
    if root is not None:
        root.program = program
    return program


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
def test_a_run_gives_the_numbers_of_plain_python(name: str, bus: Bus):
    learner = LEARNERS[name]
    run = jax.jit(lambda key: hrljax.train(bus, learner, key, EPISODES, params=PARAMS, bin_size=BIN_SIZE))(KEY)
    python_bus = PythonBus(bus)
    program = in_python(learner, python_bus)
    walk = train_in_python(program, python_bus, EPISODES)
    assert int(run.steps) == walk.steps
    sizes = np.array(bin_sizes(EPISODES, BIN_SIZE))
    sums = np.add.reduceat(walk.episodes, np.cumsum([0, *sizes])[:-1])
    for column, metric in enumerate(metric_names(bus, learner)):
        mean = np.asarray(run.metrics[metric], np.float64)
        np.testing.assert_array_equal(np.rint(mean * sizes), sums[:, column], err_msg=metric)
        np.testing.assert_allclose(mean, sums[:, column] / sizes, rtol=2e-7, err_msg=metric)
    assert sums[:, 2:].any(0).all()  # damage, breakdowns and truncated episodes all happened
    program.compare(run.learned)
    if "planned" in name:
        program.root_policy.compare(run.learned.root)
