"""Estimates of sweeps: counts are exact, times follow from what was measured."""

import itertools
from typing import Any

import pytest

import hrljax
from hrljax.sweeps.estimate import Estimate, estimate

MAZE, LEARNER = hrljax.make("Maze"), hrljax.QLearning()
SWEEP: dict[str, Any] = {"seeds": 10, "num_episodes": 1000, "axes": {"step_size": [0.125, 0.25, 0.5]}, "chunk_size": 4}


def ticking(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock on which everything that is measured takes a second."""
    clock = itertools.count()
    monkeypatch.setattr("hrljax.sweeps.estimate.time.perf_counter", lambda: float(next(clock)))


def test_an_estimate_counts_and_extrapolates(monkeypatch: pytest.MonkeyPatch):
    ticking(monkeypatch)
    found = estimate(MAZE, LEARNER, **SWEEP, mapping="native", cores=2)
    assert (found.runs, found.chunks, found.runs_per_chunk, found.at_once) == (30, 8, 4, 2)
    per_run = 8 * (3 * 200 + 1)  # return, length and truncated in 200 bins, and the steps
    assert found.result_bytes == 30 * per_run
    assert found.working_bytes == 2 * MAZE.num_states * MAZE.num_actions * 4
    short = hrljax.sweep(
        MAZE, LEARNER, seeds=1, num_episodes=200, bin_size=50, axes=SWEEP["axes"], mapping="native", progress=False
    )
    steps = short["steps"] + 800 * short["length"].isel(episode=-1)
    assert found.steps == pytest.approx(30 * float(steps.mean()))
    assert found.seconds_per_chunk == pytest.approx(4 * float(steps.sum() / short["steps"].sum()) / 3)
    assert found.compile_seconds == 1
    assert found.seconds == pytest.approx(1 + 4 * found.seconds_per_chunk)


def test_stores_and_workers_have_chunks_within_a_combination(monkeypatch: pytest.MonkeyPatch):
    ticking(monkeypatch)
    for options in ({"workers": 5}, {"store": True, "cores": 5}):
        found = estimate(MAZE, LEARNER, **SWEEP, mapping="native", **options)
        assert (found.chunks, found.at_once) == (9, 5)
        assert found.seconds == pytest.approx(1 + 2 * found.seconds_per_chunk)


@pytest.mark.slow
def test_a_chunk_under_vmap_takes_as_long_as_its_longest_run(monkeypatch: pytest.MonkeyPatch):
    ticking(monkeypatch)
    found = estimate(MAZE, LEARNER, seeds=3, num_episodes=150, mapping="vmap", keep_learned=True)
    assert (found.runs, found.chunks, found.at_once, found.seconds_per_chunk) == (3, 1, 1, 1)
    tables = MAZE.num_states * MAZE.num_actions * 4
    assert found.working_bytes == 3 * tables
    assert found.result_bytes == 3 * (8 * (3 * 150 + 1) + tables)


@pytest.mark.slow
def test_evaluations_are_measured_apart(monkeypatch: pytest.MonkeyPatch):
    seconds = iter([0, 1, 0, 2, 0, 2, 0, 2, 0, 1, 0, 5, 0, 5, 0, 5])
    monkeypatch.setattr("hrljax.sweeps.estimate.time.perf_counter", lambda: float(next(seconds)))
    found = estimate(
        MAZE, LEARNER, seeds=2, num_episodes=40, bin_size=4, evaluate_every=2, mapping="native", chunk_size=2
    )
    assert found.seconds_per_chunk == pytest.approx(2 * (2 + 5 * 3))


def test_an_estimate_can_be_read():
    found = Estimate(400_000, 25_000, 16, 64, 3_210_000_000, 12_345, 3.21e12, 30.0, 4.0, 11_725.0)
    assert repr(found).splitlines() == [
        "runs            400,000",
        "chunks          25,000 of up to 16 runs, 64 at a time",
        "result          3.21 GB",
        "working memory  12.3 kB",
        "steps           about 3.2e+12",
        "time            about 3.3 hours, 30 seconds a chunk",
        "compilation     about 4 seconds of it",
    ]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"workers": 0}, "workers must be an integer from 1 to 2147483647, got 0"),
        ({"seeds": 0}, "seeds must be an integer from 1 to 2147483647, got 0"),
        ({"axes": {"kappa": [1.0]}}, "'kappa' cannot be swept"),
    ],
)
def test_a_wrong_value_is_refused(wrong: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=message):
        estimate(MAZE, LEARNER, **{**SWEEP, **wrong})
