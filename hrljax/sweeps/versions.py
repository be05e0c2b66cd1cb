"""Versions of the packages that computed something; several sets of them where a store was continued under others."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

Attributes: TypeAlias = dict[str, Any]
"""What datasets and stores say of themselves, by name: text and numbers, as JSON gives them back."""
Versions = Mapping[str, str]
"""By the name of a package."""
ComputedBy = Sequence[tuple[int, Versions]]
"""For consecutive runs: how many, and the versions that computed them."""

_PACKAGES = ("hrljax", "jax", "jaxlib", "numpy", "xarray")
COMPUTING = ("hrljax", "jax", "jaxlib")
"""Packages whose version a number may depend on."""
PREFIX = "version."
_SETS = "versions"


@cache
def installed() -> Versions:
    """The versions of this process; to look them up takes milliseconds."""
    return {package: version(package) for package in _PACKAGES}


def from_attributes(attributes: Attributes) -> list[Versions]:
    """The sets of versions that attributes tell of."""
    if _SETS in attributes:
        return json.loads(attributes[_SETS])
    one = {name.removeprefix(PREFIX): value for name, value in attributes.items() if name.startswith(PREFIX)}
    return [one] if one else []


def are_recorded_by(name: str) -> bool:
    """Whether versions are in the attribute with a name."""
    return name == _SETS or name.startswith(PREFIX)


def as_attributes(sets: Sequence[Versions]) -> dict[str, str]:
    """Attributes with all versions of each package, and with the sets if there are several."""
    packages = dict.fromkeys(package for versions in sets for package in versions)
    joined = {
        PREFIX + package: ", ".join(dict.fromkeys(versions[package] for versions in sets if package in versions))
        for package in packages
    }
    return {**joined, _SETS: json.dumps([dict(versions) for versions in sets])} if len(sets) > 1 else joined


def recorded(attributes: Attributes, sets: Sequence[Versions]) -> Attributes:
    """The attributes, with these sets of versions in place of those that they tell of."""
    return {**{name: value for name, value in attributes.items() if name != _SETS}, **as_attributes(sets)}


class VersionsOfRuns:
    """Which versions computed each run."""

    def __init__(self, num_runs: int, sets: Sequence[Versions]):
        self.sets = list(sets)
        self._number = np.full(num_runs, -1)  # [runs] of the set, -1 if not known

    def put(self, first: int, computed_by: ComputedBy) -> None:
        """Says what computed the runs from the first one on."""
        for count, versions in computed_by:
            self._number[first : first + count] = self.add(versions)
            first += count

    def add(self, versions: Versions) -> int:
        """The number of a set, which is new or not."""
        if versions not in self.sets:
            self.sets.append(versions)
        return self.sets.index(versions)

    def keep_used(self) -> None:
        """Forgets sets that computed none of the runs."""
        used = np.unique(self._number[self._number >= 0])
        self.sets = [self.sets[number] for number in used]
        self._number = np.where(self._number < 0, -1, np.searchsorted(used, self._number))

    def record_in(self, dataset: xr.Dataset) -> xr.Dataset:
        """Sets the versions' attributes; where there are several sets, a variable tells which computed what."""
        dataset.attrs = recorded(dataset.attrs, self.sets)
        if len(self.sets) < 2 or (self._number < 0).all():
            return dataset
        steps = dataset["steps"]
        description = {"long_name": f"number of the set in the attribute {_SETS!r}, -1 if unfinished"}
        return dataset.assign(version_set=(steps.dims, self._number.reshape(steps.shape), description))
