"""Results are those that were recorded, bit for bit: under both mappings, every version of JAX, every processor."""

import numpy as np
import pytest

from tests import fingerprint


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in fingerprint.CASES if name not in fingerprint.LONG_TO_COMPILE])
def test_results_are_as_recorded(name: str):
    """Those that compile for long are compared by ``python -m tests.fingerprint``, which names what differs, too."""
    assert not fingerprint.differences(fingerprint.recorded()[name], fingerprint.fingerprint(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", fingerprint.UNDER_VMAP_TOO)
def test_the_other_mapping_gives_the_same(name: str):
    assert not fingerprint.differences(fingerprint.recorded()[name], fingerprint.fingerprint(name, "vmap"))


def test_the_record_holds_every_case():
    assert list(fingerprint.recorded()) == list(fingerprint.CASES)


def test_a_fingerprint_depends_on_every_number_and_on_no_shape():
    table = np.arange(6, dtype=np.float32)
    assert fingerprint.digest(table) == fingerprint.digest(table.reshape(2, 3))
    assert len({fingerprint.digest(t) for t in (table, table[::-1], np.nextafter(table, 9), table.astype(int))}) == 4
    (line,) = fingerprint.differences({"steps": "1 2", "return": "a"}, {"steps": "1 3", "return": "a"})
    assert line == "steps: 1 2 recorded, 1 3 now"
