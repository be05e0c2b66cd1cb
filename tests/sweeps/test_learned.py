"""What was learned comes back from disk bit for bit, and its policy does what the learner would do."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import xarray as xr

import hrljax
from hrljax.engine.evaluate import greedy_return
from hrljax.envs.grid.maze import Maze
from hrljax.hierarchy.numpy_policy import Policy
from hrljax.sweeps.learned import Learned
from tests.maps import SMALL

MAZE = hrljax.make("Maze")
TAXI = hrljax.make("Taxi")
LEARNERS: dict[str, tuple[Any, Any]] = {
    "QLearning": (MAZE, hrljax.QLearning(initial_value=-5.0)),
    "MAXQ": (MAZE, hrljax.MAXQ(MAZE.hierarchy(), pseudo_reward=5.0)),
    "HORDQ random": (SMALL, hrljax.HORDQ(SMALL.hierarchy(), hrljax.RandomRoot())),
    "HORDQ model": (SMALL, hrljax.HORDQ(SMALL.hierarchy(), hrljax.ModelRoot(interval=2))),
    "HAMQ deep": (TAXI, hrljax.HAMQ(TAXI.hierarchy())),
    "MAXQ-0 deep": (TAXI, hrljax.MAXQ0(TAXI.hierarchy())),
}


def with_options() -> Any:
    """Files do not hold its options."""
    return hrljax.OptionQ(hrljax.options_from(MAZE.hierarchy(), MAZE))


def some_tables(env: Any, learner: Any) -> Any:
    """Tables as no run leaves them, so that every entry matters."""
    draw = np.random.default_rng(3)
    shapes = jax.eval_shape(lambda: learner.init(env, learner.prepare(env)).tables)
    return jax.tree.map(lambda leaf: draw.normal(-5, 3, leaf.shape).astype(leaf.dtype), shapes)


def expected_return(env: Any, policy: Policy, params: Any) -> float:
    """Of a policy, by its own stack and state: sweeps over the model in float64."""
    model, starts = env.model(params), env.initial_distribution(params)
    roots = [(1.0, ())] if policy.choice is None else None
    values: dict[tuple[Any, int], float] = {}

    def begins(state: int) -> list[tuple[float, tuple[int, ...]]]:
        if roots is not None:
            return [(1.0, (0,))]
        assert policy.choice is not None
        return [(float(p), (task,)) for task, p in enumerate(policy.choice[state]) if p > 0]

    def value(stack: tuple[int, ...], state: int) -> float:
        stack = policy.left(stack, state)
        options = [(1.0, stack)] if stack else begins(state)
        return sum(p * values.get((option, state), 0.0) for p, option in options)

    pairs: list[tuple[Any, int]] = [(option, int(s)) for s in np.flatnonzero(starts) for _, option in begins(int(s))]
    moves: dict[tuple[Any, int], tuple[float, list[tuple[float, Any, int]]]] = {}
    for stack, state in pairs:
        if (stack, state) in moves:
            continue
        after, action = policy.decide(stack, state)
        outcomes = []
        for k in range(model.next_state.shape[-1]):
            p, end = float(model.probability[state, action, k]), bool(model.terminated[state, action, k])
            follows = int(model.next_state[state, action, k])
            if p > 0 and not end:
                outcomes.append((p, after, follows))
                rest = policy.left(after, follows)
                pairs += [(option, follows) for option in ([rest] if rest else [o for _, o in begins(follows)])]
        reward = float((model.probability[state, action] * model.reward[state, action]).sum())
        moves[stack, state] = reward, outcomes
    for _ in range(params.max_steps):
        values = {
            pair: reward + sum(p * value(stack, state) for p, stack, state in outcomes)
            for pair, (reward, outcomes) in moves.items()
        }
    return sum(float(starts[s]) * value((), int(s)) for s in np.flatnonzero(starts))


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
def test_a_policy_is_worth_what_its_learner_says(name: str):
    env, learner = LEARNERS[name]
    tables, params = some_tables(env, learner), env.default_params._replace(max_steps=25)
    policy = Learned(env, learner, tables).policy()
    tables = jax.tree.map(jnp.asarray, tables)
    said = greedy_return(learner, env, learner.prepare(env), tables, params, jnp.uint32(0), 0)
    assert expected_return(env, policy, params) == pytest.approx(float(said), abs=1e-3)


def test_it_says_what_it_is():
    learned = Learned(MAZE, hrljax.QLearning(), np.zeros(126, np.float32), episodes=3, steps=40)
    assert repr(learned) == "Learned(Q-learning on Maze, 3 episodes, 40 steps)"


def test_a_flat_policy_takes_the_best_action():
    env, learner = LEARNERS["QLearning"]
    tables = some_tables(env, learner)
    policy = Learned(env, learner, tables).policy()
    best = tables.reshape(env.num_states, -1).argmax(1)
    assert [policy(s) for s in range(env.num_states)] == best.tolist()
    for state in (-1, env.num_states):
        with pytest.raises(ValueError, match=rf"state must be a number in \[0, {env.num_states}\), got {state}"):
            policy(state)


def test_a_stack_runs_until_its_subtasks_end():
    """By hand: a root over two subtasks, the second of which ends in state 2."""
    policy = Policy(
        slots=np.array([[1, 0, 0, 0], [0, 1, 0, 1], [1, 1, 0, 0]]),
        actions=np.array([[-1, -1], [0, 1], [2, 3]]),
        tasks=np.array([[1, 2], [-1, -1], [-1, -1]]),
        active=np.array([[True] * 4, [True] * 4, [True, True, False, True]]),
    )
    trace = []
    for state in (0, 1, 3, 2, 0):
        action = policy(state)
        trace.append((action, policy.stack))
    assert trace == [(3, (0, 2)), (3, (0, 2)), (2, (0, 2)), (0, (0, 1)), (0, (0, 1))]
    policy.reset()
    assert (policy(0), policy.stack) == (3, (0, 2))


def test_a_root_that_chooses_at_random_draws_from_its_seed():
    env, learner = LEARNERS["HORDQ random"]
    learned = Learned(env, learner, some_tables(env, learner))
    state = (
        int(np.flatnonzero((learned.policy().choice > 0).sum(1) > 1)[0]) if learned.policy().choice is not None else 0
    )

    def draws(seed: int) -> list[tuple[int, ...]]:
        policy, found = learned.policy(seed), []
        for _ in range(30):
            policy.reset()
            policy(state)
            found.append(policy.stack)
        return found

    assert draws(1) == draws(1)
    assert len(set(draws(1))) > 1


@pytest.mark.parametrize("name", LEARNERS)
def test_what_is_saved_comes_back(tmp_path: Path, name: str):
    env, learner = LEARNERS[name]
    learned = Learned(env, learner, some_tables(env, learner))
    learned.save(tmp_path / "new" / "x.npz")
    found = Learned.load(tmp_path / "new" / "x.npz")
    assert (found.env, found.learner) == (env, learner)
    assert jax.tree.structure(found.tables) == jax.tree.structure(learned.tables)
    for one, other in zip(jax.tree.leaves(found.tables), jax.tree.leaves(learned.tables), strict=True):
        np.testing.assert_array_equal(one, other)
    learned.save(tmp_path / "y.npz")
    assert (tmp_path / "y.npz").read_bytes() == (tmp_path / "new" / "x.npz").read_bytes()
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["x.npz"]


def turned(options: hrljax.Options) -> hrljax.Options:
    """The same but for one action in one state."""
    policy = options.policy.copy()
    policy[0, 0] = (policy[0, 0] + 1) % len(options.actions)
    return dataclasses.replace(options, policy=policy)


def saved(path: Path, learner: Any = None, env: Any = MAZE) -> Path:
    learner = learner or hrljax.QLearning()
    Learned(env, learner, some_tables(env, learner)).save(path)
    return path


def rewritten(path: Path, **header: Any) -> None:
    with np.load(path) as file:
        arrays = dict(file)
    content = json.loads(arrays.pop("header").tobytes()) | header
    np.savez(path, header=np.frombuffer(json.dumps(content).encode(), np.uint8), **arrays)


def test_what_is_not_known_is_refused(tmp_path: Path):
    path = saved(tmp_path / "x.npz")
    for header, message in (
        ({"version": 2}, "'hrljax learned' of version 2; known is 'hrljax learned' of version 1"),
        ({"environment": "Chess", "version": 1}, "learned on 'Chess', which is not registered; give it as env"),
        ({"environment": "Maze", "learner": "Genius"}, "by 'Genius', which is not known"),
        ({"learner": "QLearning", "tables": ["learned", "more"]}, r"is damaged: it has the tables \['learned'\]"),
    ):
        rewritten(path, **header)
        with pytest.raises(ValueError, match=message):
            Learned.load(path)


@pytest.mark.parametrize("damage", ["truncated", "empty", "text", "array"])
def test_a_damaged_file_is_refused(tmp_path: Path, damage: str):
    path = saved(tmp_path / "x.npz")
    if damage == "array":
        np.savez(path, learned=np.zeros(3))
    else:
        path.write_bytes({"truncated": path.read_bytes()[:-30], "empty": b"", "text": b"mine"}[damage])
    with pytest.raises(ValueError, match=r"x\.npz is damaged or was not written by hrljax"):
        Learned.load(path)
    with pytest.raises(FileNotFoundError):
        Learned.load(tmp_path / "nowhere.npz")


def test_what_a_file_cannot_hold_has_to_be_given(tmp_path: Path):
    schedule = hrljax.SARSA(epsilon=optax.linear_schedule(0.5, 0.1, 5))
    path = saved(tmp_path / "schedule.npz", schedule)
    with pytest.raises(ValueError, match="with epsilon as a schedule, which files do not hold; give the learner"):
        Learned.load(path)
    assert Learned.load(path, learner=schedule).learner is schedule
    learner = with_options()
    path = saved(tmp_path / "options.npz", learner)
    with pytest.raises(ValueError, match="with options, which files do not hold; give the learner"):
        Learned.load(path)
    assert Learned.load(path, learner=with_options()).learner == learner
    other = dataclasses.replace(learner, options=turned(learner.options))
    with pytest.raises(ValueError, match=r"other settings: learner\.options is .* there and .* here"):
        Learned.load(path, learner=other)
    standard = MAZE.hierarchy()
    one = hrljax.MAXQ(hrljax.Hierarchy(standard.actions, standard.subtasks[:1] + standard.subtasks[:0:-1]))
    path = saved(tmp_path / "hierarchy.npz", one)
    with pytest.raises(ValueError, match="with another hierarchy than Maze's own; give the learner"):
        Learned.load(path)
    assert Learned.load(path, learner=one).learner is one
    with pytest.raises(ValueError, match=r"other settings: learner\.hierarchy is .* there and .* here"):
        Learned.load(path, learner=hrljax.MAXQ(standard))
    with pytest.raises(ValueError, match="environment is 'Maze' there and 'Taxi' here"):
        Learned.load(saved(tmp_path / "x.npz"), env=TAXI)
    with pytest.raises(ValueError, match=r"learner\.discount is 1\.0 there and 0\.5 here"):
        Learned.load(tmp_path / "x.npz", learner=hrljax.QLearning(discount=0.5))


def test_an_environment_of_the_users_own_can_be_given(tmp_path: Path):
    class Other(Maze):
        name = "Other"

    path = saved(tmp_path / "x.npz", env=Other())
    with pytest.raises(ValueError, match="'Other', which is not registered; give it as env"):
        Learned.load(path)
    assert Learned.load(path, env=Other()).env.name == "Other"


SWEEP: dict[str, Any] = {"seeds": 3, "num_episodes": 4, "mapping": "vmap", "progress": False}


def test_one_run_out_of_many(tmp_path: Path):
    learner = hrljax.QLearning()
    axes = {"step_size": [0.125, 0.5], "env.slip_probability": [0.0, 0.25]}
    swept = hrljax.sweep(MAZE, learner, **SWEEP, axes=axes, keep_learned=True, store=tmp_path / "x.zarr")
    at = {"step_size": 0.5, "env.slip_probability": 0.25}
    params = MAZE.default_params._replace(slip_probability=0.25)
    key, own = jax.random.fold_in(jax.random.key(0), 2), hrljax.QLearning(step_size=0.5)
    run = jax.jit(lambda: hrljax.train(MAZE, own, key, 4, params=params))()
    for dataset in (swept, hrljax.load(tmp_path / "x.zarr")):
        found = Learned.of(dataset, MAZE, learner, seed=2, at=at)
        np.testing.assert_array_equal(found.tables, run.learned)
        assert found.learner == own
    np.testing.assert_array_equal(Learned(MAZE, own, run.learned).tables, run.learned)
    assert "learned" not in hrljax.sweep(MAZE, learner, **SWEEP)
    xr.testing.assert_equal(swept["steps"], hrljax.sweep(MAZE, learner, **SWEEP, axes=axes)["steps"])


def test_what_is_not_on_the_grid_is_refused_with_what_is():
    learner = hrljax.QLearning()
    swept = hrljax.sweep(MAZE, learner, **SWEEP, keep_learned=True, axes={"step_size": [0.1, 0.5]})
    good: dict[str, Any] = {"dataset": swept, "env": MAZE, "learner": learner, "seed": 1, "at": {"step_size": 0.5}}
    assert Learned.of(**{**good, "seed": np.int64(1), "at": {"step_size": np.float64(0.5)}}).learner.step_size == 0.5
    for wrong, error, message in (
        ({"seed": 99}, KeyError, "seed must be one of 0, 1(, 2)*, got 99"),
        ({"seed": -1}, KeyError, "seed must be one of 0, 1(, 2)*, got -1"),
        ({"seed": True}, TypeError, "seed must be an integer from .*got True"),
        ({"at": {"step_size": 0.3}}, KeyError, "at: step_size must be one of 0.1, 0.5, got 0.3"),
        ({"at": {"step_size": "0.1"}}, TypeError, "at: step_size must be a number, got '0.1'"),
        ({"at": [0.1]}, TypeError, r"at must be a mapping such as .*got \[0.1\]"),
        ({"dataset": swept["return"]}, TypeError, "dataset must be a dataset of hrljax.sweep.*got <xarray.DataArray"),
        ({"dataset": swept[["return"]]}, ValueError, "dataset must have the variable 'steps', .*it has return"),
        ({"env": "Maze"}, TypeError, "env must be the environment of the sweep, got 'Maze'"),
        ({"learner": None}, TypeError, "learner must be the learner of the sweep, got None"),
    ):
        with pytest.raises(error, match=message):
            Learned.of(**{**good, **wrong})
    many = xr.Dataset({"steps": ("seed", np.ones(500))}, {"seed": np.arange(500)}, swept.attrs)
    with pytest.raises(KeyError, match=r"seed must be one of 0, 1, .*, 11 and 488 more, up to 499, got 500"):
        Learned.of(many, MAZE, learner, seed=500)


def test_a_policy_is_asked_with_numbers_of_states():
    policy = Learned(MAZE, hrljax.QLearning(), some_tables(MAZE, hrljax.QLearning())).policy()
    assert policy(np.int64(3)) == policy(3)
    for wrong in (None, 1.5, MAZE.decode(jnp.int32(3))):
        with pytest.raises(TypeError, match="state must be the number of a state, an integer, got "):
            policy(wrong)


def test_paths_are_paths():
    learned = Learned(MAZE, hrljax.QLearning(), some_tables(MAZE, hrljax.QLearning()))
    for call in (lambda: learned.save(5), lambda: Learned.load(None)):  # type: ignore[arg-type]
        with pytest.raises(TypeError, match=r"path must be a path: a string or a pathlib.Path, got (5|None)"):
            call()


def test_tables_of_something_else_are_refused():
    learner = hrljax.QLearning()
    with pytest.raises(ValueError, match=r"one run of Q-learning on Maze, .*\[126\], got .*\[2, 126\]"):
        Learned(MAZE, learner, np.zeros((2, 126), np.float32))
    swept = hrljax.sweep(MAZE, learner, **SWEEP, keep_learned=True)
    for options, message in (
        ({"at": {"epsilon": 0.1}}, r"at must give a value for each of \[\], got"),
        ({"learner": hrljax.SARSA()}, "learner is 'Q-learning' there and"),
        ({"dataset": swept.drop_vars("learned")}, "sweep with keep_learned=True"),
        ({"dataset": swept.where(swept["seed"] < 1)}, "the run of seed 1 at {} is not finished"),
    ):
        arguments: dict[str, Any] = {"dataset": swept, "env": MAZE, "learner": learner, "seed": 1, **options}
        with pytest.raises(ValueError, match=message):
            Learned.of(**arguments)
