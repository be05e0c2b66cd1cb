"""Pictures of the platformer: the screen, a whole level.

Needs Pillow, but neither a display nor ffmpeg. The drawings are our own (`render_tiles`, `render_figures`). Blocks
show what they hide: a coin, or an arrow for a power-up.
"""

from functools import lru_cache

import jax
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from hrljax.core import checks
from hrljax.envs.mario.drawing.figures import ANCHOR, Pose, figure_image
from hrljax.envs.mario.drawing.pen import INK
from hrljax.envs.mario.drawing.tiles import LOOKS, tile_image
from hrljax.envs.mario.engine.course import Course
from hrljax.envs.mario.engine.state import DEAD, FLOWER, FLYING, MUSHROOM, SHELL, Sprites, World
from hrljax.envs.mario.engine.state import WINGED as WINGED_FLAG
from hrljax.envs.mario.levels.ground import level_type_of
from hrljax.envs.mario.levels.level import KIND_MASK, PIRANHA, SCREEN_WIDTH, WINGED, Level, check_level
from hrljax.envs.mario.levels.tiles import HEIGHT, HILL_BODIES, HILL_TOPS, HILL_TOPS_JOINED, TILE

_SCREEN_HEIGHT = HEIGHT * TILE
_HILLS = np.array([*HILL_TOPS, *HILL_TOPS_JOINED, *HILL_BODIES])
_BEHIND_TILES = (PIRANHA, MUSHROOM, FLOWER)
"""Kinds that come out of tiles."""
_RULER = 14
_STATUS = 13
_FLAG = 16 * 5
"""Height of the flag from the top: below every ceiling."""


def screen(
    course: Course,
    world: World,
    tile_pixels: int = 32,
    status: bool = True,
    columns: tuple[int, int] | None = None,
) -> np.ndarray:
    """What the camera sees, or another part of the level with what moves in it.

    Args:
        course: the levels.
        world: one game (not a batch).
        tile_pixels: points per tile of the picture, at least 4; 32 gives 640 x 480.
        status: write coins, kills and the place into the upper edge.
        columns: the first column of the part and the one after its last; what the camera sees if not given.

    Returns:
        ``[15 * tile_pixels, columns * tile_pixels, 3]`` uint8; 20 columns of what the camera sees.

    Raises:
        ValueError: `tile_pixels` is too small, there are no such columns, or `world` is a batch.
    """
    _check_tile_pixels(tile_pixels)
    if columns is not None and not 0 <= columns[0] < columns[1] <= course.num_columns:
        raise ValueError(f"columns must be two of 0..{course.num_columns}, the first one less, got {columns}")
    world = jax.device_get(world)
    if np.ndim(world.player.x) != 0:
        raise ValueError(f"world must be one game, got a batch of shape {list(np.shape(world.player.x))}")
    tiles = np.asarray(world.tiles).reshape(-1, HEIGHT)
    first, last = columns or (0, SCREEN_WIDTH // TILE)
    left = float(world.camera) if columns is None else float(first * TILE)
    picture = _Picture(tiles, left, (last - first) * TILE, tile_pixels)
    sprites = _poses(world.sprites, int(world.num_sprites))
    picture.tiles(behind=True)
    picture.exit(int(np.asarray(course.exit_column)[int(world.level)]))
    for place, pose in sprites:
        if pose.kind in _BEHIND_TILES and not pose.dead:
            picture.figure(*place, pose)
    picture.tiles(behind=False)
    for place, pose in sprites:
        if pose.kind not in _BEHIND_TILES or pose.dead:
            picture.figure(*place, pose)
    picture.figure(float(world.player.x), float(world.player.y), _mario_pose(world))
    if status:
        picture.write(_status(world), level_type_of(tiles))
    return np.array(picture.image.convert("RGB"))


def level_strip(
    level: Level, tile_pixels: int = 16, columns: int | None = None, track: np.ndarray | None = None
) -> np.ndarray:
    """A whole level with its monsters where they appear, its exit, and a ruler of columns below.

    Args:
        level: one level.
        tile_pixels: points per tile, at least 4.
        columns: tiles in a row of the picture; rows are put below each other. All in one row if not given.
        track: ``[T, 2]`` places (x, y) in the game's pixels, drawn as a line: where Mario went.

    Returns:
        ``[H, W, 3]`` uint8.

    Raises:
        ValueError: `level` does not pass `check_level`, `tile_pixels` is under 4 or `columns` under 1.
    """
    _check_tile_pixels(tile_pixels)
    level = check_level(level)
    if columns is not None:
        checks.integer("columns", columns, 1)
    per_row = min(columns or level.num_columns, level.num_columns)
    rows = []
    for first in range(0, level.num_columns, per_row):
        picture = _Picture(level.tiles, float(first * TILE), per_row * TILE, tile_pixels)
        picture.tiles(behind=True)
        picture.exit(int(level.exit_column))
        monsters = [(*_spawn_place(x, y, int(level.spawns[x, y])), _spawn_pose(int(level.spawns[x, y])))
                    for x, y in np.argwhere(level.spawns).tolist()]  # fmt: skip
        for x, y, pose in monsters:
            if pose.kind == PIRANHA:
                picture.figure(x, y, pose)
        picture.tiles(behind=False)
        for x, y, pose in monsters:
            if pose.kind != PIRANHA:
                picture.figure(x, y, pose)
        if track is not None:
            picture.track(track)
        picture.blank_right_of(level.num_columns)
        rows += [np.asarray(picture.image.convert("RGB")), _ruler(first, per_row, level.num_columns, tile_pixels)]
    return np.concatenate(rows)


class _Picture:
    """A part of a level while it is drawn; `left` and `width` in the game's pixels."""

    def __init__(self, tiles: np.ndarray, left: float, width: int, tile_pixels: int):
        self._tiles = tiles
        self._scale = tile_pixels / TILE
        self._tile_pixels = tile_pixels
        self._left = round(left * self._scale)
        size = (round(width * self._scale), round(_SCREEN_HEIGHT * self._scale))
        self.image = _sky(level_type_of(tiles), *size).copy()

    def tiles(self, behind: bool) -> None:
        """Pastes the hills (`behind`) or everything else."""
        first = self._left // self._tile_pixels
        last = (self._left + self.image.width - 1) // self._tile_pixels
        part = self._tiles[first : last + 1]
        chosen = (part != 0) & (np.isin(part, _HILLS) == behind)
        for column, row in np.argwhere(chosen).tolist():
            drawing = tile_image(int(part[column, row]), self._tile_pixels)
            if drawing is not None:
                self._paste(drawing, (first + column) * self._tile_pixels, row * self._tile_pixels)

    def figure(self, x: float, y: float, pose: Pose) -> None:
        """Puts a figure's foot at (x, y) of the game."""
        drawing = figure_image(pose, self._tile_pixels)
        left, top = round((x - ANCHOR[0]) * self._scale), round((y + 1 - ANCHOR[1]) * self._scale)
        self._paste(drawing, left, top)

    def exit(self, column: int) -> None:
        """A pole with a chequered flag on the left border of a column."""
        draw, unit = ImageDraw.Draw(self.image), self._scale
        x = column * self._tile_pixels - self._left
        top = _FLAG * unit
        draw.rectangle((x - unit, top, x + unit, self.image.height), "#F2F2F2", INK)
        for i in range(4):
            for j in range(3):
                left, upper = x + (1 + 5 * i) * unit, top + (2 + 5 * j) * unit
                box = (left, upper, left + 5 * unit, upper + 5 * unit)
                draw.rectangle(box, INK if (i + j) % 2 else "#FFFFFF")
        draw.ellipse((x - 3 * unit, top - 5 * unit, x + 3 * unit, top + unit), "#F0E442", INK)

    def track(self, places: np.ndarray) -> None:
        """A line through places of the game, at the height of Mario's middle."""
        points = [(x * self._scale - self._left, (y - 6) * self._scale) for x, y in np.asarray(places).tolist()]
        ImageDraw.Draw(self.image).line(points, "#D55E00", max(1, round(2 * self._scale)), joint="curve")

    def blank_right_of(self, column: int) -> None:
        """Whitens what lies to the right of the level."""
        edge = column * self._tile_pixels - self._left
        if edge < self.image.width:
            self.image.paste("#FFFFFF", (edge, 0, *self.image.size))

    def write(self, text: str, level_type: int) -> None:
        """Writes into the upper edge."""
        draw = ImageDraw.Draw(self.image)
        colour = INK if level_type == 0 else "#FFFFFF"
        font = _font(round(_STATUS * 0.75 * self._scale))
        draw.text((5 * self._scale, 2 * self._scale), text, fill=colour, font=font)

    def _paste(self, drawing: Image.Image, left: int, top: int) -> None:
        self.image.paste(drawing, (left - self._left, top), drawing)


@lru_cache(maxsize=8)
def _sky(level_type: int, width: int, height: int) -> Image.Image:
    """A background that grows lighter downwards."""
    look = LOOKS[level_type]
    column = Image.new("RGB", (1, 2))
    column.putpixel((0, 0), tuple(bytes.fromhex(look.sky[1:])))
    column.putpixel((0, 1), tuple(bytes.fromhex(look.sky_low[1:])))
    return column.resize((width, height), Image.Resampling.BILINEAR)


@lru_cache(maxsize=8)
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(max(6, size))


def _check_tile_pixels(tile_pixels: int) -> None:
    checks.integer("tile_pixels", tile_pixels, 4)


def _poses(sprites: Sprites, count: int) -> list[tuple[tuple[float, float], Pose]]:
    """Where the sprites are and how they look, oldest first."""
    shown = []
    for i in range(count):
        kind, flags, x = int(sprites.kind[i]), int(sprites.flags[i]), float(sprites.x[i])
        thrown = bool(flags & (FLYING | DEAD))
        pose = Pose(
            kind,
            size=int(sprites.aux[i]) if kind == SHELL else 0,
            winged=bool(flags & WINGED_FLAG),
            left=int(sprites.facing[i]) < 0,
            step=int(x / 6) % 2 if kind != PIRANHA else int(sprites.y[i] / 4) % 2,
            dead=thrown,
            squashed=int(sprites.dead_time[i]) > 0 and not thrown,
        )
        shown.append(((x, float(sprites.y[i])), pose))
    return shown


def _mario_pose(world: World) -> Pose:
    player = world.player
    return Pose(
        0,
        size=2 if player.large and player.fire else int(player.large),
        left=int(player.facing) < 0,
        step=int(float(player.x) / 8) % 2,
        aloft=not player.on_ground,
        dead=int(player.death_time) > 0,
    )


def _status(world: World) -> str:
    where = f"coins {int(world.coins)}   kills {int(world.kills)}   x {float(world.player.x) / TILE:.1f}"
    if int(world.player.win_time) > 0:
        return where + "   won"
    return where + ("   lost" if int(world.player.death_time) > 0 else "")


def _spawn_place(column: int, row: int, spawn: int) -> tuple[float, float]:
    """Where a monster is drawn that has not appeared yet; plants as they look out of their pipe."""
    if spawn & KIND_MASK == PIRANHA:
        return column * TILE + 15.0, row * TILE - 1.0
    return column * TILE + 8.0, row * TILE + 15.0


def _spawn_pose(spawn: int) -> Pose:
    return Pose(spawn & KIND_MASK, winged=bool(spawn & WINGED), left=True)


def _ruler(first: int, count: int, num_columns: int, tile_pixels: int) -> np.ndarray:
    """``[h, W, 3]`` uint8: marks under every column, numbers under every tenth."""
    height = max(10, round(_RULER * tile_pixels / TILE))
    image = Image.new("RGB", (count * tile_pixels, height), "#FFFFFF")
    draw, font = ImageDraw.Draw(image), _font(round(height * 0.7))
    for column in range(first, min(first + count, num_columns)):
        x, tenth = (column - first) * tile_pixels, column % 10 == 0
        draw.line((x, 0, x, height // 2 if tenth else height // 5), fill=INK)
        if tenth:
            draw.text((x + 3, height * 0.15), str(column), fill=INK, font=font)
    return np.asarray(image)
