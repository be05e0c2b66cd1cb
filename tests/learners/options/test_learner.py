"""Options: against plain Python bit for bit, by hand, against the optimum, and bad ones."""

import math
from collections import deque
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.core.random import WORD_RANGE
from hrljax.engine.evaluate import greedy_return
from hrljax.hierarchy.definition import Hierarchy, Subtask
from hrljax.learners.base import Context, LearnerState, Transition
from hrljax.learners.options.definition import Options, options_from, primitive_options
from hrljax.learners.options.learner import OptionQ
from tests.learners.python_levels import PythonEnv, train_in_python
from tests.words import KEY

F = np.float32
GRID = hrljax.make("Gridworld", map="S....P\n.S.#..\n..S...\nP....G\n")
PARAMS = GRID.default_params._replace(slip_probability=0.3, max_steps=15)
ROOMS = hrljax.make("Gridworld")
EPISODES = 60


def random_options(primitives: bool) -> Options:
    """Policies without sense; the first can begin everywhere."""
    generator = np.random.default_rng(5)
    policy = generator.integers(4, size=(3, 24))
    termination, initiation = generator.random((3, 24)) < 0.4, generator.random((3, 24)) < 0.6
    initiation[0] = True
    return Options(GRID.action_names, ("one", "two", "three"), policy, termination, initiation, primitives)


class PythonOptions:
    """Both updates of Sutton, Precup and Singh 1999, in loops."""

    def __init__(self, learner: OptionQ, options: Options):
        self.learner, self.options = learner, options
        self.first = 4 if options.primitives else 0
        self.numbers = range(self.first + len(options.names))
        self.q = np.full((24, len(self.numbers)), learner.initial_value, F)

    def policy(self, option: int, state: int) -> int:
        return option if option < self.first else int(self.options.policy[option - self.first, state])

    def ends(self, option: int, state: int) -> bool:
        return option < self.first or bool(self.options.termination[option - self.first, state])

    def can_begin(self, state: int) -> list[int]:
        initiation = self.options.initiation
        return [o for o in self.numbers if o < self.first or initiation[o - self.first, state]]

    def can_run(self, option: int, state: int) -> bool:
        return option in self.can_begin(state) or not self.ends(option, state)

    def best(self, state: int) -> int:
        return max(self.can_begin(state), key=lambda option: (self.q[state, option], -option))

    def begin(self, episode: int, state: int, words: list[int]) -> None:
        self.call(state, words)

    def call(self, state: int, words: list[int]) -> None:
        can_begin = self.can_begin(state)
        explores = words[0] < math.ceil(float(F(self.learner.epsilon)) * WORD_RANGE)
        self.option = can_begin[words[0] % len(can_begin)] if explores else self.best(state)
        self.initiated, self.rewards, self.discount = state, F(0), F(1)
        self.action = self.policy(self.option, state)

    def learn(self, state: int, reward: F, after: int, terminated: bool, words: list[int]) -> None:
        gamma, size = F(self.learner.discount), F(self.learner.step_size)
        best = F(0) if terminated else self.q[after, self.best(after)]
        self.rewards, self.discount = self.rewards + self.discount * reward, gamma * self.discount
        over = terminated or self.ends(self.option, after)
        if self.learner.update == "smdp":
            if over:
                target = self.rewards + self.discount * best
                self.q[self.initiated, self.option] += size * (target - self.q[self.initiated, self.option])
        else:
            before = self.q.copy()
            for option in self.numbers:
                if self.can_run(option, state) and self.policy(option, state) == self.action:
                    value = best if terminated or self.ends(option, after) else before[after, option]
                    self.q[state, option] += size * (reward + gamma * value - before[state, option])
        self.plan(after, over, terminated, words)
        if over:
            self.call(after, words)
        else:
            self.action = self.policy(self.option, after)

    def plan(self, after: int, over: bool, terminated: bool, words: list[int]) -> None: ...

    def greedy_return(self, env: PythonEnv) -> float:
        """By backward induction over (option, state) pairs, in float64."""
        model, first = GRID.model(PARAMS), GRID.initial_distribution()
        value = np.zeros((len(self.numbers), 24))
        called = [self.best(state) for state in range(24)]
        for _ in range(PARAMS.max_steps):
            updated = np.zeros_like(value)
            for option in self.numbers:
                for state in range(24):
                    where = state, self.policy(option, state)
                    for after, chance, reward, over in zip(*(column[where] for column in model), strict=True):
                        follows = value[called[after] if self.ends(option, after) else option, after]
                        updated[option, state] += chance * (reward + (0 if over else follows))
            value = updated
        return float(sum(first[s] * value[called[s], s] for s in range(24)))


@pytest.mark.parametrize(
    ("update", "primitives"),
    [("smdp", True), pytest.param("smdp", False, marks=pytest.mark.slow), ("intra_option", True)],
)
def test_a_run_gives_the_numbers_of_plain_python(update: Any, primitives: bool):
    options = random_options(primitives)
    learner = OptionQ(options, update=update, step_size=0.3, epsilon=0.3, discount=0.93, initial_value=-8.0)

    @jax.jit
    def both(key: jax.Array) -> tuple[hrljax.Run, jax.Array]:
        run = hrljax.train(GRID, learner, key, EPISODES, params=PARAMS)
        value = greedy_return(learner, GRID, learner.prepare(GRID), run.learned, PARAMS, jnp.uint32(0), 0)
        return run, value

    run, value = both(KEY)
    env = PythonEnv(GRID, PARAMS)
    walk = train_in_python(PythonOptions(learner, options), env, EPISODES)
    python = walk.program
    assert int(run.steps) == walk.steps
    assert 0 < walk.truncated < EPISODES
    np.testing.assert_array_equal(np.asarray(run.learned).reshape(python.q.shape), python.q)
    assert (python.q != -8).any(0).all()  # every option was learned of
    assert float(value) == pytest.approx(python.greedy_return(env), abs=1e-4)


@pytest.mark.parametrize("update", ["smdp", pytest.param("intra_option", marks=pytest.mark.slow)])
def test_primitive_options_alone_are_q_learning(update: Any):
    numbers = {"step_size": 0.3, "epsilon": 0.3, "discount": 0.9, "initial_value": -4.0}

    def learned(learner: Any) -> hrljax.Run:
        return jax.jit(lambda key: hrljax.train(GRID, learner, key, 50, params=PARAMS))(KEY)

    flat = learned(hrljax.QLearning(**numbers))
    options = learned(OptionQ(primitive_options(GRID), update=update, **numbers))
    jax.tree.map(np.testing.assert_array_equal, flat, options)
    assert int(flat.steps) > 200


CORRIDOR = hrljax.make("Gridworld", map="S...G\n")
NORTH, EAST, SOUTH, WEST, GO, HALT = range(6)


def corridor_options() -> Options:
    """Go walks east from the first two cells and ends in the fourth; Halt does so too, but ends after every step."""
    column = np.arange(5)
    begins = np.stack([column < 2, column < 2])
    ends = np.stack([column >= 3, column != 0])
    return Options(CORRIDOR.action_names, ("go", "halt"), np.ones((2, 5), np.int32), ends, begins)


def walked(update: Any, values: np.ndarray, steps: int) -> tuple[np.ndarray, Any]:
    """Tables and control after some greedy steps along the corridor, one reward of -1 each."""
    learner = OptionQ(corridor_options(), update=update, step_size=0.5, epsilon=0.0, discount=0.5)
    prepared = learner.prepare(CORRIDOR)
    context = Context(jnp.int32(0), jnp.bool_(True), jnp.uint32(0))
    word = (jnp.uint32(0),)
    tables = jnp.asarray(values, jnp.float32).ravel()
    state = LearnerState(tables, learner.begin(prepared, tables, jnp.int32(0), word, context))
    for cell in range(steps):
        assert int(learner.action(state.control)) == EAST
        over = jnp.bool_(cell == 3)
        step = Transition(jnp.int32(cell), jnp.int32(EAST), jnp.float32(-1), jnp.int32(cell + 1), over)
        state = learner.learn(prepared, state, step, word, context)
    return np.asarray(state.tables).reshape(5, 6), state.control


def test_an_smdp_update_by_hand():
    values = np.zeros((5, 6))
    values[0, GO], values[3, EAST] = 8, 16
    after, control = walked("smdp", values, 2)
    np.testing.assert_array_equal(after, values)  # go still runs, from cell 0
    assert (control.option, control.state, control.reward, control.discount) == (GO, 0, -1.5, 0.25)
    after, control = walked("smdp", values, 3)
    values[0, GO] = 8 + 0.5 * (-1 - 0.5 - 0.25 + 0.125 * 16 - 8)
    np.testing.assert_array_equal(after, values)
    assert (control.option, control.state, control.reward, control.discount) == (EAST, 3, 0, 1)
    after, _ = walked("smdp", values, 4)
    values[0, GO] += 0.5 * (0.25 - values[0, GO])
    values[3, EAST] = 16 + 0.5 * (-1 - 16)  # the end has no value
    np.testing.assert_array_equal(after, values)


def test_an_intra_option_update_by_hand():
    values = np.zeros((5, 6))
    values[0] = 0, 2, 0, 0, 8, 4
    values[1] = 0, 32, 0, 0, 16, 64
    after, control = walked("intra_option", values, 1)
    target_of_going_on, target_of_ending = -1 + 0.5 * 16, -1 + 0.5 * 64
    values[0] = 0, 1 + target_of_ending / 2, 0, 0, 4 + target_of_going_on / 2, 2 + target_of_ending / 2
    np.testing.assert_array_equal(after, values)
    assert (control.option, control.action) == (GO, EAST)


@pytest.mark.slow
@pytest.mark.parametrize("update", ["smdp", "intra_option"])
def test_four_rooms_are_solved_and_every_mapping_gives_one_result(update: Any):
    """With steps of 1 in a deterministic world, values become those of the shortest path: 20 moves."""

    def swept(mapping: Any, **options: Any) -> Any:
        learner = OptionQ(options_from(ROOMS.hierarchy(), ROOMS), update=update, step_size=1.0, epsilon=0.2)
        return hrljax.sweep(ROOMS, learner, seeds=2, num_episodes=400, mapping=mapping, progress=False, **options)

    native = swept("native", evaluate_every=200)
    np.testing.assert_array_equal(native["greedy_return"].values[:, -1], -20)
    other = swept("vmap")
    assert set(native) - set(other) == {"greedy_return"}
    for variable in other:
        np.testing.assert_array_equal(native[variable].values, other[variable].values, err_msg=str(variable))


def test_options_of_a_hierarchy_take_the_shortest_way_and_the_first_of_equal_actions():
    options = options_from(ROOMS.hierarchy(), ROOMS, primitives=False)
    assert options.names == ("Goto(e)", "Goto(n)", "Goto(s)", "Goto(w)", "Goto(G)")
    layout = ROOMS.layout
    for name, policy, initiation in zip(options.names, options.policy, options.initiation, strict=True):
        goal = next(cell for cell, mark in layout.marks.items() if f"Goto({mark})" == name)
        distance, queue = {goal: 0}, deque([goal])
        while queue:  # every move can be undone
            cell = queue.popleft()
            for neighbour in layout.neighbour[cell].tolist():
                if neighbour not in distance and initiation[neighbour]:
                    distance[neighbour] = distance[cell] + 1
                    queue.append(neighbour)
        for cell in np.flatnonzero(initiation).tolist():
            nearer = [distance.get(n, math.inf) < distance[cell] for n in layout.neighbour[cell].tolist()]
            assert policy[cell] == nearer.index(True), (name, cell)
    np.testing.assert_array_equal(options.termination, ~options.initiation)


def test_options_compare_by_value():
    one, other = random_options(True), random_options(True)
    assert one == other
    assert hash(one) == hash(other)
    assert one != random_options(False)
    assert "one, two, three" in repr(one)


GOOD = {
    "actions": GRID.action_names,
    "names": ("one", "bad"),
    "policy": np.zeros((2, 24), np.int32),
    "termination": np.tile(np.arange(24) > 20, (2, 1)),
    "initiation": np.ones((2, 24), np.bool_),
}


def second(name: str, row: Any) -> dict[str, np.ndarray]:
    array = GOOD[name].copy()
    array[1] = row
    return {name: array}


BAD = {
    "option 'bad' takes action 4 in state 0; actions are 0 to 3": second("policy", 4),
    "option 'bad' can be initiated in no state": second("initiation", False),
    "option 'bad' terminates in every state in which it can be initiated": second("termination", True),
    r"termination must be bools of shape \(2, any\), got shape \(3, 24\)": {"termination": np.ones((3, 24), bool)},
    "policy must be numbers of actions, got 1099511627776 to 1099511627776": {"policy": np.full((2, 24), 2**40)},
    "primitives must be one of False, True, got 'some'": {"primitives": "some"},
    "policy, termination and initiation must have one shape": {"initiation": np.ones((2, 23), bool)},
    "the name 'one' is used 2 times": {"names": ("one", "one")},
    "the name 'north' is used 2 times": {"names": ("one", "north")},
}


@pytest.mark.parametrize("message", BAD)
def test_bad_options_are_named(message: str):
    with pytest.raises(ValueError, match=message):
        Options(**{**GOOD, **BAD[message]})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"policy": np.zeros((2, 24))}, r"policy must be integers of shape \(2, any\), got float64"),
        ({"termination": np.ones((2, 24), int)}, r"termination must be bools of shape \(2, any\), got int64"),
        ({"names": "ab"}, "names must be a sequence of names, got 'ab'"),
    ],
)
def test_options_of_the_wrong_type_are_named(wrong: dict, message: str):
    with pytest.raises(TypeError, match=message):
        Options(**{**GOOD, **wrong})


def test_options_that_do_not_fit_the_environment():
    with pytest.raises(ValueError, match=r"the options are over actions .*, Maze has \('north', 'south', 'east'\)"):
        OptionQ(random_options(True)).prepare(hrljax.make("Maze"))
    with pytest.raises(ValueError, match="the options are over 24 states, Gridworld has 169"):
        OptionQ(random_options(True)).prepare(ROOMS)
    begins = GOOD["initiation"] & (np.arange(24) != 7)  # a start
    with pytest.raises(ValueError, match="no option can be initiated in state 7"):
        OptionQ(Options(**{**GOOD, "initiation": begins}, primitives=False)).prepare(GRID)


def test_bad_arguments_are_named():
    taxi = hrljax.make("Taxi")
    with pytest.raises(ValueError, match=r"'Get' is no subtask with primitive children only; those are Navigate\(R\)"):
        options_from(taxi.hierarchy(), taxi, ["Get"])
    alone = Hierarchy(GRID.action_names, [Subtask("Root", GRID.action_names, lambda state: jnp.bool_(False))])
    with pytest.raises(ValueError, match="no subtask below its root"):
        options_from(alone, GRID)
    with pytest.raises(TypeError, match="OptionQ: options must be Options"):
        OptionQ(alone)  # type: ignore[arg-type]
    for call, error, message in (
        (lambda: primitive_options(5), TypeError, "env must be a tabular environment such as .*got 5"),
        (lambda: options_from(taxi.hierarchy(), 5), TypeError, "env must be a tabular environment such as .*got 5"),
        (
            lambda: options_from(taxi.hierarchy(), taxi, "Get"),
            TypeError,
            "names must be a sequence of names, got 'Get'",
        ),
        (
            lambda: options_from(taxi.hierarchy(), taxi, pseudo_reward=np.nan),
            ValueError,
            "pseudo_reward must be .*got nan",
        ),
        (lambda: options_from(GRID.hierarchy(), GRID, discount=2), ValueError, r"discount must be .*\[0, 1\], got 2"),
    ):
        with pytest.raises(error, match=message):
            call()
    with pytest.raises(ValueError, match="OptionQ: update must be one of 'smdp', 'intra_option', got 'q'"):
        OptionQ(random_options(True), update="q")  # type: ignore[arg-type]
