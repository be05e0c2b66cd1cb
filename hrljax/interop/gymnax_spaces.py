"""gymnax's spaces, or stand-ins for them where gymnax is not installed."""

from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike, DTypeLike

Element: TypeAlias = Any
"""What is in a space: an array, or a dictionary or a tuple of elements."""


class Space(Protocol):
    """One of gymnax's spaces."""

    def sample(self, key: Array) -> Element: ...
    def contains(self, x: Element) -> Array: ...


@dataclass(frozen=True)
class Discrete:
    """Integers from 0 to ``n - 1``."""

    n: int
    shape: tuple[int, ...] = ()
    dtype: DTypeLike = jnp.int32

    def sample(self, key: Array) -> Array:
        """A uniformly random element."""
        return jax.random.randint(key, self.shape, 0, self.n, self.dtype)

    def contains(self, x: Element) -> Array:
        """Whether `x` is an element (bool)."""
        return (jnp.asarray(x) >= 0) & (jnp.asarray(x) < self.n)


@dataclass(frozen=True, eq=False)
class Box:
    """Arrays of one shape with bounds."""

    low: ArrayLike
    high: ArrayLike
    shape: tuple[int, ...]
    dtype: DTypeLike = jnp.float32

    def sample(self, key: Array) -> Array:
        """A uniformly random element."""
        low, high = (jnp.broadcast_to(jnp.asarray(bound, jnp.float32), self.shape) for bound in (self.low, self.high))
        return (low + jax.random.uniform(key, self.shape) * (high - low)).astype(self.dtype)

    def contains(self, x: Element) -> Array:
        """Whether `x` lies within the bounds (bool)."""
        return jnp.all(jnp.asarray(x) >= self.low) & jnp.all(jnp.asarray(x) <= self.high)


@dataclass(frozen=True, eq=False)
class Dict:
    """Named spaces."""

    spaces: dict[str, Space]

    def sample(self, key: Array) -> dict[str, Element]:
        """A uniformly random element."""
        keys = jax.random.split(key, len(self.spaces))
        return {name: space.sample(keys[i]) for i, (name, space) in enumerate(self.spaces.items())}

    def contains(self, x: Element) -> Array:
        """Whether every part of `x` is in its space (bool)."""
        return jnp.all(jnp.array([space.contains(x[name]) for name, space in self.spaces.items()]))


@dataclass(frozen=True, eq=False)
class Tuple:
    """Several spaces."""

    spaces: tuple[Space, ...]

    def sample(self, key: Array) -> tuple[Element, ...]:
        """A uniformly random element."""
        keys = jax.random.split(key, len(self.spaces))
        return tuple(space.sample(keys[i]) for i, space in enumerate(self.spaces))

    def contains(self, x: Element) -> Array:
        """Whether every part of `x` is in its space (bool)."""
        return jnp.all(jnp.array([space.contains(part) for space, part in zip(self.spaces, x, strict=True)]))


class _StandIns:
    Discrete, Box, Dict, Tuple = Discrete, Box, Dict, Tuple


def _spaces() -> type[_StandIns]:
    try:
        from gymnax.environments import spaces  # type: ignore[import-not-found]
    except ImportError:
        return _StandIns
    return spaces


def box_of_ones(size: int) -> Space:
    """The space of one-hot vectors of `size` entries, as a Box of float32."""
    return _spaces().Box(0.0, 1.0, (size,), jnp.float32)


def gymnax_space(space: gymnasium.Space[Any]) -> Space:
    """gymnax's counterpart of a Gymnasium space; MultiDiscrete and MultiBinary become Boxes.

    Raises:
        TypeError: gymnax has no such space.
    """
    kinds = _spaces()
    if isinstance(space, gymnasium.spaces.Discrete) and space.start == 0:
        return kinds.Discrete(int(space.n))
    if isinstance(space, gymnasium.spaces.Box):
        return kinds.Box(_bound(space.low), _bound(space.high), space.shape, space.dtype)
    if isinstance(space, gymnasium.spaces.MultiBinary):
        return kinds.Box(0, 1, space.shape, space.dtype)
    if isinstance(space, gymnasium.spaces.MultiDiscrete):
        return kinds.Box(jnp.asarray(space.start), jnp.asarray(space.start + space.nvec - 1), space.shape, jnp.int32)
    if isinstance(space, gymnasium.spaces.Dict):
        return kinds.Dict({name: gymnax_space(inner) for name, inner in space.spaces.items()})
    if isinstance(space, gymnasium.spaces.Tuple):
        return kinds.Tuple(tuple(gymnax_space(inner) for inner in space.spaces))
    raise TypeError(f"gymnax has no counterpart of the space {space}")


def _bound(bound: np.ndarray) -> ArrayLike:
    """A bound that is one number for all entries as that number: what gymnax's own environments have."""
    return bound.flat[0].item() if bound.size and (bound == bound.flat[0]).all() else jnp.asarray(bound)
