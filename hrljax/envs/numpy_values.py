"""Values of the environments in the types that Gymnasium expects: Python numbers, and NumPy arrays as copies."""

from typing import Any, TypeVar

import jax
import numpy as np
from gymnasium import spaces

from hrljax.envs.base import AnyEnvironment

T = TypeVar("T")

METADATA = {"render_modes": ["ansi", "rgb_array"], "render_fps": 4}

_WIDE = {"b": np.bool_, "i": np.int64, "u": np.int64, "f": np.float64}


def metadata_of(env: AnyEnvironment) -> dict[str, Any]:
    """`METADATA` with the render modes that `env` has."""
    return {**METADATA, "render_modes": list(env.render_modes)}


def as_element(space: spaces.Space[Any], value: Any) -> Any:
    """An observation (a pytree of arrays) as what `space` contains; NamedTuples may be elements of a Dict."""
    if isinstance(space, spaces.Dict):
        fields = value._asdict() if hasattr(value, "_asdict") else value
        return {name: as_element(inner, fields[name]) for name, inner in space.spaces.items()}
    if isinstance(space, spaces.Tuple):
        return tuple(as_element(inner, part) for inner, part in zip(space.spaces, value, strict=True))
    array = np.array(value, space.dtype)
    return array[()] if isinstance(space, spaces.Discrete) else array


def as_python(value: np.ndarray) -> bool | int | float | np.ndarray:
    """A scalar as a Python number, an array as a copy."""
    return value.item() if np.ndim(value) == 0 else np.array(value)


def widened(values: np.ndarray) -> np.ndarray:
    """Values of a batch in the dtype that Gymnasium gives to Python numbers."""
    return np.array(values, _WIDE[values.dtype.kind])


def entry(batch: T, index: int) -> T:
    """One entry of a pytree of batched arrays."""
    return jax.tree.map(lambda leaf: leaf[index], batch)
