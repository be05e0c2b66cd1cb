"""The best setting: found by hand, and an interval that holds as often as it says although it was chosen."""

import numpy as np
import pytest
import xarray as xr

import hrljax as hrl
from hrljax.stats import best, mean_interval


def runs(values: np.ndarray, **axes: list[float]) -> xr.DataArray:
    return xr.DataArray(values, dims=[*axes, "seed"], coords=axes, name="return", attrs={"units": "steps"})


def test_the_best_setting_is_the_one_with_the_greatest_mean():
    values = np.random.default_rng(0).normal(size=(3, 2, 9))
    values[1, 1] += 5
    values[2, 0] -= 5
    array = runs(values, step_size=[0.1, 0.2, 0.5], pseudo_reward=[0.0, 5.0])
    winner, loser = best(array), best(array, least=True)
    assert (float(winner["step_size"]), float(winner["pseudo_reward"])) == (0.2, 5.0)
    assert (float(loser["step_size"]), float(loser["pseudo_reward"])) == (0.5, 0.0)
    assert float(winner["mean"]) == pytest.approx(values[1, 1].mean())
    assert float(winner["low"]) < float(winner["mean"]) < float(winner["high"])
    assert winner.attrs == {"units": "steps"}
    xr.testing.assert_identical(winner, best(array.transpose("seed", "pseudo_reward", "step_size")))


@pytest.mark.parametrize("size", [4, 30])
def test_of_one_setting_it_is_the_interval_of_student(size: int):
    values = np.random.default_rng(1).normal(3, 2, (1, size))
    array = runs(values, step_size=[0.1])
    of_student, of_best = mean_interval(array.isel(step_size=0)), best(array, resamples=40_000)
    width = float(of_best["high"] - of_best["low"]) / float(of_student["high"] - of_student["low"])
    assert width == pytest.approx(1, abs=0.12 if size == 4 else 0.03)


def test_what_settings_share_makes_the_interval_no_wider():
    shared = np.random.default_rng(2).normal(size=12)
    alone = best(runs(shared[None], step_size=[0.1]))
    alike = best(runs(np.array([shared, shared + 1, shared - 3]), step_size=[0.1, 0.2, 0.3]))
    assert float(alike["high"] - alike["low"]) == pytest.approx(float(alone["high"] - alone["low"]))
    assert float(alike["step_size"]) == 0.2


def test_the_interval_of_a_winner_among_equals_holds_and_one_that_ignores_the_choice_does_not():
    rng = np.random.default_rng(3)
    holds, ignored = [], []
    for _ in range(300):
        array = runs(rng.normal(size=(20, 15)), step_size=list(range(20)))
        winner = best(array, resamples=300)
        by_itself = mean_interval(array.sel(step_size=winner["step_size"]))
        holds.append(float(winner["low"]) <= 0 <= float(winner["high"]))
        ignored.append(float(by_itself["low"]) <= 0 <= float(by_itself["high"]))
    assert np.mean(holds) > 0.92
    assert np.mean(ignored) < 0.7


def test_runs_that_some_setting_has_not_finished_do_not_count():
    values = np.random.default_rng(4).normal(size=(2, 8))
    whole = best(runs(values[:, :6], step_size=[0.1, 0.2]))
    values[0, 6], values[1, 7] = np.nan, np.nan
    xr.testing.assert_allclose(best(runs(values, step_size=[0.1, 0.2])), whole)


def test_one_run_has_no_interval_and_equal_runs_one_without_width():
    lonely = best(runs(np.array([[1.0], [2.0]]), step_size=[0.1, 0.2]))
    assert float(lonely["mean"]) == 2
    assert np.isnan(lonely["low"])
    equal = best(runs(np.ones((2, 5)), step_size=[0.1, 0.2]))
    assert (float(equal["low"]), float(equal["high"])) == (1, 1)


def test_of_a_sweep_the_best_has_the_names_of_its_axes():
    env = hrl.make("Maze")
    curves = hrl.sweep(env, hrl.QLearning(), seeds=3, num_episodes=20, axes={"step_size": [0.001, 0.5]}, progress=False)
    winner = best(hrl.stats.area_under_curve(curves["return"]))
    assert set(winner.coords) == {"step_size"}


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        (np.full((2, 3), np.nan), ValueError, "values must have a seed that is finished in every setting"),
        (np.array([[1.0, np.inf], [1.0, 2.0]]), ValueError, "values must be finite"),
    ],
)
def test_values_without_a_best_are_refused(values, error, message):
    with pytest.raises(error, match=message):
        best(runs(values, step_size=[0.1, 0.2]))


def test_bad_arguments_are_refused():
    array = runs(np.ones((2, 3)), step_size=[0.1, 0.2])
    with pytest.raises(ValueError, match="values must have a dimension 'run'"):
        best(array, "run")
    with pytest.raises(ValueError, match="values must be one number a run, got a dimension 'episode': reduce it"):
        best(array.expand_dims(episode=[10, 20]))
    with pytest.raises(ValueError, match=r"perhaps 0\.95 is meant"):
        best(array, level=95)
    with pytest.raises(ValueError, match="least must be"):
        best(array, least=2)
