"""Million steps a second of a random policy in every environment, new episodes included, and what compiling takes.

Contestants: every environment that `hrljax.registered` names, as native loops (one run a core) and under `vmap`
over a batch; gymnax's FrozenLake and FourRooms under `vmap` of a scan, as its users write it; envpool's Taxi (C++
behind one Python call a batch); Gymnasium's own Taxi, FrozenLake and CliffWalking (one Python call a step). Peers
that are not installed are left out, and said so. gymnax caps jax and forgets `six`, so it is installed apart::

    pip install -e '.[bench]' && python benchmarks/environments.py --json environments.json
    pip install -e . gymnax six && python benchmarks/environments.py --json with_gymnax.json
"""

import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax import Array, lax

import hrljax as hrl
from hrljax.core import contract, random
from hrljax.engine import batch
from hrljax.envs.base import AnyEnvironment

try:
    from benchmarks.rounds import Contestant, measure, save
except ModuleNotFoundError:
    from rounds import Contestant, measure, save

_GYMNAX = ("FrozenLake-misc", "FourRooms-misc")
_GYMNASIUM = ("Taxi", "FrozenLake", "CliffWalking")
_ACTION, _INITIAL = 1, 2
"""Streams of random words."""


@dataclass(frozen=True)
class Options:
    """Throughput and compile time of every environment."""

    steps: int = 1_000_000
    """Steps of a contestant in a round; peers that take one step a Python call take a hundredth."""
    batch: int = 256
    """Runs at once under vmap."""
    rounds: int = 5
    """Rounds; every contestant runs once in each."""
    environments: tuple[str, ...] = hrl.registered()
    """Which of ours are run."""
    json: Path | None = None
    """Where to write the rows."""


def played(env: AnyEnvironment, steps: int) -> Callable[[Array], Array]:
    """The sum of the rewards of some steps with random actions, for one seed (uint32); with new episodes at ends."""
    params = env.default_params

    def one(seed: Array) -> Array:
        key = (seed, jnp.uint32(0))

        def begun(at: Array) -> Any:
            return contract.initial(env, random.words(key, at, env.num_initial_words, _INITIAL), params)

        def turn(at: Array, carry: tuple[Any, Array]) -> tuple[Any, Array]:
            state, total = carry
            (word,) = random.words(key, at, 1, _ACTION)
            action = random.uniform_index(word, jnp.int32(env.num_actions))
            words = random.words(key, at, env.num_words)
            after, reward, terminated, _ = contract.transition(env, state, action, words, params)
            ended = terminated | (after.time >= params.max_steps)
            return lax.cond(ended, lambda: begun(at), lambda: after), total + reward

        return lax.fori_loop(jnp.uint32(1), jnp.uint32(steps + 1), turn, (begun(jnp.uint32(0)), jnp.float32(0)))[1]

    return one


def ours(name: str, mapping: Any, options: Options) -> Contestant:
    env = hrl.make(name)
    rows = 1 if mapping == "native" else options.batch
    steps = max(1, options.steps // rows // (100 if env.has_loops else 1))
    seeds = jnp.arange(rows, dtype=jnp.uint32)
    began = time.perf_counter()
    run = batch.compile_mapped(played(env, steps), mapping, env.has_loops)
    compiled = run.lower(seeds).compile()
    seconds = time.perf_counter() - began
    label = "hrljax native" if mapping == "native" else f"hrljax vmap of {rows}"
    return Contestant(name, label, 1, lambda: _finished(compiled(seeds), rows * steps), seconds)


def _finished(result: Array, steps: int) -> int:
    jax.block_until_ready(result)
    return steps


def by_gymnax(name: str, options: Options) -> Contestant:
    import gymnax

    env, params = gymnax.make(name)
    steps = max(1, options.steps // options.batch)

    def one(key: Array) -> Array:
        def turn(carry: Any, _: None) -> Any:
            state, key = carry
            key, action_key, step_key, reset_key = jax.random.split(key, 4)
            action = jax.random.randint(action_key, (), 0, env.num_actions)
            _, after, reward, terminated, truncated, _ = env.step(step_key, state, action, params)
            first = env.reset(reset_key, params)[1]
            state = jax.tree.map(lambda a, b: jnp.where(terminated | truncated, a, b), first, after)
            return (state, key), reward

        return lax.scan(turn, (env.reset(key, params)[1], key), None, steps)[1].sum()

    keys = jax.random.split(jax.random.key(0), options.batch)
    began = time.perf_counter()
    compiled = jax.jit(jax.vmap(one)).lower(keys).compile()
    seconds = time.perf_counter() - began
    label = f"gymnax, vmap of {options.batch}"
    return Contestant(name, label, 1, lambda: _finished(compiled(keys), steps * options.batch), seconds)


def by_envpool(options: Options) -> Contestant:
    import envpool

    envs = envpool.make("Taxi-v3", env_type="gymnasium", num_envs=options.batch, num_threads=1)
    actions = np.random.default_rng(0).integers(0, 6, (64, options.batch))
    calls = max(1, options.steps // options.batch // 10)
    envs.reset()

    def run() -> int:
        for call in range(calls):
            envs.step(actions[call % len(actions)])
        return calls * options.batch

    return Contestant("Taxi-v3", f"envpool, {options.batch} a Python call", 1, run)


def by_gymnasium(name: str, options: Options) -> Contestant:
    newest = max(
        (spec for spec in gymnasium.registry.values() if spec.name == name), key=lambda spec: spec.version or 0
    )
    env: Any = gymnasium.make(newest)
    actions = np.random.default_rng(0).integers(0, env.action_space.n, 4096).tolist()
    steps = max(1, options.steps // 100)
    env.reset(seed=0)

    def run() -> int:
        for step in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[step % len(actions)])
            if terminated or truncated:
                env.reset()
        return steps

    return Contestant(newest.id, "Gymnasium, one Python call a step", 1, run)


def report(rows: list[dict[str, Any]]) -> str:
    lines = [f"{'environment':18}{'contestant':36}{'million/s':>11}{'best':>9}{'a CPU s':>9}{'compile s':>11}"]
    for row in rows:
        lines.append(
            f"{row['case']:18}{row['contestant']:36}{row['value']:11.4f}{row['best']:9.4f}"
            f"{row['per_cpu_second']:9.4f}{row['compile_seconds']:11.2f}"
        )
    return "\n".join(lines)


def main(options: Options) -> None:
    contestants = [ours(name, mapping, options) for name in options.environments for mapping in ("native", "vmap")]
    missing = [peer for peer in ("gymnax", "envpool") if find_spec(peer) is None]
    if "gymnax" not in missing:
        contestants += [by_gymnax(name, options) for name in _GYMNAX]
    if "envpool" not in missing:
        contestants.append(by_envpool(options))
    contestants += [by_gymnasium(name, options) for name in _GYMNASIUM]
    rows = measure(contestants, options.rounds, "million steps/s", 1e6)
    print(report(rows))
    installed = [name for name in ("jax", "jaxlib", "gymnasium", "gymnax", "envpool") if name not in missing]
    versions = ", ".join(f"{name} {version(name)}" for name in installed)
    print(f"median of {options.rounds} rounds; Python {platform.python_version()}, {versions}")
    if missing:
        print(f"not installed, and left out: {', '.join(missing)}")
    save(rows, options.json)


if __name__ == "__main__":
    main(tyro.cli(Options))
