"""A pseudo-reward that fades: its formula by hand, its scale, its numbers in sweeps, in stores and in files."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.envs.bus.env import BusParams
from tests.contexts import learning
from tests.maps import SMALL

PARAMS = BusParams(max_steps=60)


def test_it_is_worth_so_many_typical_rewards_and_half_of_that_after_some_visits():
    fading, context = hrl.Fading(worth=10.0, after=4.0), learning()
    seen = fading.nothing_seen(3)
    for place, reward in ((0, -1.0), (0, 2.0), (2, 0.0), (0, -5.0), (0, 2.0)):
        seen = fading.after_seeing(seen, jnp.int32(place), jnp.float32(reward), context)
    np.testing.assert_array_equal(seen.visits, [4, 0, 1])
    assert float(seen.mean_reward) == 2
    kappas = [float(fading.at(seen, visits, context)) for visits in seen.visits]
    assert kappas == [10.0, 20.0, 16.0]


def test_a_step_that_does_not_count_changes_nothing():
    fading = hrl.Fading()
    seen = fading.after_seeing(fading.nothing_seen(2), jnp.int32(1), jnp.float32(-3), learning())
    waits = learning()._replace(learns=jnp.bool_(False))
    jax.tree.map(np.testing.assert_array_equal, fading.after_seeing(seen, jnp.int32(0), jnp.float32(9), waits), seen)


def swept(learner: Any, **options: Any) -> Any:
    options = {"seeds": 3, "num_episodes": 30, "bin_size": 1, "params": PARAMS, "progress": False} | options
    return hrl.sweep(SMALL, learner, **options)


LEARNERS = {
    "HORDQ": hrl.HORDQ(SMALL.hierarchy(), hrl.RandomRoot(), pseudo_reward=hrl.Fading(), initial_value=-8.0),
    "MAXQ": hrl.MAXQ(SMALL.hierarchy(), hrl.RandomRoot(), pseudo_reward=hrl.Fading(worth=40.0)),
    "shared": hrl.SharedHORDQ(SMALL.hierarchy(), hrl.ModelRoot(interval=2, sweeps=2), initial_value=-8.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
def test_to_multiply_all_rewards_by_a_number_changes_no_choice(name: str):
    learner = LEARNERS[name]
    eight = learner.replaced({"initial_value": 8 * float(learner.initial_value)})
    if name == "shared":
        eight = eight.replaced({"root.unknown_value": -30.0 * 8})
    one = swept(learner)
    other = swept(eight, params=PARAMS._replace(step_reward=-8.0, breakdown_reward=-51.0 * 8))
    np.testing.assert_array_equal(one["length"], other["length"])
    np.testing.assert_array_equal(8 * one["return"], other["return"])
    assert len(np.unique(one["length"])) > 10


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
def test_both_numbers_can_be_swept_under_every_mapping(name: str):
    axes = {"pseudo_reward.worth": [0.0, 30.0], "pseudo_reward.after": [1.0, 50.0]}
    native, vmap = (swept(LEARNERS[name], axes=axes, mapping=mapping) for mapping in ("native", "vmap"))
    assert native.attrs["mapping"] == "native"
    for variable in native:
        np.testing.assert_array_equal(native[variable].values, vmap[variable].values, err_msg=str(variable))
    returns = native["return"].transpose("pseudo_reward.worth", "pseudo_reward.after", ...)
    np.testing.assert_array_equal(returns[0, 0], returns[0, 1])
    assert (returns[0, 0] != returns[1, 0]).any()
    assert (returns[1, 0] != returns[1, 1]).any()
    fixed = swept(LEARNERS[name].replaced({"pseudo_reward": 0.0}))
    np.testing.assert_array_equal(fixed["return"], returns[0, 0])


@pytest.mark.slow
def test_it_goes_on_where_it_was_and_comes_back_from_disk(tmp_path: Path):
    learner = LEARNERS["shared"]
    whole = swept(learner, num_episodes=40, keep_learned=True)
    half = swept(learner, num_episodes=20, keep_learned=True)
    rest = swept(learner, num_episodes=20, start=half, keep_learned=True)
    np.testing.assert_array_equal(whole["return"][..., 20:], rest["return"])
    learned = hrl.Learned.of(whole, SMALL, learner, seed=1)
    learned.save(tmp_path / "shared.npz")
    again = hrl.Learned.load(tmp_path / "shared.npz", env=SMALL)
    assert again.learner == learner
    jax.tree.map(np.testing.assert_array_equal, again.tables, learned.tables)
    assert learned.tables.seen.steps == learned.steps


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hrl.Fading(worth=-1.0), r"Fading: worth must be a finite number in \[0, "),
        (lambda: hrl.Fading(after=0.0), r"Fading: after must be a finite number in \(0, "),
        (
            lambda: hrl.HORDQ(SMALL.hierarchy(), pseudo_reward="much"),
            r"a schedule or Fading\(\.\.\.\), got",
        ),
        (lambda: hrl.HORDQ(SMALL.hierarchy(), epsilon=hrl.Fading()), r"epsilon must be a number or a schedule, got"),
        (
            lambda: swept(LEARNERS["HORDQ"], axes={"pseudo_reward": [1.0]}),
            r"pseudo_reward",
        ),
    ],
)
def test_wrong_numbers_are_refused(make: Any, message: str):
    with pytest.raises((TypeError, ValueError, KeyError), match=message):
        make()
