"""How an interrupt (Ctrl-C or SIGTERM) ends a program: between two results, so that those are written."""

import os
import signal
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, TypeVar

Result = TypeVar("Result")

_NO_RESULT: Any = object()
_SOON = 0.05
"""Seconds."""


class Interruption:
    """The interrupt of a program, and how far the program was.

    Attributes:
        signal: the first signal that came, 0 if none did. A `KeyboardInterrupt` without one counts as SIGINT.
        came_from_outside: whether there was a signal.
        raises: whether a signal raises `KeyboardInterrupt` now; else it is only remembered.
        results: results that the program has got so far.
    """

    def __init__(self) -> None:
        self.signal, self.raises, self.results = 0, True, 0
        self.came_from_outside = self._was_swallowed = False

    @property
    def status(self) -> int:
        """The status to end with: 130 after SIGINT, 143 after SIGTERM, 0 without an interrupt."""
        return 128 + self.signal if self.signal else 0

    @contextmanager
    def handled(self) -> Iterator[None]:
        """Takes signals, unless they are ignored, until it ends."""
        numbers = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) is not signal.SIG_IGN]
        before = {number: signal.signal(number, self._handle) for number in numbers}
        report, sys.unraisablehook = sys.unraisablehook, self._unraisable
        self._report = report
        try:
            yield
        finally:
            sys.unraisablehook = report
            for number, handler in before.items():
                # All is done: what was to end the program during its imports has nothing more to end.
                of_python = handler in (signal.SIG_DFL, signal.default_int_handler)
                signal.signal(number, handler if of_python else signal.SIG_IGN)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if self.signal and not self._was_swallowed:
            leave(self.status, "interrupted twice: stopped at once")
        if not self.signal:
            _say("stopping; interrupt again to stop at once")
        self.signal, self.came_from_outside, self._was_swallowed = self.signal or number, True, False
        if self.raises:
            raise KeyboardInterrupt

    def _unraisable(self, unraisable: "sys.UnraisableHookArgs") -> None:
        """An interrupt within a destructor or a callback, where Python drops what is raised: raises it again."""
        if self.signal and issubclass(unraisable.exc_type, KeyboardInterrupt):
            self._was_swallowed = True
            # In here it would be dropped again.
            again = threading.Timer(_SOON, signal.pthread_kill, (threading.main_thread().ident, self.signal))
            again.daemon = True
            again.start()
        else:
            self._report(unraisable)

    def until(self, results: Iterable[Result]) -> Iterator[Result]:
        """See `hrljax.experiments.program.until_interrupted`."""
        iterator = iter(results)
        while not self.signal:
            result = _NO_RESULT
            try:
                self.raises = True
                if not self.signal:  # none came just before
                    result = next(iterator, _NO_RESULT)
            except BaseException as error:
                # Within JAX's native code an interrupt may turn into another error.
                if not self.signal and not isinstance(error, KeyboardInterrupt):
                    raise
                self.signal = self.signal or signal.SIGINT
            finally:
                self.raises = False
            if result is _NO_RESULT:
                return
            self.results += 1
            yield result


def leave(status: int, last_words: str = "") -> None:
    """Ends the process as it is, whatever native code it still runs; that is what makes JAX crash at a usual end."""
    if last_words:
        _say(last_words)
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):
            stream.flush()
    os._exit(status)


def _say(text: str) -> None:
    """Writes a line, whatever Python was just writing; a progress bar may be before it."""
    with suppress(OSError):
        os.write(2, f"\n{text}\n".encode())
