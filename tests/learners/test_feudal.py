"""Feudal Q-learning: against plain Python bit for bit, one scale, and what is refused."""

import math
from typing import Any

import jax
import numpy as np
import optax
import pytest

import hrljax
from hrljax.learners.feudal import SEARCH, FeudalQ, feud
from tests.learners.python_levels import PythonEnv, train_in_python
from tests.maps import optimum
from tests.words import KEY

F = np.float32
GRID = hrljax.make("Gridworld", map="S......\n..S.#..\n..S.#..\n....#.G\n.......\n")
MAZE = hrljax.make("Maze")
EPISODES = 40
STEPS = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
COMMANDS = (*STEPS, "search")


class Manager:
    """One of the managers: what it was told, what it told, and what it thinks of that."""

    def __init__(self, learner: FeudalQ, choices: int):
        self.learner, self.choices = learner, choices
        self.q: dict[tuple[str, tuple[int, int]], np.ndarray] = {}
        self.choice = 0

    def values(self, command: str, region: tuple[int, int]) -> np.ndarray:
        return self.q.setdefault((command, region), np.full(self.choices, self.learner.initial_value, F))

    def choose(self, command: str, region: tuple[int, int], word: int) -> None:
        explores = word < math.ceil(float(F(self.learner.epsilon)) * 2**24)
        values = self.values(command, region)
        best = np.flatnonzero(values == values.max())
        greedy = int(best[word % len(best) if self.learner.ties == "random" else 0])
        self.choice = word % self.choices if explores else greedy


class Feudal:
    """A list of managers, the coarsest first; regions are pairs of a row and a column."""

    def __init__(self, learner: FeudalQ, env: Any):
        self.learner, self.columns = learner, env.layout.width
        scales = learner.scales
        self.sides = [1000, *(2 ** (scales - scale) for scale in range(1, scales + 1))]
        self.managers = [Manager(learner, 5) for _ in range(scales - 1)] + [Manager(learner, env.num_actions)]

    def region(self, scale: int, state: int) -> tuple[int, int]:
        row, column = divmod(state, self.columns)
        return row // self.sides[scale], column // self.sides[scale]

    def command(self, level: int) -> str:
        return COMMANDS[self.managers[level - 1].choice] if level else "search"

    @property
    def action(self) -> int:
        return self.managers[-1].choice

    def begin(self, episode: int, state: int, words: list[int]) -> None:
        for level, manager in enumerate(self.managers):
            manager.choose(self.command(level), self.region(level + 1, state), words[level])

    def learn(self, state: int, reward: F, after: int, terminated: bool, words: list[int]) -> None:
        size, gamma = F(self.learner.step_size), F(self.learner.discount)
        for level, manager in enumerate(self.managers):
            command, around = self.command(level), self.region(level, state)
            here, there = self.region(level + 1, state), self.region(level + 1, after)
            if here == there and manager is not self.managers[-1] and not terminated:
                continue
            over = around != self.region(level, after) or terminated
            if command == "search":
                carried_out = terminated
            else:
                down, right = STEPS[command]
                carried_out = self.region(level, after) == (around[0] + down, around[1] + right)
            earned = (F(1) if carried_out else -F(self.learner.failure_cost)) if over else F(0)
            earned -= F(self.learner.move_cost)
            follows = F(0) if over else manager.values(command, there).max()
            values = manager.values(command, here)
            values[manager.choice] += size * (earned + gamma * follows - values[manager.choice])
        self.choose_anew(state, after, words)

    def choose_anew(self, state: int, after: int, words: list[int]) -> None:
        for level, manager in enumerate(self.managers, start=1):
            if level == len(self.managers) or self.region(level, state) != self.region(level, after):
                manager.choose(self.command(level - 1), self.region(level, after), words[level - 1])

    def compare(self, learned: Any, env: Any) -> None:
        prepared, learned = feud(env, self.learner.scales), np.asarray(learned)
        for level, manager in enumerate(self.managers, start=1):
            columns = (self.columns - 1) // self.sides[level] + 1
            for (command, region), values in manager.q.items():
                number = np.int32(region[0] * columns + region[1])
                start = int(prepared.row(level, np.int32(COMMANDS.index(command)), number))
                np.testing.assert_array_equal(learned[start : start + len(values)], values)


@pytest.mark.parametrize(
    ("env", "scales", "ties"),
    [
        pytest.param(GRID, 3, "first", id="grid", marks=pytest.mark.slow),
        pytest.param(GRID, 2, "random", id="random ties"),
        pytest.param(GRID, 1, "first", id="one scale", marks=pytest.mark.slow),
        pytest.param(MAZE, 2, "first", id="maze"),
    ],
)
def test_a_run_gives_the_numbers_of_plain_python(env: Any, scales: int, ties: Any):
    params = env.default_params._replace(slip_probability=0.25, max_steps=60)
    learner = FeudalQ(scales, 0.5, 0.25, 0.93, 0.125, 0.3, 0.7, ties=ties)
    run = jax.jit(lambda key: hrljax.train(env, learner, key, EPISODES, params=params, bin_size=1))(KEY)
    program = Feudal(learner, env)
    walk = train_in_python(program, PythonEnv(env, params), EPISODES)
    assert int(run.steps) == walk.steps
    np.testing.assert_array_equal(run.metrics["return"], walk.episodes[:, 0].astype(F))
    program.compare(run.learned, env)
    assert {command for manager in program.managers for command, _ in manager.q} == (
        set(COMMANDS) if scales > 1 else {"search"}
    )
    assert 0 < walk.truncated < EPISODES or scales == 1


def test_the_greedy_policy_is_what_managers_do_that_do_not_explore():
    """Each keeps its choice until it has left its region; the exact value goes by the state alone."""
    learner, episodes = FeudalQ(3, 0.5, 0.25), 200
    run = jax.jit(lambda key: hrljax.train(GRID, learner, key, episodes, bin_size=episodes, evaluate_every=1))(KEY)
    env, program = PythonEnv(GRID, GRID.default_params), Feudal(learner, GRID)
    train_in_python(program, env, episodes)
    program.compare(run.learned, GRID)
    words, returns = [2**24 - 1] * 3, []
    for state in np.flatnonzero(GRID.initial_distribution()).tolist():
        program.begin(0, state, words)
        terminated, total = False, 0.0
        while not terminated and total > -60:
            after, reward, terminated, _ = env.step(state, program.action, [0] * len(env.cuts))
            program.choose_anew(state, after, words)
            state, total = after, total + float(reward)
        assert terminated
        returns.append(total)
    assert float(run.greedy_return[0]) == pytest.approx(np.mean(returns), rel=1e-6)


def test_one_scale_is_q_learning_for_its_own_rewards():
    """On a grid that pays them, bit for bit."""
    params = GRID.default_params._replace(step_reward=-0.25, goal_reward=0.75, max_steps=60)
    numbers = {"step_size": 0.5, "epsilon": 0.25, "discount": 0.93, "initial_value": 0.125}
    options = {"seeds": 5, "num_episodes": 60, "bin_size": 1, "params": params, "progress": False}
    feudal, flat = (
        hrljax.sweep(GRID, of, **options) for of in (FeudalQ(1, **numbers, move_cost=0.25), hrljax.QLearning(**numbers))
    )
    for name in ("return", "length"):
        np.testing.assert_array_equal(feudal[name], flat[name])


def test_it_learns_its_maze():
    """Ways less than half as long again as the shortest, after 200 episodes; also in four rooms."""
    for grid, scales in (("barrier", 3), ("four_rooms", 4)):
        env = hrljax.make("Gridworld", map=grid)
        learner = FeudalQ(scales, 0.5, optax.linear_schedule(0.1, 0.0, 150))
        curves = hrljax.sweep(env, learner, seeds=20, num_episodes=200, bin_size=20, progress=False)
        best = -optimum(env)
        lengths = curves["length"].mean("seed").values
        assert best <= lengths[-1] < 1.5 * best < lengths[0] / 5, (grid, best, lengths)


@pytest.mark.slow
def test_a_seed_has_one_result_under_every_mapping():
    params = GRID.default_params._replace(slip_probability=0.25, max_steps=60)
    options = {"seeds": 3, "num_episodes": 12, "bin_size": 1, "params": params, "progress": False}
    axes = {"step_size": [0.1, 0.7]}
    native, vmap = (
        hrljax.sweep(GRID, FeudalQ(), axes=axes, mapping=mapping, **options) for mapping in ("native", "vmap")
    )
    for variable in native:
        np.testing.assert_array_equal(native[variable], vmap[variable], err_msg=str(variable))


def test_regions_by_hand():
    """Five rows of seven cells, in squares of 4, 2 and 1: 2 x 2, 3 x 4 and 5 x 7 regions."""
    regions = feud(GRID, 3)
    assert regions.num_regions == (1, 4, 12, 35)
    cell = 3 * 7 + 4
    assert [int(regions.region[scale * 35 + cell]) for scale in range(4)] == [0, 1, 1 * 4 + 2, cell]
    beside = [int(regions.neighbour(2, np.int32(6), np.int32(way))) for way in range(4)]
    assert beside == [2, 7, 10, 5]
    assert [int(regions.neighbour(0, np.int32(0), np.int32(way))) for way in range(4)] == [-1] * 4
    assert regions.width == SEARCH + 1


def test_what_is_no_grid_is_refused():
    with pytest.raises(ValueError, match="needs a grid, with a row and a column; Taxi has row, column, passenger"):
        hrljax.train(hrljax.make("Taxi"), FeudalQ(), KEY, 1)
    with pytest.raises(ValueError, match="scales must be an integer from 1 to 12, got 0"):
        FeudalQ(0)
