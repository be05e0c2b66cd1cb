"""How good advice has to be: rows and gains of a tiny run, and what is computed from them by hand."""

import numpy as np
import pytest
import xarray as xr

from hrljax.experiments import advice_quality
from hrljax.experiments.advice_quality import Runs, break_even, by_learner, gains, picture, rows, table
from hrljax.experiments.rows import Row

NAMES = ["HORDQ(0)", "HORDQ(5)", *(f"shared HORDQ({kappa})" for kappa in ("0", "2", "5", "fading"))]
WORTH = {1.0: -60.0, -0.5: -140.0}


@pytest.fixture(scope="module")
def tiny() -> list[Runs]:
    """Two seeds of 100 episodes under two roots."""
    sweeps = advice_quality.run([1.0, -0.5], seeds=2, scale=0.005, cores=1, key=3)
    return [runs for group, dataset in sweeps for runs in by_learner(group, dataset)]


@pytest.mark.slow
def test_every_learner_has_a_row_under_every_root(tiny: list[Runs]):
    entries = rows(tiny, WORTH)
    assert [(row["learner"], row["quality"]) for row in entries] == [(name, q) for name in NAMES for q in WORTH]
    for row in entries:
        assert row["worth"] == WORTH[row["quality"]]
        assert row["seeds"] == 2
        assert -1000 * 10 < row["mean_return"]["lo"] < row["mean_return"]["mean"] < row["mean_return"]["hi"] < 0
    assert [row["pseudo_reward"] for row in entries[::2]] == [0, 5, 0, 2, 5, "fading"]


def test_a_gain_is_a_difference_of_runs_with_the_same_root_and_seed(tiny: list[Runs]):
    gained = gains(tiny)
    of = {runs.name: runs.mean_return for runs in tiny}
    for name, partner in [("HORDQ(5)", "HORDQ(0)"), ("shared HORDQ(fading)", "shared HORDQ(0)")]:
        np.testing.assert_array_equal(gained[name], of[name] - of[partner])
        assert (gained[name] != 0).all()
    for row in rows(tiny, WORTH):
        if row["pseudo_reward"] == 0:
            assert row["gain"] == {"mean": 0, "lo": 0, "hi": 0}
        else:
            expected = gained[row["learner"]].sel({"root.quality": row["quality"]}).mean()
            assert row["gain"]["mean"] == pytest.approx(float(expected))


def test_shared_values_without_a_pseudo_reward_do_not_listen_to_the_root(tiny: list[Runs]):
    """They are flat Q-learning, on the same words under every root; values by subtask are not."""
    of = {runs.name: runs.mean_return for runs in tiny}
    best, misleading = of["shared HORDQ(0)"].transpose("root.quality", "seed").values
    np.testing.assert_array_equal(best, misleading)
    best, misleading = of["HORDQ(0)"].transpose("root.quality", "seed").values
    assert (best != misleading).all()


def test_its_roots_go_from_good_to_bad():
    worth = advice_quality.worths()
    assert list(worth) == list(advice_quality.QUALITIES)
    assert list(worth.values()) == sorted(worth.values(), reverse=True)
    assert worth[1.0] == pytest.approx(-65.69, abs=0.01)
    assert worth[0.0] == pytest.approx(-90.56, abs=0.01)


def by_hand(unfinished: bool = False) -> list[Row]:
    """Two learners of three seeds; the last seed may be unfinished under the second root."""
    without = np.array([[-50.0, -60, -70], [-50, -60, -70]])
    gained = np.array([[9.0, 10, 11], [-31, -30, -29]])
    if unfinished:
        gained[1] = np.nan
    coordinates = {"root.quality": list(WORTH), "seed": [0, 1, 2]}
    runs = [
        Runs("HORDQ", kappa, xr.DataArray(values, coordinates, ("root.quality", "seed"), name="return"))
        for kappa, values in ((0.0, without), (5.0, without + gained))
    ]
    return rows(runs, WORTH)


def test_rows_by_hand():
    good, bad = by_hand()[2:]
    assert good["mean_return"]["mean"] == pytest.approx(-50)
    reach = 4.302653 / 3**0.5  # Student's with 2 degrees of freedom, deviation 1
    expected = {"mean": 10, "lo": 10 - reach, "hi": 10 + reach}
    assert good["gain"] == {end: pytest.approx(value) for end, value in expected.items()}
    assert bad["gain"]["mean"] == pytest.approx(-30)
    assert break_even(by_hand()) == {"HORDQ(5)": pytest.approx(-80)}
    text = table(by_hand(), WORTH)
    assert "+10.00 ±2.48" in text
    assert text.endswith("-80.0")


def test_what_is_not_finished_is_left_out():
    entries = by_hand(unfinished=True)
    assert entries[-1]["gain"] == {"mean": None, "lo": None, "hi": None}
    assert entries[-1]["seeds"] == 0
    assert break_even(entries) == {"HORDQ(5)": None}
    assert table(entries, WORTH).endswith("pays everywhere")
    (ax,) = picture(entries, WORTH).axes
    assert [container.lines[0].get_xdata().tolist() for container in ax.containers] == [[-60]]


def test_the_picture_has_a_line_for_every_advised_learner_and_tells_every_root(tiny: list[Runs]):
    (ax,) = picture(rows(tiny, WORTH), WORTH).axes
    _, labels = ax.get_legend_handles_labels()
    assert labels == [f"{name} (n=2)" for name in NAMES if not name.endswith("(0)")]
    assert [text.get_text() for text in ax.texts] == ["1", "-0.5"]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["-60.0", "-140.0"]
