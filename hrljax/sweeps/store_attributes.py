"""What a store says of itself: which sweep it belongs to, how many seeds it has, and who may continue it."""

from __future__ import annotations

import contextlib
import hashlib
import json
from pathlib import Path

from hrljax.core.files import PARTIAL, with_reason
from hrljax.sweeps import chunk_file, versions
from hrljax.sweeps.descriptions import FIRST_VERSION, NEWEST_VERSION, ROOT
from hrljax.sweeps.fingerprint import differences
from hrljax.sweeps.job import STEPS
from hrljax.sweeps.schema import SEED
from hrljax.sweeps.versions import Attributes

FORMAT = {"store_format": "hrljax sweep", "store_version": NEWEST_VERSION}
CHUNK_SIZE, COMPLETE, SEEDS, SETTINGS, VERSION = "chunk_size", "complete", "seeds", "settings_digest", "store_version"
_START = "digest.start"


def new_attributes(settings: Attributes, chunk_size: int) -> Attributes:
    """The attributes of a new store.

    Args:
        settings: every setting of the sweep, and the versions of packages.
        chunk_size: most seeds of a chunk.
    """
    plain = json.loads(json.dumps({**settings}))
    digest = hashlib.sha256(json.dumps(_settings(plain), sort_keys=True).encode()).hexdigest()[:32]
    return {**FORMAT, **plain, SETTINGS: digest, CHUNK_SIZE: chunk_size, COMPLETE: 0}


def _is_setting(name: str) -> bool:
    """Whether an attribute tells sweeps apart."""
    return name not in (*FORMAT, CHUNK_SIZE, COMPLETE, SEEDS, SETTINGS) and not versions.are_recorded_by(name)


def _settings(attributes: Attributes) -> Attributes:
    return {name: value for name, value in attributes.items() if _is_setting(name)}


def chunk_size_of(path: str | Path, chunk_size: int | None) -> int | None:
    """The most seeds of a chunk of a store, if it is there and that is what is asked for; else what is asked for."""
    on_disk = attributes_on_disk(Path(path)) or {}
    if CHUNK_SIZE in on_disk and (chunk_size is None or min(chunk_size, on_disk[SEEDS]) == on_disk[CHUNK_SIZE]):
        return on_disk[CHUNK_SIZE]
    return chunk_size


def continued_attributes(path: Path, on_disk: Attributes, new: Attributes, allow_other_versions: bool) -> Attributes:
    """The attributes of a store that another call continues, maybe with more seeds.

    Args:
        path: the folder of the store.
        on_disk: what is there.
        new: what a new store of this call would have.
        allow_other_versions: whether what is there may have been computed under other versions.

    Raises:
        ValueError: there is a store of another sweep; the message says what differs.
    """
    if on_disk[VERSION] not in (FIRST_VERSION, NEWEST_VERSION):
        raise ValueError(f"the store {path} has version {on_disk[VERSION]} of the format, known are 1 and 2")
    same = on_disk.get(SETTINGS) == new[SETTINGS]
    if not same and not _settings(on_disk):
        raise ValueError(f"the store {path} has lost its {ROOT}, and its chunks belong to another sweep")
    wrong = [] if same else differences(_settings(on_disk), _settings(new))
    if not wrong and new[SEEDS] < on_disk[SEEDS]:
        raise ValueError(
            f"the store {path} has {on_disk[SEEDS]} seeds, more than seeds={new[SEEDS]}; "
            f"ask for seeds={on_disk[SEEDS]} and select some, as in dataset.sel(seed=slice({new[SEEDS] - 1}))"
        )
    wrong += differences({CHUNK_SIZE: on_disk[CHUNK_SIZE]}, {CHUNK_SIZE: new[CHUNK_SIZE]})
    packages = [versions.PREFIX + package for package in versions.COMPUTING if not allow_other_versions]
    other = differences({name: on_disk.get(name) for name in packages}, {name: new[name] for name in packages})
    if wrong or other:
        way_out = "" if wrong else "; allow_other_versions=True continues it nevertheless, and records both"
        if on_disk[SEEDS] != new[SEEDS] and {_START} <= {*on_disk} & {*new} and on_disk[_START] != new[_START]:
            way_out = f"; a store whose runs start from a dataset keeps its number of seeds, {on_disk[SEEDS]}"
        raise ValueError(f"the store {path} belongs to another sweep: {'; '.join(wrong + other)}{way_out}")
    others = {name: value for name, value in on_disk.items() if name == VERSION or name not in new}
    attributes = versions.recorded({**new, **others}, versions.from_attributes(on_disk))
    if new[SEEDS] == on_disk[SEEDS]:
        attributes[COMPLETE] = on_disk.get(COMPLETE, 0)
    return {name: value for name, value in attributes.items() if name != SETTINGS or name in on_disk}


def attributes_on_disk(path: Path) -> Attributes | None:
    """The attributes of a store, None if nothing is there yet.

    Where the file that holds them is lost or damaged, they are what labels of chunks tell: the
    digest of the settings, the versions, the size of chunks and a number of seeds.

    Raises:
        FileExistsError: there is something else, which is left alone.
        OSError: it cannot be read.
    """
    try:
        if path.is_dir() and all(entry.name.endswith(PARTIAL) for entry in path.iterdir()):
            return None
        content = (path / ROOT).read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        if not path.exists():
            return None
        content = b""
    except OSError as error:
        raise with_reason(error, path, "the store cannot be opened") from error
    root = parsed_root(content)
    if root is not None and is_of_a_sweep(root):
        return root["attributes"]
    recovered = None if root is not None else _attributes_from_labels(path)
    if recovered is not None:
        return recovered
    message = f"{path} exists and was not written by hrljax.sweep(store=...)"
    if root is None and has_lost_its_root(path):
        message = f"{path} has lost its {ROOT}, or it is damaged, and no chunk tells which sweep it belongs to"
    raise FileExistsError(f"{message}; it is left alone")


def is_of_a_sweep(root: Attributes) -> bool:
    """Whether a root's file is that of a sweep's store, and not of what somebody saved after loading one."""
    attributes = root.get("attributes")
    if not isinstance(attributes, dict) or attributes.get("store_format") != FORMAT["store_format"]:
        return False
    lists_arrays = isinstance(root.get("consolidated_metadata"), dict)  # some Zarrs write null where there is no list
    return lists_arrays and {VERSION, SEEDS, CHUNK_SIZE} <= set(attributes)


def parsed_root(content: bytes) -> Attributes | None:
    """What the root's file says, None if it is damaged."""
    try:
        root = json.loads(content)
    except ValueError:
        return None
    return root if isinstance(root, dict) else None


def has_lost_its_root(path: Path) -> bool:
    """Whether a folder without a readable root was the store of a sweep."""
    return all((path / name).is_dir() for name in (SEED, STEPS))


def _attributes_from_labels(path: Path) -> Attributes | None:
    """What intact chunk files tell of their store, None if that is nothing, or if they tell of several."""
    labels = []
    for file in sorted(path.glob("*/c/**/*")):
        with contextlib.suppress(ValueError):
            labels.append(chunk_file.label_of(file.read_bytes() if file.is_file() else b""))
    if len({(label.settings, label.chunk_size) for label in labels}) != 1:
        return None
    sets: list[versions.Versions] = []
    for label in labels:
        sets += [some for _, some in label.computed_by if some not in sets]
    seeds = max(label.first_seed + sum(count for count, _ in label.computed_by) for label in labels)
    known = {SETTINGS: labels[0].settings, CHUNK_SIZE: labels[0].chunk_size, SEEDS: seeds}
    return {**FORMAT, **known, **versions.as_attributes(sets)}
