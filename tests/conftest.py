"""Strictness for every test, the Bus domain that many of them share, and a compiler for what is hardly run."""

from collections.abc import Iterator

import jax
import pytest

from hrljax.envs.bus.env import Bus
from hrljax.solvers.model import Model

jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture(scope="session")
def bus() -> Bus:
    return Bus()


@pytest.fixture(scope="session")
def bus_model(bus: Bus) -> Model:
    return bus.model()


@pytest.fixture
def quick_compiler() -> Iterator[None]:
    """For what takes long to compile and is not run for long."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
