"""Trees take long to compile."""

import pytest


@pytest.fixture(autouse=True)
def quick_where_nothing_is_slow(request: pytest.FixtureRequest) -> None:
    """A run with the slow tests, which compare mappings bit for bit, optimises as users' runs do."""
    if request.config.option.markexpr == "not slow":
        request.getfixturevalue("quick_compiler")
