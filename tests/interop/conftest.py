"""The walker, registered for one test at a time, and a compiler for what is hardly run."""

from collections.abc import Iterator

import gymnasium
import jax
import pytest

import hrljax as hrl
from hrljax.envs import registry
from tests.interop.walker import Walker


@pytest.fixture
def walker_id(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setattr(registry, "_ENVIRONMENTS", dict(registry._ENVIRONMENTS))
    hrl.register("Walker", Walker)
    yield "hrljax/Walker-v0"
    del gymnasium.registry["hrljax/Walker-v0"]


@pytest.fixture
def quick_compiler() -> Iterator[None]:
    """Mario's step takes long to compile and is not run for long here."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
