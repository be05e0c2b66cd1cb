"""Files of what was learned: the tables, and in a header as JSON the environment and learner that they belong to."""

import dataclasses
import io
import json
import zipfile
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np

from hrljax.core.files import write_atomically
from hrljax.envs.base import AnyEnvironment, TabularEnvironment
from hrljax.envs.registry import make, registered
from hrljax.hierarchy.definition import Hierarchy
from hrljax.learners.base import AnyLearner, Learner
from hrljax.learners.hyperparameters import Settings
from hrljax.learners.options.definition import Options
from hrljax.sweeps.axes import env_name
from hrljax.sweeps.fingerprint import as_attribute, differences, hierarchy_digest, options, options_digest
from hrljax.sweeps.versions import Attributes

Header: TypeAlias = Attributes
"""Which environment and learner, their settings, names of the tables, episodes and steps."""
Tables: TypeAlias = dict[str, np.ndarray]
"""The leaves of a learner's tables by name."""
Kind = TypeVar("Kind", bound=Settings)

_FORMAT, _VERSION = "hrljax learned", 1
_HEADER = "header"


def write(path: Path, env: AnyEnvironment, learner: AnyLearner, tables: Tables, episodes: int, steps: int) -> None:
    """Writes a file, whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    header = {
        "format": _FORMAT,
        "version": _VERSION,
        "hrljax": version("hrljax"),
        **_settings(env, learner),
        "tables": sorted(tables),
        "episodes": episodes,
        "steps": steps,
    }
    arrays: dict[str, Any] = {_HEADER: np.frombuffer(json.dumps(header).encode(), np.uint8), **tables}
    content = io.BytesIO()
    np.savez(content, **arrays)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.getvalue())


def read(path: Path) -> tuple[Header, Tables]:
    """Reads a file.

    Raises:
        FileNotFoundError: there is no file.
        ValueError: it is damaged, no such file, or of a version that is not known.
    """
    content = io.BytesIO(path.read_bytes())
    try:
        with np.load(content, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        header = json.loads(arrays.pop(_HEADER).tobytes())
        name, number = header["format"], header["version"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is damaged or was not written by hrljax: {error}") from error
    if (name, number) != (_FORMAT, _VERSION):
        raise ValueError(f"{path} is {name!r} of version {number}; known is {_FORMAT!r} of version {_VERSION}")
    return header, arrays


def owners(
    path: Path, header: Header, env: AnyEnvironment | None, learner: AnyLearner | None
) -> tuple[AnyEnvironment, AnyLearner]:
    """The environment and the learner that tables belong to: those that are given, else those that the header tells of.

    Raises:
        ValueError: the header does not tell enough, or tells of others than those that are given.
    """
    where = f"{path} holds what was learned"
    if env is None:
        name = header["environment"]
        if name not in registered():
            raise ValueError(f"{where} on {name!r}, which is not registered; give it as env")
        env = make(name, **{option: _option(value) for option, value in header["options"].items()})
    assert env is not None
    learner = learner or _learner(env, header, where)
    expected = json.loads(json.dumps(_settings(env, learner)))
    wrong = differences(_flat({name: header[name] for name in expected}), _flat(expected))
    if wrong:
        raise ValueError(f"{where} with other settings: {'; '.join(wrong)}")
    return env, learner


def _settings(env: AnyEnvironment, learner: AnyLearner) -> Header:
    """What tables belong to, as JSON has it."""
    settings: Attributes = {}
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


def _plain(value: object) -> object:
    """An environment's option as JSON has it; `_option` is the way back."""
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return value if value is None or isinstance(value, int | float) else str(value)


def _option(value: object) -> object:
    """An environment's option, from what JSON has."""
    return tuple(_option(entry) for entry in value) if isinstance(value, list) else value


def _flat(header: Header) -> Attributes:
    """The settings in a header, each by a name of its own."""
    settings = {f"learner.{name}": value for name, value in header["settings"].items()}
    of_env = {env_name(name): value for name, value in header["options"].items()}
    return {"environment": header["environment"], "learner": header["learner"], **of_env, **settings}


def _learner(env: AnyEnvironment, header: Header, where: str) -> AnyLearner:
    """The learner that a header describes."""
    settings: Attributes = {}
    for name, value in header["settings"].items():
        for kind, what in (("schedule", f"{name} as a schedule"), ("options", "options")):
            if isinstance(value, dict) and kind in value:
                raise ValueError(f"{where} with {what}, which files do not hold; give the learner")
        if isinstance(value, dict) and "hierarchy" in value:
            hierarchy = env.hierarchy() if isinstance(env, TabularEnvironment) else None
            if hierarchy is None or value != {"hierarchy": hierarchy_digest(env, hierarchy)}:
                raise ValueError(f"{where} with another hierarchy than {env.name}'s own; give the learner")
            value = hierarchy
        settings[name] = value
    return _built(Learner, header["learner"], settings, where)


def _built(base: type[Kind], name: str, settings: Attributes, where: str) -> Kind:
    """An object of the subclass of `base` with a name, from settings as `Settings.settings` gives them."""
    classes = {cls.__name__: cls for cls in _subclasses(base)}
    if name not in classes:
        raise ValueError(f"{where} by {name!r}, which is not known; import it or give the learner")
    arguments: Attributes = {}
    for key, value in settings.items():
        if "." in key or key not in classes[name].__dataclass_fields__:
            continue
        nested = {k.removeprefix(f"{key}."): v for k, v in settings.items() if k.startswith(f"{key}.")}
        is_settings = isinstance(value, str) and value in {cls.__name__ for cls in _subclasses(Settings)}
        arguments[key] = _built(Settings, value, nested, where) if is_settings else value
        if isinstance(value, dict):  # of the class of the default value
            arguments[key] = type(classes[name].__dataclass_fields__[key].default)(**value["fields"])
    fields = classes[name].__dataclass_fields__
    return classes[name](**{key: value for key, value in arguments.items() if fields[key].init})


def _subclasses(base: type[Kind]) -> list[type[Kind]]:
    """The class and all that extend it."""
    classes = [base]
    for cls in classes:
        classes += cls.__subclasses__()
    return classes
