"""What was learned: one run's tables, on disk and as a policy."""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from hrljax.core import checks
from hrljax.core.files import write_atomically
from hrljax.engine.start import Start, described, learned_shapes, named_leaves, step_words, tree_of
from hrljax.envs.base import AnyEnvironment, Environment
from hrljax.envs.registry import make, registered
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.numpy_policy import Policy, from_hierarchical
from hrljax.learners.base import Learner, outside_of_training
from hrljax.learners.hyperparameters import Settings
from hrljax.learners.options.definition import Options
from hrljax.sweeps.axes import env_name, of_learner
from hrljax.sweeps.continuation import check_origin, episodes_of, names_of_tables
from hrljax.sweeps.fingerprint import as_attribute, differences, hierarchy_digest, options, options_digest

if TYPE_CHECKING:
    import xarray as xr

_FORMAT, _VERSION = "hrljax learned", 1
_HEADER = "header"
_MOST_SHOWN = 12
"""Values of an axis that a message lists."""


class Learned:
    """What one run has learned.

    Attributes:
        env: the environment.
        learner: the learner, with the hyper-parameters that it learned with.
        tables: its tables, a tree of NumPy arrays; `hrljax.Run.learned`.
        episodes: how many it has learned from; 0 if that is not known.
        steps: primitive steps of these episodes.
    """

    def __init__(self, env: AnyEnvironment, learner: Learner, tables: Any, *, episodes: int = 0, steps: int = 0):
        """
        Raises:
            TypeError: an argument is of the wrong kind.
            ValueError: `tables` are not those of one run of `learner` on `env`; `episodes` or `steps` is negative.
        """
        checks.instance("env", env, Environment, "an environment such as hrljax.make('Bus')")
        checks.instance("learner", learner, Learner, "a learner such as hrljax.QLearning()")
        episodes = checks.integer("episodes", episodes)
        steps = checks.integer("steps", steps, 0, 2**63 - 1)
        self.env, self.learner = env, learner
        self.episodes, self.steps = episodes, steps
        self.tables = jax.tree.map(np.asarray, tables)
        expected = learned_shapes(env, learner)
        if described(self.tables) != described(expected):
            raise ValueError(
                f"tables must be those of one run of {learner.name} on {env.name}, {described(expected)}, "
                f"got {described(self.tables)}"
            )

    @classmethod
    def of(
        cls, dataset: xr.Dataset, env: Any, learner: Learner, *, seed: int = 0, at: Mapping[str, float] | None = None
    ) -> Learned:
        """One run out of a sweep.

        Args:
            dataset: what ``hrljax.sweep(..., keep_learned=True)`` returned.
            env: the environment of the sweep.
            learner: the learner of the sweep.
            seed: number of the seed.
            at: the value along each axis.

        Raises:
            TypeError: an argument is of the wrong kind.
            ValueError: the dataset has no tables, is of something else, or has not finished this run.
            KeyError: a seed or a value that the dataset does not have; the message lists those that it has.
        """
        _check_dataset(dataset)
        checks.instance("env", env, Environment, "the environment of the sweep")
        checks.instance("learner", learner, Learner, "the learner of the sweep")
        at = dict(checks.instance("at", {} if at is None else at, Mapping, "a mapping such as {'step_size': 0.1}"))
        axes = [str(dim) for dim in dataset["steps"].dims if dim != "seed"]
        if set(at) != set(axes):
            raise ValueError(f"at must give a value for each of {axes}, got {at}")
        check_origin("the dataset", dataset, env, learner)
        point = {"seed": _on_grid("seed", seed, dataset)}
        point |= {axis: _on_grid(f"at: {axis}", at[axis], dataset, axis) for axis in axes}
        run = dataset.sel(point)
        if not np.isfinite(run["steps"]):
            raise ValueError(f"the run of seed {seed} at {at} is not finished")
        learner = learner.replaced(of_learner(at))
        named = {name: run[name].values for name in names_of_tables("the dataset", run)}
        tables = tree_of(learned_shapes(env, learner), named)
        return cls(env, learner, tables, episodes=episodes_of(dataset), steps=int(run["steps"]))

    def as_start(self) -> Start:
        """Where `hrljax.train` and `hrljax.sweep` go on from it."""
        return Start(self.tables, self.episodes, step_words(self.steps))

    def policy(self, seed: int = 0) -> Policy | StatePolicy:
        """The greedy policy: in plain NumPy, over the numbers of states; or, of a learner that sees states, over these.

        Args:
            seed: of the choices of a root that chooses at random; other policies are deterministic.

        Raises:
            TypeError, ValueError: `seed` is no integer of at least 0.
            ValueError: a learner that sees states has a schedule; replace it by the number that is meant.
        """
        checks.integer("seed", seed, 0, 2**64 - 1)
        tables = jax.tree.map(jnp.asarray, self.tables)
        if not self.learner.is_tabular:
            return StatePolicy(self.env, self.learner, tables)
        prepared = self.learner.prepare(self.env)
        policy = self.learner.greedy_policy(self.env, prepared, tables, outside_of_training(jnp.uint32(0)))
        return from_hierarchical(policy, np.random.default_rng(seed))

    def save(self, path: str | Path) -> None:
        """Writes one file, whole or not at all: the tables and what they belong to. It holds no code.

        Raises:
            OSError: `path` cannot be written.
        """
        path = checks.path("path", path)
        tables = {name: np.asarray(leaf) for name, leaf in named_leaves(self.tables)}
        header = {
            "format": _FORMAT,
            "version": _VERSION,
            "hrljax": version("hrljax"),
            **_settings(self.env, self.learner),
            "tables": sorted(tables),
            "episodes": self.episodes,
            "steps": self.steps,
        }
        content = io.BytesIO()
        np.savez(content, **{_HEADER: np.frombuffer(json.dumps(header).encode(), np.uint8)}, **tables)  # type: ignore[arg-type]
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content.getvalue())

    @classmethod
    def load(cls, path: str | Path, env: AnyEnvironment | None = None, learner: Learner | None = None) -> Learned:
        """Reads a file that `save` wrote.

        Args:
            path: the file.
            env: the environment; has to be given unless it is registered.
            learner: the learner; has to be given if it has a schedule, options, or a hierarchy other
                than the environment's own.

        Raises:
            FileNotFoundError: there is no file.
            ValueError: the file is damaged, no such file, of a version that is not known, or of
                another environment or learner than those that are given. The message says which.
        """
        header, tables = _read(checks.path("path", path))
        where = f"{path} holds what was learned"
        if env is None:
            name = header["environment"]
            if name not in registered():
                raise ValueError(f"{where} on {name!r}, which is not registered; give it as env")
            env = make(name, **{option: _option(value) for option, value in header["options"].items()})
        assert env is not None
        learner = learner or _learner(env, header, where)
        here = json.loads(json.dumps(_settings(env, learner)))
        wrong = differences(_flat({name: header[name] for name in here}), _flat(here))
        if wrong:
            raise ValueError(f"{where} with other settings: {'; '.join(wrong)}")
        if sorted(tables) != header["tables"]:
            raise ValueError(f"{path} is damaged: it has the tables {sorted(tables)} instead of {header['tables']}")
        trained = {name: int(header.get(name, 0)) for name in ("episodes", "steps")}  # older files do not say
        return cls(env, learner, tree_of(learned_shapes(env, learner), tables), **trained)


def _check_dataset(dataset: object) -> None:
    import xarray as xr

    checks.instance("dataset", dataset, xr.Dataset, "a dataset of hrljax.sweep(..., keep_learned=True)")
    assert isinstance(dataset, xr.Dataset)
    if "steps" not in dataset:
        variables = ", ".join(map(str, dataset.data_vars)) or "none"
        raise ValueError(f"dataset must have the variable 'steps', as hrljax.sweep gives it; it has {variables}")


def _on_grid(name: str, value: Any, dataset: xr.Dataset, axis: str = "seed") -> Any:
    """The value, if it is one of those along an axis of a dataset."""
    grid = dataset[axis].values
    value = checks.integer(name, value, -checks.LARGEST_INTEGER) if axis == "seed" else checks.number(name, value)
    if value not in grid:
        shown = ", ".join(f"{known:.12g}" for known in grid[:_MOST_SHOWN])
        more = f" and {len(grid) - _MOST_SHOWN} more, up to {grid.max():.12g}" if len(grid) > _MOST_SHOWN else ""
        raise KeyError(f"{name} must be one of {shown}{more}, got {checks.described(value)}")
    return value


class StatePolicy:
    """What a learner that sees states does without exploration: called with a state, it gives the number of an action.

    It decides in every state anew: a root that follows a sequence of actions searches in every step.
    """

    def __init__(self, env: AnyEnvironment, learner: Learner, tables: Any):
        """
        Raises:
            ValueError: the learner has a schedule.
        """
        greedy = learner.replaced({"epsilon": 0.0})
        for name, value in greedy.settings().items():
            if callable(value):
                raise ValueError(f"the policy of {learner.name} needs a number for {name}, which is a schedule")
        prepared, words = greedy.prepare(env), (jnp.uint32(0),) * greedy.num_begin_words
        context = outside_of_training(jnp.uint32(0))

        def choose(tables: Any, state: Any) -> Any:
            return greedy.action(greedy.begin(prepared, tables, state, words, context))

        self._tables, self._choose = tables, jax.jit(choose)

    def reset(self) -> None:
        """Begins an episode; there is nothing to forget."""

    def __call__(self, state: Any) -> int:
        """The action (its number) in a state of the environment."""
        return int(self._choose(self._tables, state))


def _settings(env: Any, learner: Learner) -> dict[str, Any]:
    """What tables belong to, as JSON has it."""
    settings: dict[str, Any] = {}
    for name, value in learner.settings().items():
        if isinstance(value, Hierarchy):
            settings[name] = {"hierarchy": hierarchy_digest(env, value)}
        elif isinstance(value, Options):
            settings[name] = {"options": options_digest(value)}
        elif callable(value):
            settings[name] = {"schedule": as_attribute(value)}
        elif dataclasses.is_dataclass(value):
            settings[name] = {"fields": dataclasses.asdict(value)}  # type: ignore[arg-type]
        else:
            settings[name] = value if value is None or isinstance(value, bool) else as_attribute(value)
    return {
        "environment": env.name,
        "options": {name: _plain(value) for name, value in options(env).items()},
        "learner": type(learner).__name__,
        "settings": settings,
    }


def _plain(value: Any) -> Any:
    """An environment's option as JSON has it; `_option` is the way back."""
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return value if value is None or isinstance(value, int | float) else str(value)


def _option(value: Any) -> Any:
    return tuple(_option(entry) for entry in value) if isinstance(value, list) else value


def _flat(header: dict[str, Any]) -> dict[str, Any]:
    settings = {f"learner.{name}": value for name, value in header["settings"].items()}
    own = {env_name(name): value for name, value in header["options"].items()}
    return {"environment": header["environment"], "learner": header["learner"], **own, **settings}


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    content = io.BytesIO(path.read_bytes())
    try:
        with np.load(content, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        header = json.loads(arrays.pop(_HEADER).tobytes())
        found = header["format"], header["version"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is damaged or was not written by hrljax: {error}") from error
    if found != (_FORMAT, _VERSION):
        raise ValueError(f"{path} is {found[0]!r} of version {found[1]}; known is {_FORMAT!r} of version {_VERSION}")
    return header, arrays


def _learner(env: Any, header: dict[str, Any], where: str) -> Learner:
    """The learner that a header describes."""
    settings: dict[str, Any] = {}
    for name, value in header["settings"].items():
        for kind, what in (("schedule", f"{name} as a schedule"), ("options", "options")):
            if isinstance(value, dict) and kind in value:
                raise ValueError(f"{where} with {what}, which files do not hold; give the learner")
        if isinstance(value, dict) and "hierarchy" in value:
            if value != {"hierarchy": hierarchy_digest(env, env.hierarchy())}:
                raise ValueError(f"{where} with another hierarchy than {env.name}'s own; give the learner")
            value = env.hierarchy()
        settings[name] = value
    return _built(Learner, header["learner"], settings, where)


def _built(base: type[Any], name: str, settings: Mapping[str, Any], where: str) -> Any:
    """An object of the subclass of `base` with a name, from settings as `Settings.settings` gives them."""
    classes = {cls.__name__: cls for cls in _subclasses(base)}
    if name not in classes:
        raise ValueError(f"{where} by {name!r}, which is not known; import it or give the learner")
    own: dict[str, Any] = {}
    for key, value in settings.items():
        if "." in key or key not in classes[name].__dataclass_fields__:
            continue
        nested = {k.removeprefix(f"{key}."): v for k, v in settings.items() if k.startswith(f"{key}.")}
        is_settings = isinstance(value, str) and value in {cls.__name__ for cls in _subclasses(Settings)}
        own[key] = _built(Settings, value, nested, where) if is_settings else value
        if isinstance(value, dict):  # of the class of the default value
            own[key] = type(classes[name].__dataclass_fields__[key].default)(**value["fields"])
    fields = classes[name].__dataclass_fields__
    return classes[name](**{key: value for key, value in own.items() if fields[key].init})


def _subclasses(base: type[Any]) -> list[type[Any]]:
    found = [base]
    for cls in found:
        found += cls.__subclasses__()
    return found
