"""Processes that compute chunks of a sweep, on this machine."""

import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.sharedctypes import Synchronized

from hrljax.core import checks
from hrljax.engine.batch import usable_cores


def processes(workers: int | None = None) -> ProcessPoolExecutor:
    """A pool of processes, one pinned to each core, for the `executor` of `hrljax.sweep`.

    A process that sees one core gives XLA one thread, so that processes do not compete. Keyboard
    interrupts are left to the process that owns the pool. Threads, which a sweep uses by itself, are
    as fast for native loops and compile only once; processes pay where the main one is busy, or where
    a crash must not take all down. Use it as a context.

    Args:
        workers: number of processes, one a usable core if None; with more, cores are shared.
    """
    workers = usable_cores() if workers is None else checks.integer("workers", workers, 1)
    context = multiprocessing.get_context("spawn")
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    number = context.Value("i", 0)
    return ProcessPoolExecutor(workers, context, initializer=begin_worker, initargs=(cores, number))


def begin_worker(cores: list[int], number: "Synchronized[int]") -> None:
    """Pins a new process to the next of some cores; has to run before JAX starts there.

    Args:
        cores: numbers of the cores; none to leave the process where it is.
        number: shared integer that counts the processes.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with number.get_lock():
        place, number.value = number.value, number.value + 1
    if cores:
        os.sched_setaffinity(0, {cores[place % len(cores)]})
