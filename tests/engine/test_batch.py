"""Many runs at once: a seed has one result, whatever runs beside it; interruptions and errors lose nothing."""

import os
import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import xarray as xr

import hrljax
from hrljax.core import interrupts
from hrljax.engine import batch, compiler
from hrljax.envs.bus.env import Bus, BusParams
from tests.maps import SMALL

SEEDS, EPISODES, BIN_SIZE = 8, 90, 20
HIERARCHY = Bus().hierarchy()
LEARNERS = {
    "QLearning": hrljax.QLearning(initial_value=-25.0, discount=0.97),
    "SARSA": hrljax.SARSA(initial_value=-25.0, discount=0.97),
    "HORDQ random": hrljax.HORDQ(HIERARCHY, pseudo_reward=5.0, initial_value=-25.0, discount=0.97),
    "HORDQ model": hrljax.HORDQ(SMALL.hierarchy(), hrljax.ModelRoot(), pseudo_reward=5.0, discount=0.97),
    "MAXQ": hrljax.MAXQ(HIERARCHY, pseudo_reward=60.0, epsilon=optax.linear_schedule(0.5, 0.05, 20), discount=0.97),
}


def env_of(name: str) -> Bus:
    """A small map for what takes long to compile."""
    return SMALL if "model" in name else Bus()


def swept(name: str = "QLearning", **options: Any) -> xr.Dataset:
    defaults = {"seeds": SEEDS, "num_episodes": EPISODES, "bin_size": BIN_SIZE, "chunk_size": 3, "mapping": "native"}
    return hrljax.sweep(env_of(name), LEARNERS[name], **{**defaults, **options}, progress=False)


def assert_same(one: xr.Dataset, other: xr.Dataset) -> None:
    """All numbers have the same bits (coordinates and attributes aside)."""
    assert set(one) == set(other)
    for variable in one:
        np.testing.assert_array_equal(one[variable].values, other[variable].values, err_msg=str(variable))
        assert one[variable].notnull().all()


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
def test_a_seed_has_one_result_under_every_mapping(name: str):
    """Native loops, all runs in step under `vmap`, and one run alone."""
    native = swept(name)
    assert native["steps"].values.min() > 100
    assert len(np.unique(native["steps"])) > SEEDS // 2
    assert_same(native, swept(name, mapping="vmap", chunk_size=7))
    alone = jax.jit(lambda key: hrljax.train(env_of(name), LEARNERS[name], key, EPISODES, bin_size=BIN_SIZE))
    for seed in (0, SEEDS - 1):
        run = alone(jax.random.fold_in(jax.random.key(0), seed))
        for variable, value in {**run.metrics, "steps": run.steps}.items():
            np.testing.assert_array_equal(native[variable].sel(seed=seed), value, err_msg=variable)


@pytest.mark.parametrize("options", [{"cores": 1}, {"cores": 2}, {"chunk_size": 1}, {"chunk_size": 7}], ids=str)
def test_chunks_and_cores_change_nothing(options: dict[str, int]):
    assert_same(swept(), swept(**options))


def test_fewer_seeds_are_the_first_ones():
    name = "HORDQ random"
    assert_same(swept(name, seeds=3), swept(name).isel(seed=slice(3)))


def test_values_along_an_axis_are_those_of_constants():
    name = "HORDQ random"
    axes = {"pseudo_reward": [0.0, 5.0], "env.slip_probability": [0.1, 0.5], "epsilon": [0.1]}
    grid = swept(name, axes=axes)
    same = grid.sel({"pseudo_reward": 5.0, "env.slip_probability": 0.1, "epsilon": 0.1})
    assert_same(same, swept(name))
    assert not np.array_equal(grid["steps"].sel({"pseudo_reward": 0.0, "env.slip_probability": 0.1}), same["steps"])


SHORT = {"params": BusParams(max_steps=40)}
"""Short episodes, which are quick to evaluate."""


@pytest.mark.slow
def test_evaluation_changes_no_run_and_has_one_result():
    evaluated = swept(**SHORT, evaluate_every=2)
    assert evaluated["greedy_return"].shape == (SEEDS, 2)
    assert_same(evaluated.drop_vars("greedy_return"), swept(**SHORT))
    assert_same(evaluated, swept(**SHORT, evaluate_every=2, mapping="vmap"))


@pytest.mark.parametrize("bin_size", [1, EPISODES])
def test_bins_only_say_where_sums_are_taken(bin_size: int):
    """Totals over the run agree: counts of steps and events are whole numbers."""
    one, other = swept(), swept(bin_size=bin_size)
    np.testing.assert_array_equal(one["steps"], other["steps"])
    for variable in ("return", "length", "damage", "breakdown", "truncated"):
        totals = [np.rint(d[variable].values * np.diff([0, *d["episode"].values])).sum(-1) for d in (one, other)]
        np.testing.assert_array_equal(*totals, err_msg=variable)
        assert np.all(np.abs(one[variable].values) < 1001)


def test_a_second_sweep_compiles_nothing():
    """Equal settings in new objects; and other keys, axis values and seeds in chunks of one size."""
    settings = {"axes": {"pseudo_reward": [1.0, 2.0]}, "seeds": 4, "num_episodes": 3, "bin_size": 1, "chunk_size": 3}

    def sweep(**options: Any) -> xr.Dataset:
        learner = hrljax.HORDQ(Bus().hierarchy(), hrljax.RandomRoot(), initial_value=-20.0)
        return hrljax.sweep(Bus(), learner, **{**settings, **options}, mapping="native", progress=False)

    compilations: list[str] = []
    traced: list[int] = []
    initial = Bus.initial

    def listen(event: str, duration: float, **_: Any) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compilations.append(event)

    def counted(self: Bus, *arguments: Any) -> Any:
        traced.append(1)
        return initial(self, *arguments)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Bus, "initial", counted)
            first = sweep()
            assert compilations
            assert traced
            compilations.clear()
            traced.clear()
            assert_same(first, sweep())
            assert not compilations
            sweep(key=1)
            sweep(axes={"pseudo_reward": [3.0, 4.0]})
            sweep(seeds=5)
            assert not traced
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


class Interrupted:
    """Raises a keyboard interrupt in place of some calls of `wait`."""

    def __init__(self, *calls: int):
        self.calls, self.count, self.wait = calls, 0, batch.wait

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        self.count += 1
        if self.count in self.calls:
            raise KeyboardInterrupt
        return self.wait(*arguments, **options)


def test_an_interrupt_keeps_what_is_finished(monkeypatch: pytest.MonkeyPatch):
    whole = swept(**SHORT, evaluate_every=2)
    monkeypatch.setattr(batch, "wait", Interrupted(2))
    stored = swept(**SHORT, evaluate_every=2, cores=1)  # chunks of 3: one is done, one is running, one never starts
    assert (stored.attrs["complete"], whole.attrs["complete"]) == (0, 1)
    assert_same(stored.isel(seed=slice(6)), whole.isel(seed=slice(6)))
    for variable in stored:
        assert stored[variable].isel(seed=slice(6, None)).isnull().all()
    for call in interrupts.running():
        call.join()  # it has just ended, for its chunk was waited for


def test_an_interrupt_before_anything_is_finished_waits_for_what_runs(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(batch, "wait", Interrupted(1))
    stored = swept(cores=1)
    assert stored["return"].notnull().all("episode").values.tolist() == [True] * 3 + [False] * 5


def test_a_second_interrupt_ends_the_sweep(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(batch, "wait", Interrupted(2, 3))
    with pytest.raises(KeyboardInterrupt):
        swept(cores=1)


@pytest.mark.parametrize("cores", [1, 3])
def test_a_failing_chunk_raises_its_error(cores: int):
    def fails(rows: jax.Array) -> jax.Array:
        if (rows == 4).any():
            raise RuntimeError("row 4 is broken")
        return rows * 2

    options = {"mapping": "native", "chunk_size": 1, "cores": cores}
    with pytest.raises(RuntimeError, match="row 4 is broken"):
        batch.run_many(fails, jnp.arange(6, dtype=jnp.int32), **options)
    fine = batch.run_many(fails, jnp.arange(4, dtype=jnp.int32), **options)
    np.testing.assert_array_equal(fine.values, [0, 2, 4, 6])
    assert fine.finished.all()


def test_every_row_lies_at_its_place_in_chunks_of_one_shape():
    shapes = set()

    def doubled(rows: dict[str, jax.Array]) -> dict[str, jax.Array]:
        shapes.add(rows["x"].shape)
        return {"twice": rows["x"] * 2, "wide": jnp.stack([rows["x"]] * 3, -1)}

    actual = batch.run_many(doubled, {"x": jnp.arange(11, dtype=jnp.int32)}, mapping="native", cores=3, chunk_size=4)
    assert shapes == {(4,)}
    np.testing.assert_array_equal(actual.values["twice"], 2 * np.arange(11))
    np.testing.assert_array_equal(actual.values["wide"], np.arange(11)[:, None].repeat(3, 1))


def test_chunks_are_small_enough_for_every_core():
    assert batch.chunk_length(1000, 4, "native", None) <= 16
    assert batch.chunk_length(8, 2, "native", None) == 1
    assert batch.chunk_length(1, 2, "native", None) == 1
    assert batch.chunk_length(5, 2, "vmap", None) == 5
    assert batch.chunk_length(5, 2, "native", 3) == 3


def test_refused_compiler_options_warn_once_and_fall_back(monkeypatch: pytest.MonkeyPatch):
    expected, taken = swept(), dict(compiler.NESTED_OPTIONS)
    for options in ("OPTIONS", "NESTED_OPTIONS"):
        monkeypatch.setattr(compiler, options, {**getattr(compiler, options), "xla_no_such_option": True})
    compiler.native_loops_available.cache_clear()
    compiler.lockstep_options.cache_clear()
    try:
        with pytest.warns(RuntimeWarning, match="refuses the compiler options of native loops"):
            assert batch.resolve_mapping("auto") == "vmap"
        actual = swept(mapping="auto", chunk_size=7)  # a second warning would be an error
        assert compiler.lockstep_options() == taken
    finally:
        compiler.native_loops_available.cache_clear()
        compiler.lockstep_options.cache_clear()
    assert actual.attrs["mapping"] == "vmap"
    assert_same(actual, expected)


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (None, compiler._FLAG),
        ("--xla_dump_to=/nowhere", f"--xla_dump_to=/nowhere {compiler._FLAG}"),
        ("--xla_backend_extra_options=mine", "--xla_backend_extra_options=mine"),
        (compiler._FLAG, compiler._FLAG),
    ],
)
def test_flags_of_the_user_are_kept(monkeypatch: pytest.MonkeyPatch, flags: str | None, expected: str):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    if flags is not None:
        monkeypatch.setenv("XLA_FLAGS", flags)
    compiler.request_native_loops()
    assert os.environ["XLA_FLAGS"] == expected


def in_new_process(program: str, **environment: str) -> str:
    others = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    options = {"capture_output": True, "text": True, "env": others | environment, "check": True}
    return subprocess.run([sys.executable, "-c", program], **options).stdout


def test_the_import_adds_its_flag_to_those_of_the_user():
    program = "import os, hrljax; print(os.environ['XLA_FLAGS'], hrljax.engine.compiler.native_loops_available())"
    assert in_new_process(program, XLA_FLAGS="--xla_cpu_enable_fast_math=false").split() == [
        "--xla_cpu_enable_fast_math=false",
        compiler._FLAG,
        "True",
    ]


def test_an_import_after_the_first_computation_warns_if_it_comes_too_late():
    """Some versions of XLA compile native loops without the flag; then there is nothing to warn of."""
    program = """
import warnings, jax
jax.numpy.zeros(3) + 1
from hrljax.engine import batch
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    print([batch.resolve_mapping(mapping) for mapping in ("auto", "native")])
found = [str(w.message) for w in caught if w.category is RuntimeWarning]
print(len(found), all("Import hrljax before" in message for message in found))
"""
    too_late, early_enough = ["['vmap', 'vmap']", "1 True"], ["['native', 'native']", "0 True"]
    assert in_new_process(program).splitlines() in (too_late, early_enough)
