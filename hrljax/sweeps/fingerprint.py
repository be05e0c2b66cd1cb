"""What makes two sweeps the same: settings as text and numbers, and digests of what text does not tell."""

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Mapping

import jax
import numpy as np
from jax import Array

from hrljax.core.environment import Numbers
from hrljax.envs.base import AnyEnvironment, TabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.tables import parts_of_states, tabulate
from hrljax.learners.base import AnyLearner
from hrljax.learners.hyperparameters import Tabulated, with_tabulated_schedules
from hrljax.learners.options.definition import Options
from hrljax.sweeps import versions
from hrljax.sweeps.axes import env_name, is_of_env

SWEPT = "swept"
"""Value of the attribute of a hyper-parameter that has an axis of its own."""


def attributes(
    env: AnyEnvironment, learner: AnyLearner, params: Numbers, key: Array, swept: Iterable[str]
) -> versions.Attributes:
    """Every setting of a sweep by name, as text or numbers."""
    settings = {_learner_name(name): as_attribute(value) for name, value in learner.settings().items()}
    settings |= {env_name(name): as_attribute(value) for name, value in params._asdict().items()}
    settings |= {name if is_of_env(name) else _learner_name(name): SWEPT for name in swept}
    return {
        "environment": env.name,
        "learner": learner.name,
        **settings,
        **{env_name(name): str(value) for name, value in options(env).items()},
        **versions.as_attributes([versions.installed()]),
        "key": json.dumps(np.asarray(jax.random.key_data(key)).tolist()),
    }


def _learner_name(setting: str) -> str:
    return f"learner.{setting}"


def options(env: AnyEnvironment) -> dict[str, object]:
    """The options that an environment was made with."""
    return {field.name: getattr(env, field.name) for field in dataclasses.fields(env)}  # type: ignore[arg-type]


def as_attribute(value: object) -> str | int | float:
    """A setting as what files can hold; equal in every process."""
    if isinstance(value, np.floating):
        return float(str(value))
    if callable(value):
        return f"schedule {getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__name__)}"
    return value if isinstance(value, str | int | float) else repr(value)


def digests(env: AnyEnvironment, learner: AnyLearner, num_episodes: int) -> dict[str, str]:
    """By name, digests of the hierarchies, options and schedules of a learner: of what they do, not of their code.

    Raises:
        ValueError: as `hrljax.hierarchy.tables.tabulate`, or a schedule leaves its interval.
    """
    by_name: dict[str, str] = {}
    for name, value in with_tabulated_schedules(learner, num_episodes).settings().items():
        if isinstance(value, Hierarchy):
            by_name[f"digest.learner.{name}"] = hierarchy_digest(env, value)
        elif isinstance(value, Options):
            by_name[f"digest.learner.{name}"] = options_digest(value)
        elif isinstance(value, Tabulated):
            by_name[f"digest.learner.{name}"] = _digest([value.values])
    return by_name


def hierarchy_digest(env: AnyEnvironment, hierarchy: Hierarchy) -> str:
    """A digest of a hierarchy's graph and of its predicates at every state of an environment."""
    assert isinstance(env, TabularEnvironment)  # as every learner over a hierarchy needs
    tables = tabulate(hierarchy, env)
    parts = [tables.active, tables.goal]
    for task in hierarchy.subtasks:
        parts += parts_of_states(task, env)
    return _digest([np.frombuffer(repr(hierarchy).encode(), np.uint8), *parts])


def options_digest(options: Options) -> str:
    """A digest of everything that options are made of."""
    names = np.frombuffer(json.dumps([options.actions, options.names, options.primitives]).encode(), np.uint8)
    return _digest([names, options.policy, options.termination, options.initiation])


def _digest(arrays: list[np.ndarray]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def differences(before: Mapping[str, object], now: Mapping[str, object]) -> list[str]:
    """What differs between two sets of settings, as text that names both values: those of before, and the ones now."""
    return [
        f"{name} is {before.get(name, 'absent')!r} there and {now.get(name, 'absent')!r} here"
        for name in {**before, **now}
        if before.get(name) != now.get(name)
    ]
