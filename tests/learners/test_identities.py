"""What must hold between learners, whatever they have learned: identities of the thesis and of its sources."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from jax import Array, lax

import hrljax
from hrljax.envs.bus.env import Bus, BusParams
from hrljax.experiments.backup import PseudoRewardInBackup
from hrljax.learners import updates
from hrljax.learners.hordq import Q, hordq_target
from tests.contexts import learning

KEY = jax.random.key(5)
EPISODES = 100
HIERARCHY = Bus().hierarchy()
REWARD, COMPLETION, EXIT, PSEUDO = range(4)


def runner(learner: Any, params: BusParams | None = None) -> Any:
    """A compiled run as a function of hyper-parameters by name."""

    def run(values: dict[str, Array]) -> hrljax.Run:
        return hrljax.train(Bus(), learner.replaced(values), KEY, EPISODES, params=params, bin_size=10)

    compiled = jax.jit(run)
    return lambda **values: compiled({name: jnp.float32(value) for name, value in values.items()})


@pytest.fixture(scope="module")
def hordq() -> Any:
    """A run of HORDQ by its pseudo-reward."""
    learner = hrljax.HORDQ(HIERARCHY, hrljax.RandomRoot(), initial_value=-25.0)
    run = runner(learner)
    actual: dict[float, hrljax.Run] = {}

    def by_pseudo_reward(pseudo_reward: float) -> hrljax.Run:
        if pseudo_reward not in actual:
            actual[pseudo_reward] = run(pseudo_reward=pseudo_reward)
        return actual[pseudo_reward]

    return by_pseudo_reward


def parts(run: hrljax.Run) -> np.ndarray:
    """``[tasks, S, A, 4]``"""
    return np.asarray(run.learned.q).reshape(6, 2304, 4, 4)


def assert_equal(one: Any, other: Any) -> None:
    jax.tree.map(np.testing.assert_array_equal, one, other)


def test_without_a_pseudo_reward_its_table_does_nothing(hordq):
    with_table = hordq(0.0)
    assert not parts(with_table)[..., PSEUDO].any()
    without = runner(PseudoRewardInBackup(HIERARCHY, hrljax.RandomRoot(), initial_value=-25.0))(pseudo_reward=0.0)
    assert_equal(with_table, without)
    assert parts(with_table)[..., COMPLETION].any()


@pytest.mark.parametrize("pseudo_reward", [5.0, 60.0, -7.0])
def test_the_pseudo_reward_stays_in_its_own_table(hordq, pseudo_reward: float):
    """Real parts are mixtures of sums of real rewards, none of which is positive."""
    reward, completion, after_exit, pseudo = np.moveaxis(parts(hordq(pseudo_reward)), -1, 0)
    assert reward.min() >= -51
    for real in (reward, completion, after_exit):
        assert real.max() <= 0
    assert np.any(pseudo != 0)
    assert np.all(pseudo * np.sign(pseudo_reward) >= 0)
    assert np.abs(pseudo).max() <= abs(pseudo_reward)


class Experience(NamedTuple):
    """Steps of a random behaviour in a random process, `[steps]` each."""

    task: Array
    state: Array
    action: Array
    reward: Array
    after: Array
    exited: Array
    next_task: Array
    child: Array  # any action at `after`
    goal: Array  # whether the exit is one to the subtask's goal
    step_size: Array


STATES, ACTIONS, TASKS = 8, 3, 2


def experience(steps: int, tasks: int = TASKS, dtype: Any = np.float32) -> Experience:
    generator = np.random.default_rng(3)
    transition = generator.dirichlet(np.full(STATES, 0.3), (STATES, ACTIONS))
    rewards = generator.normal(size=(STATES, ACTIONS))
    active = generator.permuted(np.tile(np.arange(STATES) < STATES // 2, (tasks, 1)), axis=1)
    goal = generator.random((tasks, STATES)) < 0.5
    action, child = generator.integers(ACTIONS, size=(2, steps))
    uniform = generator.random(steps)
    state, task = np.zeros(steps + 1, np.int64), np.zeros(steps + 1, np.int64)
    for i in range(steps):
        state[i + 1] = min(np.searchsorted(transition[state[i], action[i]].cumsum(), uniform[i]), STATES - 1)
        task[i + 1] = task[i] if active[task[i], state[i + 1]] else generator.integers(tasks)
    exited = ~active[task[:-1], state[1:]]
    numbers = [task[:-1], state[:-1], action, rewards[state[:-1], action], state[1:], exited, task[1:], child]
    numbers += [goal[task[:-1], state[1:]], generator.uniform(0.02, 1, steps)]
    kinds = [np.int32] * 3 + [dtype, np.int32, np.bool_, np.int32, np.int32, np.bool_, dtype]
    return Experience(*(jnp.asarray(x.astype(kind)) for x, kind in zip(numbers, kinds, strict=True)))


def updated(tables: Array, step: Experience, child: Array, discount: Array, pseudo_reward: Array) -> Array:
    """One update of HORDQ on ``[tasks, S, A, 4]`` by the library's rules."""
    zero = jnp.uint32(0)
    follows = Q(*tables[step.next_task, step.after, child])
    pseudo = jnp.where(step.goal, pseudo_reward, jnp.zeros_like(pseudo_reward))
    target = hordq_target(step.reward, learning().discounted(discount), step.exited, pseudo, follows)
    old = tables[step.task, step.state, step.action]
    new = updates.increment(old, jnp.stack(target), step.step_size, jnp.bool_(True), zero)
    return tables.at[step.task, step.state, step.action].set(new)


def test_the_targets_of_the_real_parts_do_not_know_the_pseudo_reward():
    """The same experience and bootstraps under two pseudo-rewards: three tables keep all their bits."""
    steps = experience(5000)

    @jax.jit
    def learned(pseudo_reward: Array) -> Array:
        def step(tables: Array, now: Experience) -> tuple[Array, None]:
            return updated(tables, now, now.child, jnp.float32(0.9), pseudo_reward), None

        return lax.scan(step, jnp.zeros((TASKS, STATES, ACTIONS, 4)), steps)[0]

    one, other = np.asarray(learned(jnp.float32(0))), np.asarray(learned(jnp.float32(60)))
    np.testing.assert_array_equal(one[..., :PSEUDO], other[..., :PSEUDO])
    assert not one[..., PSEUDO].any()
    assert other[..., PSEUDO].min() > 0


def test_hordq_over_one_leaf_with_exits_to_itself_is_q_learning():
    """In float64, on the same 20,000 transitions, at every step."""
    with jax.enable_x64(True):
        steps = experience(20_000, tasks=1, dtype=np.float64)
        discount, zero = jnp.float64(0.95), jnp.uint32(0)
        assert 0.2 < steps.exited.mean() < 0.8

        @jax.jit
        def differences() -> tuple[Array, Array]:
            def step(carry: tuple[Array, Array], now: Experience) -> tuple[tuple[Array, Array], Array]:
                tables, q = carry
                best = jnp.argmax(tables[0, now.after, :, :PSEUDO].sum(-1))
                tables = updated(tables, now, best, discount, jnp.float64(5))
                target = updates.td_target(now.reward, learning().discounted(discount), q[now.after].max())
                at = now.state, now.action
                q = q.at[at].set(updates.increment(q[at], target, now.step_size, jnp.bool_(True), zero))
                return (tables, q), jnp.abs(tables[0, ..., :PSEUDO].sum(-1) - q).max()

            start = jnp.zeros((1, STATES, ACTIONS, 4), jnp.float64).at[..., EXIT].set(3.0)
            (tables, _), actual = lax.scan(step, (start, jnp.full((STATES, ACTIONS), 3.0)), steps)
            return tables, actual

        tables, actual = differences()
        assert actual.shape == (20_000,)
        assert actual.max() < 1e-12
        assert np.all(np.ptp(np.asarray(tables[0]), axis=(0, 1)) > 0.1)  # each part carries something


def test_maxq_splits_the_second_completion_of_dietterich():
    """C and C~ of MAXQ-Q (2000, Table 4) are Q_c and Q_c + Q_p, with the bootstrap greedy in C~ + V."""
    with jax.enable_x64(True):
        steps = experience(20_000, dtype=np.float64)
        discount, pseudo_reward = jnp.float64(0.95), jnp.float64(5)

        @jax.jit
        def differences() -> tuple[Array, Array]:
            def step(carry: tuple[Array, Array, Array, Array], now: Experience) -> tuple[Any, Array]:
                tables, value, inside, outside = carry  # V of primitives, C~ (read inside the subtask), C (outside)
                values = tables[now.next_task, now.after]
                child = jnp.argmax(values[:, REWARD] + values[:, COMPLETION] + values[:, PSEUDO])
                tables = updated(tables, now, child, discount, pseudo_reward)

                # The same by hand; at an exit nothing is left to complete but the pseudo-reward.
                goes_on, at = (now.task, now.after), (now.task, now.state, now.action)
                best = jnp.argmax(inside[goes_on] + value[goes_on])
                further = discount * (value[goes_on][best] + jnp.stack([inside[goes_on][best], outside[goes_on][best]]))
                paid = jnp.where(now.goal, jnp.stack([pseudo_reward, jnp.float64(0)]), jnp.zeros(2))
                to_inside, to_outside = jnp.where(now.exited, paid, further)
                inside = inside.at[at].add(now.step_size * (to_inside - inside[at]))
                outside = outside.at[at].add(now.step_size * (to_outside - outside[at]))
                value = value.at[at].add(now.step_size * (now.reward - value[at]))
                gap = tables[..., COMPLETION] + tables[..., PSEUDO] - inside
                return (tables, value, inside, outside), jnp.stack([gap, tables[..., COMPLETION] - outside])

            empty = jnp.zeros((TASKS, STATES, ACTIONS), jnp.float64)
            start = (jnp.zeros((*empty.shape, 4), jnp.float64), empty, empty, empty)
            (_, _, inside, outside), gaps = lax.scan(step, start, steps)
            return jnp.abs(gaps).max(), jnp.abs(inside - outside).max()

        gap, effect = differences()
        assert gap < 1e-12
        assert effect > 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["step_size", "epsilon"])
def test_a_constant_schedule_is_its_number(name: str):
    number, schedule = (hrljax.QLearning(**{name: value}) for value in (0.25, optax.constant_schedule(0.25)))
    assert_equal(runner(number)(), runner(schedule)())


def test_a_constant_schedule_of_the_pseudo_reward_is_its_number(hordq):
    learner = hrljax.HORDQ(
        HIERARCHY, hrljax.RandomRoot(), initial_value=-25.0, pseudo_reward=optax.constant_schedule(5.0)
    )
    assert_equal(hordq(5.0), runner(learner)())


def test_the_pseudo_value_of_the_last_step_into_the_goal_is_the_whole_pseudo_reward(bus: Bus):
    learner = hrljax.HORDQ(HIERARCHY, hrljax.RandomRoot(), pseudo_reward=5.0, step_size=0.5, epsilon=0.3)
    learned = parts(runner(learner, BusParams(slip_probability=0.0))())
    area, reached = bus.layout.area, bus.layout.area[bus.layout.neighbour]
    into_goal = (reached == np.arange(6)[:, None, None]) & (reached != area[:, None])
    undamaged = np.arange(2304) >> 5 & 1 == 0
    steps = learned[into_goal[:, np.arange(2304) >> 6] & undamaged[:, None] & (learned[..., REWARD] < 0)]
    assert len(steps) > 50
    np.testing.assert_allclose(steps[:, PSEUDO], -5 * steps[:, REWARD], rtol=1e-6)  # two targets, met equally often
    often = steps[:, REWARD] == -1  # in float32 after 25 halvings
    assert often.any()
    np.testing.assert_array_equal(steps[often][:, PSEUDO], np.float32(5))
    np.testing.assert_array_equal(steps[:, COMPLETION], 0)
