"""Learners against the same algorithms in plain Python, scalar by scalar: equal numbers, not close ones."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import hrljax
from hrljax.engine.run import bin_sizes, metric_names
from hrljax.envs.bus.env import Bus, BusParams
from hrljax.experiments.backup import PseudoRewardInBackup
from tests.words import KEY, drawn

F = np.float32
EPISODES, BIN_SIZE = 60, 7
PARAMS = BusParams(max_steps=150)
FLAGS = 6  # bits of a state number below the cell: damaged, three passengers, two sites


class PythonBus:
    """The Bus domain with the default options."""

    def __init__(self, bus: Bus):
        layout = bus.layout
        self.neighbour, self.site, self.area = layout.neighbour.tolist(), layout.site.tolist(), layout.area.tolist()
        self.passengers, self.start = layout.passengers, layout.start
        self.areas = range(len(layout.area_names))
        edges = {(self.area[c], self.area[n]) for c, row in enumerate(self.neighbour) for n in row}
        self.adjacent = {(a, b) for a, b in edges if a != b}

    def initial(self, word: int) -> int:
        return self.start << FLAGS | word * 3 >> 24

    def step(self, state: int, action: int, words: list[int]) -> tuple[int, float, bool, bool, bool]:
        """Next state, reward, terminated, damaged now, broken down now."""
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
        return after, -51.0 if broke else -1.0, broke or (picked == 7 and cell == self.start), hit, broke

    def active(self, task: int, state: int) -> bool:
        return (self.area[state >> FLAGS], task) in self.adjacent

    def goal(self, task: int, state: int) -> float:
        return float(self.area[state >> FLAGS] == task)


def at(value: Any, episode: int) -> F:
    """A hyper-parameter in an episode."""
    return F(jax.vmap(value)(jnp.arange(EPISODES))[episode] if callable(value) else value)


def explores(word: int, epsilon: F) -> bool:
    return word < math.ceil(float(epsilon) * 2**24)


class Flat:
    """Q-learning and SARSA(0)."""

    def __init__(self, learner: Any, bus: PythonBus):
        self.learner, self.on_policy = learner, isinstance(learner, hrljax.SARSA)
        self.q = np.full((2304, 4), learner.initial_value, F)
        self.epsilon, self.step_size = F(learner.epsilon), F(learner.step_size)

    def choose(self, state: int, word: int) -> int:
        return word % 4 if explores(word, self.epsilon) else int(np.argmax(self.q[state]))

    def begin(self, episode: int, state: int, words: list[int]) -> None:
        self.action = self.choose(state, words[0])

    def learn(self, state: int, reward: float, after: int, terminated: bool, words: list[int]) -> None:
        action = self.action
        follows = self.choose(after, words[0]) if self.on_policy else int(np.argmax(self.q[after]))
        value = F(0) if terminated else self.q[after, follows]
        target = F(reward) + F(self.learner.discount) * value
        self.q[state, action] += self.step_size * (target - self.q[state, action])
        self.action = follows if self.on_policy else self.choose(after, words[0])

    def compare(self, learned: Any, bus: Bus) -> None:
        np.testing.assert_array_equal(np.asarray(learned).reshape(2304, 4), self.q)


class Hierarchical:
    """HORDQ and MAXQ-Q under a root."""

    def __init__(self, learner: Any, bus: PythonBus):
        self.learner, self.bus, self.is_hordq = learner, bus, isinstance(learner, hrljax.HORDQ)
        self.parts = np.zeros((6, 2304, 4, 4), F)  # Q_r, Q_c, Q_e, Q_p
        self.parts[..., 2 if self.is_hordq else 1] = learner.initial_value
        self.root = PlannedRoot(self) if isinstance(learner.root, hrljax.ModelRoot) else None

    def worth(self, task: int, state: int) -> np.ndarray:
        reward, completion, after_exit, pseudo = self.parts[task, state].T
        real = reward + completion + after_exit if self.is_hordq else reward + completion
        return real + pseudo

    def act(self, state: int, word: int) -> int:
        return word % 4 if explores(word, self.epsilon) else int(np.argmax(self.worth(self.task, state)))

    def decide(self, state: int, word: int, first: bool) -> None:
        invocable = [task for task in self.bus.areas if self.bus.active(task, state)]
        if self.root:
            self.task = self.root.choose(state, invocable, word, first)
        else:
            self.task = invocable[word % len(invocable)]
        self.decided_at, self.so_far = state, F(1)

    def begin(self, episode: int, state: int, words: list[int]) -> None:
        for name in ("epsilon", "pseudo_reward", "step_size"):
            setattr(self, name, at(getattr(self.learner, name), episode))
        self.decide(state, words[0], first=True)
        self.action = self.act(state, words[1])
        if self.root and episode % self.learner.root.interval == 0:
            self.root.plan()

    def learn(self, state: int, reward: float, after: int, terminated: bool, words: list[int]) -> None:
        task, action, discount = self.task, self.action, F(self.learner.discount)
        ended, on_policy = not self.bus.active(task, after), self.learner.bootstrap == "on_policy"
        self.so_far *= discount
        if self.root and (ended or terminated):
            self.root.observe(self.decided_at, task, after, F(0) if terminated else self.so_far, terminated)
        if ended and not terminated:
            self.decide(after, words[0], first=False)
        taken = self.act(after, words[1])
        child = taken if on_policy else int(np.argmax(self.worth(self.task, after)))
        next_r, next_c, next_e, next_p = np.zeros(4, F) if terminated else self.parts[self.task, after, child]
        pseudo = self.pseudo_reward * F(self.bus.goal(task, after))
        if ended:
            target = [F(reward), F(0), discount * (next_r + next_c + next_e), pseudo]
        else:
            target = [F(reward), discount * (next_r + next_c), discount * next_e, discount * next_p]
        if isinstance(self.learner, PseudoRewardInBackup):
            target[1:] = [pseudo if ended else target[1], target[2], F(0)]
        old = self.parts[task, state, action]
        self.parts[task, state, action] = old + self.step_size * (np.array(target) - old)
        self.action = taken if on_policy else self.act(after, words[1])

    def compare(self, learned: Any, bus: Bus) -> None:
        used = [0, 1, 2, 3] if self.is_hordq else [0, 1, 3]  # MAXQ-Q reads no Q_e
        parts = np.asarray(learned.q).reshape(self.parts.shape)
        np.testing.assert_array_equal(parts[..., used], self.parts[..., used])
        if self.root:
            self.root.compare(learned.root, bus)


class PlannedRoot:
    """The model-based root, in dictionaries over (planning part, environment part)."""

    def __init__(self, learner: Hierarchical):
        self.learner, self.settings = learner, learner.learner.root
        self.unknown = F(self.settings.unknown_value)
        self.probability: dict[tuple, dict[int, F]] = {}  # outcomes by (x, y, task)
        self.count: dict[tuple, int] = {}
        self.value: dict[tuple, F] = {}
        self.until_end: dict[tuple, F] = {}
        self.tasks: dict[tuple, list[int]] = {}
        self.recorded: set[tuple] = set()  # points decided at within an episode; values of others feed nothing

    @staticmethod
    def split(state: int) -> tuple[int, int]:
        return state >> FLAGS << 3 | state >> 2 & 7, state >> 3 & 4 | state & 3

    @staticmethod
    def joined(x: int, y: int) -> int:
        return x >> 3 << FLAGS | (y & 4) << 3 | (x & 7) << 2 | y & 3

    def backup(self, point: tuple[int, int], task: int, until_end: F) -> F:
        if not self.count.get((*point, task)):
            return self.unknown
        after = F(0)
        for x, probability in sorted(self.probability[*point, task].items()):
            after = after + probability * self.value.get((x, point[1]), self.unknown)
        return until_end + after

    def choose(self, state: int, invocable: list[int], word: int, first: bool) -> int:
        point, until_end = self.split(state), {}
        for task in invocable:
            row = self.learner.parts[task, state, np.argmax(self.learner.worth(task, state))]
            until_end[task] = row[0] + row[1]
        worth = [self.backup(point, task, until_end[task]) for task in invocable]
        self.tasks[point] = invocable
        if not first:
            self.recorded.add(point)
            self.value[point] = max(worth)
            self.until_end |= {(*point, task): value for task, value in until_end.items()}
        return invocable[word % len(invocable) if explores(word, self.learner.epsilon) else int(np.argmax(worth))]

    def observe(self, state: int, task: int, after: int, weight: F, terminated: bool) -> None:
        trial = (*self.split(state), task)
        size = max(F(self.settings.step_size), F(1) / F(self.count.get(trial, 0) + 1))
        self.count[trial] = self.count.get(trial, 0) + 1
        known, reached = self.probability.setdefault(trial, {}), self.split(after)[0]
        for x in known.keys() | (set() if terminated else {reached}):
            old = known.get(x, F(0))
            known[x] = old + size * ((weight if x == reached else F(0)) - old)

    def plan(self) -> None:
        for _ in range(self.settings.sweeps):
            self.value |= {
                point: max(self.backup(point, task, self.until_end.get((*point, task), F(0))) for task in tasks)
                for point, tasks in self.tasks.items()
            }

    def compare(self, learned: Any, bus: Bus) -> None:
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
            assert tasks[x, slots].tolist() == self.tasks[point]
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


class Curve(NamedTuple):
    sums: np.ndarray  # [bins, 5], the columns of `metric_names`
    steps: int


def train_in_python(learner: Any, bus: PythonBus, step_words: list[list[int]], begin_words: list[list[int]]) -> Curve:
    rows, steps = [], 0
    for episode in range(EPISODES):
        words = begin_words[episode]
        state, time, counts, terminated = bus.initial(words[0]), 0, np.zeros(3), False
        learner.begin(episode, state, words[1:])
        while not terminated and time < PARAMS.max_steps:
            words = step_words[steps]
            after, reward, terminated, hit, broke = bus.step(state, learner.action, words[:3])
            learner.learn(state, reward, after, terminated, words[3:])
            state, time, steps = after, time + 1, steps + 1
            counts += reward, hit, broke
        rows.append([counts[0], time, *counts[1:], not terminated])
    starts = np.cumsum([0, *bin_sizes(EPISODES, BIN_SIZE)])[:-1]
    return Curve(np.add.reduceat(np.array(rows), starts), steps)


HIERARCHY = Bus().hierarchy()
LEARNERS = {
    "Q-learning": hrljax.QLearning(initial_value=-25.0, discount=0.97),
    "SARSA": hrljax.SARSA(step_size=0.3, epsilon=0.2, discount=0.97, initial_value=-3.0),
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
    "MAXQ": hrljax.MAXQ(
        HIERARCHY, hrljax.RandomRoot(), pseudo_reward=60.0, epsilon=optax.linear_schedule(0.5, 0.1, 40), discount=0.97
    ),
}


@pytest.mark.parametrize("name", LEARNERS)
def test_a_run_gives_the_numbers_of_plain_python(name: str, bus: Bus):
    learner = LEARNERS[name]
    run = jax.jit(lambda key: hrljax.train(bus, learner, key, EPISODES, params=PARAMS, bin_size=BIN_SIZE))(KEY)
    python_bus = PythonBus(bus)
    python = Flat(learner, python_bus) if name in ("Q-learning", "SARSA") else Hierarchical(learner, python_bus)
    step_words = drawn(EPISODES * PARAMS.max_steps, 3 + learner.num_words, 0)
    curve = train_in_python(python, python_bus, step_words, drawn(EPISODES, 1 + learner.num_begin_words, 2))
    assert int(run.steps) == curve.steps
    sizes = np.array(bin_sizes(EPISODES, BIN_SIZE))
    for column, metric in enumerate(metric_names(bus, learner)):
        mean = np.asarray(run.metrics[metric], np.float64)
        np.testing.assert_array_equal(np.rint(mean * sizes), curve.sums[:, column], err_msg=metric)
        np.testing.assert_allclose(mean, curve.sums[:, column] / sizes, rtol=2e-7, err_msg=metric)
    assert curve.sums[:, 2:].any(0).all()  # damage, breakdowns and truncated episodes all happened
    python.compare(run.learned, bus)
