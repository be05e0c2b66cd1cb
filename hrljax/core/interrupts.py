"""Keyboard interrupts around work that JAX cannot stop: compilations and native loops.

An interrupt in the main thread abandons such work, which goes on. If the process then ends, JAX
destroys what the work still uses, and the process crashes. So native work runs in threads of its
own, and a process that ends waits for them.
"""

import atexit
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class _NativeCall(threading.Thread):
    """A call in a thread of its own; it is no reason for Python to wait, because `_wait` does so better."""

    def __init__(self, function: Callable[..., Any], arguments: tuple[Any, ...]):
        super().__init__(name="hrljax native call", daemon=True)
        self.future: Future[Any] = Future()
        self.future.set_running_or_notify_cancel()
        self._call = function, arguments

    def run(self) -> None:
        function, arguments = self._call
        try:
            result = function(*arguments)
        except BaseException as error:
            self.future.set_exception(error)
        else:
            self.future.set_result(result)


def start(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    """Calls native code in a new thread. Waiting for the future can be interrupted; the call goes on then."""
    call = _NativeCall(function, arguments)
    call.start()
    return call.future


def running() -> list[threading.Thread]:
    """The threads of native calls that have not ended."""
    return [thread for thread in threading.enumerate() if isinstance(thread, _NativeCall)]


@atexit.register  # so late that JAX's own, which destroys its clients, comes after it
def _wait() -> None:
    """Waits for native calls that an interrupt has left; another interrupt ends the process."""
    calls = running()
    if not calls:
        return
    print("hrljax: waiting for native code that cannot be stopped; interrupt again to end at once", file=sys.stderr)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    for call in calls:
        call.join()


@contextmanager
def postponed() -> Iterator[None]:
    """Within it, what handlers of SIGINT and SIGTERM raise waits for its end; a second time it does not.

    For short work of the main thread that compiles here and there.
    """
    if threading.current_thread() is not threading.main_thread():  # where no handler ever runs
        yield
        return
    waiting: list[BaseException] = []

    def instead_of(handler: Callable[..., Any]) -> Callable[..., None]:
        def handle(*arguments: Any) -> None:
            try:
                handler(*arguments)
            except BaseException as error:
                if waiting:
                    raise
                waiting.append(error)

        return handle

    handlers = {number: handler for number in _SIGNALS if callable(handler := signal.getsignal(number))}
    try:
        for number, handler in handlers.items():
            signal.signal(number, instead_of(handler))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if waiting:
            raise waiting[0]
