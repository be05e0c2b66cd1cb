"""A program that is interrupted at an instant of its own choice; run by `test_program.py` in a process of its own.

Arguments: names of cases. Each runs in a fork made before JAX has started, so that the imports are paid once, and its
status and what it says are printed as a line of JSON.
"""

import contextlib
import json
import os
import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hrljax.experiments import program


@dataclass(frozen=True)
class Options:
    out: Path = Path("out")


def interrupt(number: int = signal.SIGINT) -> None:
    os.kill(os.getpid(), number)


class Swallowing:
    """Python drops what is raised in here."""

    def __del__(self) -> None:
        interrupt()


def results(case: str) -> Iterator[int]:
    """Three results; some cases have an interrupt on the way to the second."""
    yield 1
    if case == "between":
        interrupt()
    elif case == "terminated":
        interrupt(signal.SIGTERM)
    elif case == "in a destructor":
        Swallowing()
        signal.alarm(120)
        threading.Event().wait()  # until the interrupt comes again
    elif case == "as another error":
        with contextlib.suppress(KeyboardInterrupt):
            interrupt()
        raise RuntimeError("made of an interrupt")
    elif case == "own error":
        raise RuntimeError("not made of an interrupt")
    yield 2
    yield 3


def main_of(case: str) -> object:
    def main(options: Options) -> int:
        if case == "before":
            interrupt()
        for result in program.until_interrupted(results(case)):
            if case == "with a result" and result == 2:
                interrupt()
            print("result", result)
        if case in ("afterwards", "twice", "full disk"):
            interrupt()
        if case == "twice":
            print("before the second")
            interrupt()
        if case == "full disk":
            raise OSError("the disk is full")
        print("all is written")
        return program.ended(options.out)

    return main


def run(case: str) -> None:
    """Runs a case in a child."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        for descriptor in (1, 2):
            os.dup2(writer, descriptor)
        for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGTERM, signal.SIG_DFL)):
            signal.signal(number, handler)
        sys.argv = ["program"]
        program.run(main_of(case), Options)  # type: ignore[arg-type]
    os.close(writer)
    with open(reader) as said:
        lines = said.read().split("\n")
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    print(json.dumps({"status": status, "lines": [line for line in lines if line]}), flush=True)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        run(name)
