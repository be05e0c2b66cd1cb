"""The walk that tests of Mario's learners share."""

import pytest

from tests.learners.relational.walks import Walk, recorded


@pytest.fixture(scope="session")
def walk() -> Walk:
    return recorded()
