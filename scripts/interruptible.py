"""Imported first by every program: while it imports what takes long, an interrupt ends it without a traceback."""

import os
import signal
import sys
from typing import Any


def _end(number: int, _frame: Any) -> None:
    os.write(2, b"\ninterrupted: nothing was begun\n")
    os._exit(128 + number)


if "jax" not in sys.modules:
    for _number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(_number) is not signal.SIG_IGN:
            signal.signal(_number, _end)
