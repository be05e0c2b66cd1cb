"""Hierarchies of several levels: mappings of many runs, the case of one level, and bad input."""

from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.hierarchy.definition import Hierarchy, Subtask
from hrljax.sweeps import job

TAXI = hrljax.make("Taxi", stochastic=True)
GRID = hrljax.make("Gridworld", map="S....P\n.S.#..\n..S...\nP....G\n")


def over_actions(name: str, children: tuple[str, ...] = GRID.action_names) -> Subtask:
    return Subtask(name, children, lambda state: jnp.bool_(False))


@pytest.mark.slow
def test_a_seed_has_one_result_under_every_mapping_and_a_second_sweep_traces_nothing(monkeypatch: pytest.MonkeyPatch):
    def swept(mapping: str, **options: Any) -> Any:
        learner = hrljax.HORDQ(TAXI.hierarchy(), pseudo_reward=4.0, discount=0.95, epsilon=0.4)
        settings = {"seeds": 3, "num_episodes": 5, "bin_size": 1, "chunk_size": 2, **options}
        return hrljax.sweep(
            hrljax.make("Taxi", stochastic=True),
            learner,
            params=TAXI.default_params._replace(max_steps=150),
            mapping=mapping,
            progress=False,
            **settings,
        )

    with monkeypatch.context() as patch:
        chex.clear_trace_counter()
        patch.setattr(job, "run_once", chex.assert_max_traces(job.run_once, n=1))
        native, again = swept("native"), swept("native")
    assert native["illegal"].values.max() > 2
    for other in (again, swept("vmap")):
        for variable in native:
            np.testing.assert_array_equal(native[variable].values, other[variable].values, err_msg=str(variable))


def test_hordq_over_one_level_is_q_learning():
    """Equal but for rounding: a sum of four float32 parts is not rounded as one number is.

    Behaviour is random, so that no tie in a last bit can lead the two apart.
    """
    numbers = {"step_size": 0.3, "epsilon": 1.0, "discount": 0.9, "initial_value": -4.0}
    hierarchy = Hierarchy(GRID.action_names, [over_actions("Root")])
    params = GRID.default_params._replace(slip_probability=0.2, max_steps=50)

    def learned(learner: Any) -> hrljax.Run:
        return jax.jit(lambda key: hrljax.train(GRID, learner, key, 100, params=params))(jax.random.key(3))

    flat = learned(hrljax.QLearning(**numbers))
    one_level = learned(hrljax.HORDQ(hierarchy, pseudo_reward=5.0, **numbers))
    assert int(one_level.steps) == int(flat.steps) > 500
    reward, completion, after_exit, pseudo = np.asarray(one_level.learned.q).reshape(-1, 4).T
    np.testing.assert_allclose(reward + completion + after_exit, flat.learned, rtol=1e-5)
    assert not after_exit.any()
    assert not pseudo.any()
    assert np.ptp(np.asarray(flat.learned)) > 10


def test_a_root_with_a_primitive_child_must_learn():
    hierarchy = Hierarchy(GRID.action_names, [over_actions("Top", ("Go", "north")), over_actions("Go")])
    for learner in (hrljax.HORDQ, hrljax.MAXQ, hrljax.HAMQ):
        with pytest.raises(ValueError, match=r"the root 'Top' has a primitive child, so it must learn: root=None"):
            learner(hierarchy, hrljax.RandomRoot())


def test_hamq_has_no_value_that_a_root_could_plan_with():
    with pytest.raises(ValueError, match=r"HAMQ: root must be None or RandomRoot\(\), since ModelRoot\(\) needs"):
        hrljax.HAMQ(TAXI.hierarchy(), hrljax.ModelRoot())


def test_what_is_no_hierarchy_or_root_is_named():
    with pytest.raises(TypeError, match="HORDQ: hierarchy must be a Hierarchy"):
        hrljax.HORDQ("taxi")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="MAXQ: root must be None or a root"):
        hrljax.MAXQ(TAXI.hierarchy(), "random")  # type: ignore[arg-type]
