"""Concepts that hold at a moment of Mario, numbered: what a relational learner has weights for."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.numerics import put_row
from hrljax.envs.mario.competition import Episode
from hrljax.envs.mario.engine.state import MAX_SPRITES
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.features import NUM_OBJECT_CELLS, object_cells, objects
from hrljax.envs.mario.levels.tiles import HEIGHT
from hrljax.envs.mario.nearby import REACH_LEFT, REACH_RIGHT, nearest

Concepts = tuple[Array, Array]
"""Numbers of the concepts that hold (int32, those that do first) and how many they are (int32)."""


@runtime_checkable
class ConceptSet(Protocol):
    """Which concepts there are. Hashable, and pure."""

    @property
    def num(self) -> int:
        """How many there are."""
        ...

    @property
    def most(self) -> int:
        """How many hold at a time at most."""
        ...

    def held(self, env: Mario, episode: Episode) -> Concepts:
        """Those that hold now."""
        ...


@dataclass(frozen=True)
class ThingsOnScreen:
    """Every thing as its kind and its offset in whole tiles from Mario (thesis 4.2.4)."""

    num = NUM_OBJECT_CELLS
    most = MAX_SPRITES

    def held(self, env: Mario, episode: Episode) -> Concepts:
        seen = objects(episode.world.player, episode.world.sprites, episode.world.num_sprites)
        cells, listed = object_cells(seen), seen.mask

        def pack(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
            packed, count = carry
            return put_row(packed, count, cells[i][None]), count + listed[i].astype(jnp.int32)

        start = (jnp.zeros(len(cells) + 1, jnp.int32), jnp.int32(0))
        packed, count = lax.fori_loop(jnp.int32(0), episode.world.num_sprites, pack, start)
        return packed[: len(cells)], count


@dataclass(frozen=True)
class NearestThings:
    """Where the nearest monsters or pits are (Ringstad et al., as the thesis tells, 4.2.1).

    A concept says that the nearest of them, the second nearest and so on is a monster, or a pit, at an offset in tiles.

    Attributes:
        count: how many of them are looked at.
    """

    count: int = 3

    def __post_init__(self) -> None:
        checks.integer("count", self.count, 1)

    @property
    def num(self) -> int:
        return self.count * 2 * (REACH_LEFT + REACH_RIGHT + 1) * (2 * HEIGHT + 1)

    @property
    def most(self) -> int:
        return self.count

    def held(self, env: Mario, episode: Episode) -> Concepts:
        things = nearest(env.course, episode.world, self.count)
        columns, rows = np.int32(REACH_LEFT + REACH_RIGHT + 1), np.int32(2 * HEIGHT + 1)
        dy = jnp.clip(things.dy, -HEIGHT, HEIGHT) + np.int32(HEIGHT)
        kinds = jnp.arange(self.count, dtype=jnp.int32) * np.int32(2) + things.is_pit.astype(jnp.int32)
        # The nearest come first, so those that there are do too.
        return (kinds * columns + things.dx + np.int32(REACH_LEFT)) * rows + dy, jnp.sum(things.mask, dtype=jnp.int32)
