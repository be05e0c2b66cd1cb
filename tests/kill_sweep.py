"""A sweep that ends by SIGKILL at an instant of its own choice; run by `test_store.py` in a process of its own.

Arguments: the store; then for each life of the sweep the number of the system call (as counted by
`CALLS`) in whose place it dies, 0 for none, or with a decimal point the seconds after which it is
killed from outside; ``seeds=7`` among them changes the seeds of the lives that follow. Lives are forks
made before JAX has started, so that the imports are paid once.
"""

import os
import signal
import sys
import time
from typing import Any

import xarray  # noqa: F401
import zarr  # noqa: F401

import hrljax

SETTINGS: dict[str, Any] = {
    "seeds": 5,
    "num_episodes": 12,
    "bin_size": 4,
    "axes": {"step_size": [0.125, 0.5]},
    "chunk_size": 2,
    "mapping": "vmap",
    "progress": False,
}
CALLS = ("fsync", "replace", "mkdir", "unlink")


def sweep(**options: Any) -> Any:
    """A sweep of 6 chunks that compiles in no time."""
    return hrljax.sweep(hrljax.make("Maze"), hrljax.QLearning(), **{**SETTINGS, **options})


def die_at(instant: int) -> None:
    """Counts calls that change the disk, and dies before the given one."""
    count = [0]

    def counted(call: Any) -> Any:
        def instead(*arguments: Any, **options: Any) -> Any:
            count[0] += 1
            if count[0] == instant:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*arguments, **options)

        return instead

    for name in CALLS:
        setattr(os, name, counted(getattr(os, name)))


def live(store: str, seeds: int, instant: int, delay: float) -> str:
    """One life of the sweep in a process of its own: until a call or, asynchronously, for some seconds."""
    child = os.fork()
    if child == 0:
        die_at(instant)
        sweep(store=store, seeds=seeds)
        os._exit(0)
    if delay:
        time.sleep(delay)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return "killed" if os.WIFSIGNALED(status) else "finished" if os.WEXITSTATUS(status) == 0 else "failed"


if __name__ == "__main__":
    seeds = SETTINGS["seeds"]
    for life in sys.argv[2:]:
        if life.startswith("seeds="):
            seeds = int(life.removeprefix("seeds="))
            continue
        instant, delay = (int(life), 0.0) if life.isdigit() else (0, float(life))
        print(live(sys.argv[1], seeds, instant, delay), flush=True)
