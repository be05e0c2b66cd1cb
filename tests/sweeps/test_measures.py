"""Discounted returns and rewards per step as variables, and runs that steps stop."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

import hrljax as hrl
from hrljax.core.counting import count
from tests.maps import SMALL

MEASURES = ("average_reward", "discounted_return")
PARAMS = SMALL.default_params._replace(max_steps=60)
OPTIONS: dict[str, Any] = {"seeds": 3, "num_episodes": 12, "bin_size": 4, "params": PARAMS, "progress": False}
LEARNERS = {
    "flat": hrl.QLearning(initial_value=-25.0, discount=0.9),
    "hierarchy": hrl.HORDQ(SMALL.hierarchy(), root=hrl.ModelRoot(interval=2), initial_value=-25.0, discount=0.9),
}


in_every_loop = pytest.mark.parametrize(
    ("name", "mapping"),
    [
        ("flat", "native"),
        pytest.param("flat", "vmap", marks=pytest.mark.slow),
        pytest.param("hierarchy", "native", marks=pytest.mark.slow),
        pytest.param("hierarchy", "vmap", marks=pytest.mark.slow),
    ],
)


def swept(learner: Any, **options: Any) -> xr.Dataset:
    return hrl.sweep(SMALL, learner, **{**OPTIONS, **options})


@in_every_loop
def test_measures_are_further_variables_and_change_nothing(name: str, mapping: Any):
    plain = swept(LEARNERS[name], mapping=mapping)
    measured = swept(LEARNERS[name], mapping=mapping, measures=MEASURES)
    assert set(measured) - set(plain) == set(MEASURES)
    for variable in plain:
        np.testing.assert_array_equal(measured[variable], plain[variable], err_msg=str(variable))
    rate = plain["return"] / plain["length"]
    np.testing.assert_allclose(measured["average_reward"], rate, rtol=1e-6)
    assert measured.attrs["measures"] == "discounted_return, average_reward"


def test_every_step_is_discounted_by_those_before_it_in_its_episode():
    """Where each step costs 1, an episode of T steps has the discounted return -(1 - g^T) / (1 - g)."""
    discounts = [0.5, 0.96875]
    options = {"seeds": 2, "num_episodes": 6, "bin_size": 1, "axes": {"discount": discounts}, "progress": False}
    curves = hrl.sweep(hrl.make("Maze"), hrl.QLearning(), **options, measures=["discounted_return"])
    np.testing.assert_array_equal(curves["return"], -curves["length"])
    expected = -(1 - curves["discount"] ** curves["length"]) / (1 - curves["discount"])
    xr.testing.assert_allclose(
        curves["discounted_return"], expected.transpose("discount", "seed", "episode"), rtol=1e-5
    )


def test_measures_are_in_stores_which_are_those_of_one_set_of_measures(tmp_path: Any):
    curves = swept(LEARNERS["flat"], measures=MEASURES, store=tmp_path / "store")
    loaded = hrl.load(tmp_path / "store")
    for name in MEASURES:
        np.testing.assert_array_equal(loaded[name], curves[name])
    with pytest.raises(ValueError, match="measures is 'discounted_return, average_reward' there and 'absent' here"):
        swept(LEARNERS["flat"], store=tmp_path / "store")


def steps_at_ends(curves: xr.Dataset) -> xr.DataArray:
    """The steps that each run had taken at the end of each bin, which has 4 episodes."""
    return (curves["length"] * 4).cumsum("episode")


@in_every_loop
def test_a_run_ends_after_the_bin_in_which_it_has_taken_so_many_steps(name: str, mapping: Any):
    whole = swept(LEARNERS[name], mapping=mapping)
    ends = steps_at_ends(whole)
    limit = int(np.median(ends.isel(episode=1)))
    stopped = swept(LEARNERS[name], mapping=mapping, num_steps=limit)
    was_reached = ends.shift(episode=1, fill_value=0) >= limit
    assert 0 < int(was_reached.sum()) < was_reached.size
    for variable in ("return", "length", "truncated"):
        xr.testing.assert_equal(stopped[variable], whole[variable].where(~was_reached))
    np.testing.assert_array_equal(stopped["steps"], ends.where(~was_reached).max("episode"))
    assert (stopped.attrs["num_steps"], stopped.attrs["complete"]) == (limit, 1)


def test_curves_of_runs_that_steps_stopped_are_drawn_against_steps():
    whole = swept(LEARNERS["flat"])
    limit = int(steps_at_ends(whole).isel(episode=1).min())
    stopped = swept(LEARNERS["flat"], num_steps=limit)
    along = hrl.stats.against_steps(stopped, num=5)
    assert not along.isnull().any()
    assert float(along["steps"][-1]) == float(stopped["steps"].min()) >= limit
    worst = float(stopped["return"].min())
    assert np.isfinite(hrl.stats.episodes_to_reach(stopped["return"], worst)).all()
    assert np.isinf(hrl.stats.episodes_to_reach(stopped["return"], 1.0)).all()


def test_what_steps_stopped_knows_its_episodes_and_goes_on_run_by_run():
    limit = int(steps_at_ends(swept(LEARNERS["flat"])).isel(episode=0).min())
    stopped = swept(LEARNERS["flat"], num_steps=limit, keep_learned=True)
    for seed in range(3):
        learned = hrl.Learned.of(stopped, SMALL, LEARNERS["flat"], seed=seed)
        assert learned.episodes == 4 * int(stopped["return"].sel(seed=seed).notnull().sum())
    with pytest.raises(ValueError, match="start was stopped by num_steps"):
        swept(LEARNERS["flat"], start=stopped)
    rest = swept(LEARNERS["flat"], seeds=1, num_steps=learned.steps, start=learned)
    assert rest["return"].isnull().all()  # these steps were taken before
    assert int(rest["steps"][0]) == learned.steps


def test_steps_are_compared_in_64_bits():
    for number in (1, 2**32 - 1, 2**32, 2**32 + 5, 2**40):
        assert [bool(count(number + more).reaches(number)) for more in (-1, 0, 1)] == [False, True, True]
    assert not bool(count(2**32 - 1).reaches(2**33))
    assert bool(count(2**33).reaches(2**32 - 1))


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"measures": "average_reward"}, TypeError, "measures must be"),
        ({"measures": ["regret"]}, ValueError, "measures must be one of 'discounted_return', 'average_reward'"),
        ({"num_steps": 0}, ValueError, "num_steps must be"),
        ({"num_steps": 1.5}, TypeError, "num_steps must be"),
    ],
)
def test_what_makes_no_sense_is_refused(options: dict[str, Any], error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        swept(LEARNERS["flat"], **options)
