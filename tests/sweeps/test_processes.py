"""Chunks computed elsewhere: in threads, processes and Dask workers, the numbers have the same bits."""

import os
import pickle
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import optax
import pytest
import xarray as xr

import hrljax
from hrljax.sweeps import processes
from hrljax.sweeps.job import Job

MAZE = hrljax.make("Maze")


def own_hierarchy() -> hrljax.Hierarchy:
    """Not the environment's: its predicates are closures that no module can give again."""
    left = jnp.asarray(MAZE.hierarchy()["Exit"].termination(MAZE.decode(jnp.arange(MAZE.num_states, dtype=jnp.int32))))
    parts = [
        hrljax.Subtask("Root", ("Leave", "Go"), lambda state: jnp.bool_(False)),
        hrljax.Subtask("Leave", MAZE.action_names, lambda state: left[state.cell]),
        hrljax.Subtask("Go", MAZE.action_names, lambda state: ~left[state.cell]),
    ]
    return hrljax.Hierarchy(MAZE.action_names, parts)


LEARNER = hrljax.MAXQ(own_hierarchy(), epsilon=optax.linear_schedule(0.5, 0.1, 5), initial_value=-20.0)
SETTINGS: dict[str, Any] = {
    "seeds": 5,
    "num_episodes": 6,
    "axes": {"pseudo_reward": [0.0, 5.0]},
    "chunk_size": 2,
    "mapping": "native",
    "progress": False,
}


def swept(learner: Any = LEARNER, **options: Any) -> xr.Dataset:
    return hrljax.sweep(MAZE, learner, **{**SETTINGS, **options})


@pytest.fixture(scope="module")
def expected() -> xr.Dataset:
    return swept()


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessPoolExecutor]:
    with processes.processes(2) as pool:
        yield pool


def where_am_i() -> tuple[int, int]:
    """Process and usable cores."""
    return os.getpid(), len(os.sched_getaffinity(0))


@pytest.mark.slow
def test_processes_give_the_same_numbers_and_store(pool: ProcessPoolExecutor, expected: xr.Dataset, tmp_path: Path):
    found = swept(executor=pool, store=tmp_path / "x.zarr")
    xr.testing.assert_equal(found, expected)
    xr.testing.assert_equal(hrljax.load(tmp_path / "x.zarr"), expected)
    assert "compile_seconds" not in found.attrs


@pytest.mark.slow
def test_every_process_has_one_core(pool: ProcessPoolExecutor):
    places = {pool.submit(where_am_i).result() for _ in range(8)}
    assert {cores for _, cores in places} == {1}
    assert os.getpid() not in {process for process, _ in places}


def test_any_executor_will_do(expected: xr.Dataset):
    class Eager(Executor):
        """Computes at once, in this thread."""

        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
            future: Future[Any] = Future()
            future.set_result(fn(*pickle.loads(pickle.dumps(args)), **kwargs))
            return future

    xr.testing.assert_equal(swept(executor=Eager()), expected)
    with ThreadPoolExecutor(2) as threads:
        xr.testing.assert_equal(swept(executor=threads, cores=1), expected)
    with pytest.raises(TypeError, match=r"executor must be a concurrent\.futures\.Executor, got 'processes'"):
        swept(executor="processes")


def test_a_job_is_made_and_compiled_once_in_a_process(monkeypatch: pytest.MonkeyPatch):
    job = Job(MAZE, hrljax.QLearning(epsilon=LEARNER.epsilon), MAZE.default_params, 3, 1, None, False, "vmap")
    sent = job.sent()
    rows = {"key": np.zeros((1, 2), np.uint32), "axes": {}}
    first = pickle.loads(pickle.dumps(sent))(rows, 2)
    monkeypatch.setattr("hrljax.engine.batch.compile_mapped", lambda *_: pytest.fail("compiled again"))
    second = pickle.loads(pickle.dumps(sent))(rows, 2)
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])


@pytest.mark.slow
def test_a_worker_that_dies_loses_nothing_but_its_chunk(
    pool: ProcessPoolExecutor, expected: xr.Dataset, tmp_path: Path
):
    path = tmp_path / "x.zarr"
    with processes.processes(1) as dying, pytest.raises(BrokenProcessPool):
        swept(executor=Dying(dying, 4), cores=1, store=path)
    assert hrljax.load(path)["steps"].notnull().sum() == 5  # two chunks of two, one of one
    xr.testing.assert_equal(swept(executor=pool, store=path), expected)


class Dying(Executor):
    """Sends, in place of one chunk, a function that kills the process that runs it."""

    def __init__(self, pool: ProcessPoolExecutor, victim: int):
        self.pool, self.countdown = pool, victim

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.countdown -= 1
        return self.pool.submit(*((die,) if self.countdown == 0 else (fn, *args)), **kwargs)


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_dask_workers_give_the_same_numbers_though_one_is_killed(expected: xr.Dataset):
    distributed = pytest.importorskip("distributed", reason="the extra 'distributed' is not installed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        processes = list(client.run(os.getpid).values())
        assert len(set(processes)) == 2

        class Watched(Executor):
            """Kills a worker when the fourth chunk is submitted."""

            submitted = 0

            def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
                Watched.submitted += 1
                if Watched.submitted == 4:
                    os.kill(processes[0], signal.SIGKILL)
                return executor.submit(fn, *args, **kwargs)

        executor = client.get_executor()
        xr.testing.assert_equal(swept(executor=Watched(), cores=3), expected)
        assert Watched.submitted == 6
