"""Levels in the form in which the engine reads them."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import take
from hrljax.envs.mario.engine.state import World, new_player, no_sprites
from hrljax.envs.mario.levels.level import Level, stack_levels
from hrljax.envs.mario.levels.tiles import HEIGHT

_KIND_BITS, _ROW_BITS = 5, 4


class Course(NamedTuple):
    """`N` levels of one width `W`: what does not change in play. Templates are in order of column, then row."""

    tiles: Array | np.ndarray  # [N, W * 15] uint8: the tiles at the start
    templates: Array | np.ndarray  # [N * K] int32: column << 9 | row << 5 | kind and wings
    first_template: Array | np.ndarray  # [N * (W + 1)] int32: number of templates left of a column
    exit_column: Array | np.ndarray  # [N] int32

    @property
    def num_levels(self) -> int:
        return self.tiles.shape[0]

    @property
    def num_columns(self) -> int:
        return self.tiles.shape[1] // HEIGHT

    @property
    def num_templates(self) -> int:
        """Places for templates of one level, at least 1."""
        return self.templates.shape[0] // self.num_levels


class Template(NamedTuple):
    """Where a monster appears; int32 scalars."""

    column: Array
    row: Array
    spawn: Array  # kind, + 16 with wings


def make_course(*levels: Level) -> Course:
    """The course of some levels of one width (on the host).

    Raises:
        ValueError: no levels, or levels of different widths.
    """
    stacked = stack_levels(list(levels))
    spawns = np.asarray(stacked.spawns)
    num_levels, width = spawns.shape[:2]
    most = max(1, int(np.count_nonzero(spawns, axis=(1, 2)).max()))
    templates = np.zeros((num_levels, most), np.int32)
    first = np.zeros((num_levels, width + 1), np.int32)
    for i, cells in enumerate(spawns):
        columns, rows = np.nonzero(cells)
        templates[i, : len(columns)] = (
            columns << (_KIND_BITS + _ROW_BITS) | rows << _KIND_BITS | cells[columns, rows].astype(np.int32)
        )
        first[i, 1:] = np.cumsum(np.count_nonzero(cells, axis=1))
    return Course(
        tiles=np.asarray(stacked.tiles).reshape(num_levels, -1),
        templates=templates.ravel(),
        first_template=first.ravel(),
        exit_column=np.asarray(stacked.exit_column, np.int32),
    )


def template_word(course: Course, level: Array, index: Array) -> Array:
    """Template `index` of a level, packed."""
    return take(jnp.asarray(course.templates), level * np.int32(course.num_templates) + index)


def unpack_template(word: Array) -> Template:
    """The parts of a packed template."""
    return Template(
        column=word >> np.int32(_KIND_BITS + _ROW_BITS),
        row=(word >> np.int32(_KIND_BITS)) & np.int32((1 << _ROW_BITS) - 1),
        spawn=word & np.int32((1 << _KIND_BITS) - 1),
    )


def templates_left_of(course: Course, level: Array, column: Array) -> Array:
    """How many templates of a level stand left of `column`, which may lie outside of the level."""
    column = lax.clamp(jnp.int32(0), column, jnp.int32(course.num_columns))
    return take(jnp.asarray(course.first_template), level * np.int32(course.num_columns + 1) + column)


def start(course: Course, level: Array | int = 0, large: Array | bool = False, fire: Array | bool = False) -> World:
    """A game before its first tick.

    Args:
        course: the levels.
        level: index of a level (int32).
        large: Mario begins large.
        fire: Mario begins with fire; he is then large too.
    """
    level = jnp.asarray(level, jnp.int32)
    size = course.tiles.shape[1]
    zero, nowhere = jnp.int32(0), jnp.int32(-2)
    return World(
        player=new_player(jnp.asarray(large, bool) | jnp.asarray(fire, bool), fire),
        sprites=no_sprites(),
        num_sprites=zero,
        tiles=lax.dynamic_slice(jnp.asarray(course.tiles), (level, zero), (1, size)).reshape(size),
        template_states=jnp.zeros(course.num_templates, jnp.uint8),
        window_first=nowhere,
        window_last=nowhere,
        camera=jnp.float32(0),
        paused=jnp.bool_(False),
        active_ticks=zero,
        coins=zero,
        kills=zero,
        fireballs_on_screen=zero,
        num_created=zero,
        overflow=jnp.bool_(False),
        level=level,
    )
