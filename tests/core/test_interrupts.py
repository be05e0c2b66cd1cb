"""Ctrl-C while JAX compiles or runs: it reaches the caller, and no native code is left beneath a process that ends."""

import concurrent.futures
import io
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.core import interrupts, progress
from hrljax.engine import batch

PROGRAM = """
import atexit, os, signal, threading
import hrljax, jax
from hrljax.core import interrupts

signal.signal(signal.SIGINT, signal.default_int_handler)  # which a process in the background has not
process_ends = threading.Event()
atexit.register(process_ends.set)
start = interrupts.start

def interrupting(function, *arguments):
    def call():
        os.kill(os.getpid(), signal.SIGINT)
        process_ends.wait(until_end)
        result = function(*arguments)
        print("compiled", flush=True)
        return result
    return start(call)

class Interrupting(hrljax.QLearning):
    def init(self, *arguments):
        os.kill(os.getpid(), signal.SIGINT)
        traced.append(1)
        return super().init(*arguments)

def failing(*_):
    raise MemoryError("no room")

def sweep(learner):
    return hrljax.sweep(hrljax.make("Maze"), learner, seeds=2, num_episodes=3, mapping="vmap", progress=False)

traced, until_end = [], 0
try:
    sweep(Interrupting())
except KeyboardInterrupt:
    print("interrupted while tracing, which has ended", traced)
compile, jax.stages.Lowered.compile = jax.stages.Lowered.compile, failing
try:
    sweep(hrljax.QLearning())
except MemoryError as error:
    print(error)
jax.stages.Lowered.compile, interrupts.start = compile, interrupting
try:
    sweep(hrljax.QLearning())
except KeyboardInterrupt:
    print("interrupted while compiling", flush=True)
interrupts.start = start
print("then complete", sweep(hrljax.QLearning()).attrs["complete"], flush=True)
interrupts.start, until_end = interrupting, None
sweep(hrljax.SARSA())
"""


def test_an_interrupted_compilation_goes_on_and_the_process_ends_after_it():
    """The next sweep takes what was compiled; the last one's compilation begins when the process ends.

    After an error it is tried again.
    """
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    lines = done.stdout.splitlines()
    assert lines[0] == "interrupted while tracing, which has ended [1]"
    assert lines[1] == "no room"
    assert sorted(lines[2:4]) == ["compiled", "interrupted while compiling"]
    assert lines[4:] == ["then complete 1", "compiled"]
    assert done.returncode == -signal.SIGINT, done.stderr
    *_, error, waits = done.stderr.splitlines()
    assert error == "KeyboardInterrupt"
    assert waits.startswith("hrljax: waiting for native code")


def test_a_second_interrupt_does_not_wait_for_what_runs(monkeypatch: pytest.MonkeyPatch):
    goes_on = threading.Event()

    def run(rows: Any) -> Any:
        goes_on.wait()
        return rows

    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(batch, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        batch.run_many(run, jnp.arange(2, dtype=jnp.int32), mapping="native", cores=1, chunk_size=1)
    (call,) = interrupts.running()
    goes_on.set()
    call.join()


def test_an_error_is_raised_after_what_runs_beside_it(monkeypatch: pytest.MonkeyPatch):
    all_are_awaited = threading.Event()
    finished: list[int] = []

    def run(rows: Any) -> Any:
        if rows[0] == 0:
            raise RuntimeError("broken")
        all_are_awaited.wait()
        finished.append(int(rows[0]))
        return rows

    def wait(futures: Any, return_when: str = "ALL_COMPLETED") -> Any:
        if return_when == "ALL_COMPLETED":
            all_are_awaited.set()
        return concurrent.futures.wait(futures, return_when=return_when)

    monkeypatch.setattr(batch, "wait", wait)
    with pytest.raises(RuntimeError, match="broken"):
        batch.run_many(run, jnp.arange(2, dtype=jnp.int32), mapping="native", cores=2, chunk_size=1)
    finished_by_then = list(finished)
    all_are_awaited.set()
    assert finished_by_then == [1]


def test_interrupts_are_postponed_to_the_end_of_a_block_the_second_is_not(python_takes_interrupts: None):
    done = []
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012
        with interrupts.postponed():
            signal.raise_signal(signal.SIGINT)
            done.append("work")
        done.append("what follows")
    assert done == ["work"]
    with pytest.raises(KeyboardInterrupt), interrupts.postponed():  # noqa: PT012
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        done.append("more work")
    assert done == ["work"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.fixture
def python_takes_interrupts() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_handlers_of_the_user_are_called_at_once():
    calls: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: calls.append(number))
    try:
        handler_before = signal.getsignal(signal.SIGTERM)
        with interrupts.postponed():
            signal.raise_signal(signal.SIGTERM)
            assert calls == [signal.SIGTERM]
        assert signal.getsignal(signal.SIGTERM) is handler_before
    finally:
        signal.signal(signal.SIGTERM, before)


class Screen(io.StringIO):
    """Standard error that tells when some text has been shown on it so many times."""

    def __init__(self, text: str, times: int, is_terminal: bool):
        super().__init__()
        self.text, self.times, self.is_terminal, self.shown = text, times, is_terminal, threading.Event()

    def isatty(self) -> bool:
        return self.is_terminal

    def write(self, text: str) -> int:
        length = super().write(text)
        if self.getvalue().count(self.text) >= self.times:
            self.shown.set()
        return length


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_compilation_shows_its_time_and_then_nothing(monkeypatch: pytest.MonkeyPatch, is_terminal: bool):
    monkeypatch.setattr(progress, "_DELAY", 0)
    monkeypatch.setattr(progress, "_SECONDS", 0)
    screen = Screen("Bus: compiling [00:0", 3 if is_terminal else 1, is_terminal)
    monkeypatch.setattr(sys, "stderr", screen)
    with progress.ticking("Bus: compiling"):
        screen.shown.wait()
    assert not [thread for thread in threading.enumerate() if thread.name == "hrljax progress"]
    shown = screen.getvalue()
    assert shown.endswith("\r")
    assert not shown.split("\r")[-2].strip()  # the line is empty again
    assert "\n" not in shown
    if not is_terminal:
        assert shown.count("compiling") == 1


def test_what_is_quick_or_not_asked_for_shows_nothing(capsys: pytest.CaptureFixture[str]):
    with progress.ticking("Bus: compiling"):
        pass
    with progress.ticking(None):
        assert not [thread for thread in threading.enumerate() if thread.name == "hrljax progress"]
    assert not capsys.readouterr().err


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning", "ignore:.*use of fork:DeprecationWarning")
@pytest.mark.parametrize("call", ["sweep", "estimate", "train"])
def test_a_fork_of_a_process_that_uses_jax_is_told_to_spawn(call: str, jax_has_started: None):
    arguments: dict[str, Any] = {"env": hrljax.make("Maze"), "learner": hrljax.QLearning(), "num_episodes": 3}
    arguments |= {"key": np.uint32(0)} if call == "train" else {"seeds": 1}
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(120)  # it would wait for ever if it went on
        try:
            getattr(hrljax, call)(**arguments)
        except RuntimeError as error:
            os.write(writer, str(error).encode())
        os._exit(0)
    os.close(writer)
    with open(reader) as message:
        assert '"spawn"' in message.read()
    os.waitpid(child, 0)


@pytest.fixture
def jax_has_started() -> None:
    jnp.zeros(1).block_until_ready()
