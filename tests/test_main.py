"""``python -m hrljax``."""

import runpy
import sys
from importlib.metadata import version

import jax
import pytest

import hrljax as hrl


def test_it_tells_versions_devices_mapping_environments_and_learners(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delitem(sys.modules, "hrljax.__main__", raising=False)  # of a test that imports all modules
    runpy.run_module("hrljax", run_name="__main__")
    rows = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert rows["hrljax"] == hrl.__version__ == version("hrljax")
    assert rows["jax"] == jax.__version__
    assert str(jax.devices()[0]) in rows["devices"]
    assert "native loops" in rows["runs"]
    assert "a loop's turn that writes one number takes" in rows["loops"]
    assert rows["environments"].split(", ") == list(hrl.registered())
    assert {"QLearning", "SharedHORDQ", "RelationalHORDQ"} <= set(rows["learners"].split(", "))
    assert "RandomRoot" not in rows["learners"]
