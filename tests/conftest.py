"""Strictness for every test, and the Bus domain that many of them share."""

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
