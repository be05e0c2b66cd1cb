"""The walker, registered for one test at a time."""

from collections.abc import Iterator

import gymnasium
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
