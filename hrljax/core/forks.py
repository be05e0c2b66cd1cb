"""Processes that were forked after JAX had started: its threads are missing there, and it waits for them for ever."""

import os

from jax._src import xla_bridge

_jax_has_started = False
_is_fork_of_jax = False


def _before() -> None:
    global _jax_has_started
    # JAX has no public way to ask without starting it.
    ask = getattr(xla_bridge, "backends_are_initialized", None)
    _jax_has_started = ask is not None and ask()


def _in_child() -> None:
    global _is_fork_of_jax
    _is_fork_of_jax = _is_fork_of_jax or _jax_has_started


if hasattr(os, "register_at_fork"):  # not on Windows, which does not fork
    os.register_at_fork(before=_before, after_in_child=_in_child)


def check_not_forked() -> None:
    """Checks that JAX works in this process.

    Raises:
        RuntimeError: the process was forked after JAX had started, so that JAX would hang.
    """
    if _is_fork_of_jax:
        raise RuntimeError(
            "this process was forked after JAX had started, and JAX would wait here for ever: start processes by "
            'the method "spawn", with multiprocessing.get_context("spawn") or hrljax.sweeps.processes.processes()'
        )
