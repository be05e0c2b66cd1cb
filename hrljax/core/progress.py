"""Signs of life while there is nothing to count."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

_DELAY = 0.5
"""Seconds that pass without a sign."""
_SECONDS, _SECONDS_IN_A_FILE = 1, 10
"""Between two signs on a terminal, and elsewhere, where lines cannot be written over."""


@contextmanager
def ticking(text: str | None) -> Iterator[None]:
    """Shows a text and the time that has passed on standard error until it ends; nothing if None."""
    if text is None:
        yield
        return
    over = threading.Event()

    def tick() -> None:
        if over.wait(_DELAY):
            return
        with tqdm(desc=text, bar_format="{desc} [{elapsed}]", leave=False) as bar:
            while not over.wait(_SECONDS if sys.stderr.isatty() else _SECONDS_IN_A_FILE):
                bar.refresh()

    thread = threading.Thread(target=tick, name="hrljax progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
