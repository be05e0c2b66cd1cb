"""The drawings of tiles: our own, from simple shapes."""

from functools import lru_cache
from typing import NamedTuple

from PIL import Image

from hrljax.envs.mario.drawing.pen import GREEN, INK, ORANGE, WHITE, YELLOW, Pen
from hrljax.envs.mario.levels import tiles as t


class Look(NamedTuple):
    """Colours of a type of level."""

    sky: str
    sky_low: str
    ground: str
    speck: str
    edge: str
    rim: str


LOOKS = (
    Look(sky="#BFE0F5", sky_low="#EEF7FC", ground="#C9A26B", speck="#B88F58", edge="#5FA55A", rim="#3B7A3F"),
    Look(sky="#2C3550", sky_low="#3E4A6B", ground="#6D86A8", speck="#5F7898", edge="#9DB4D0", rim="#33425E"),
    Look(sky="#3A2F3B", sky_low="#564452", ground="#8C8791", speck="#7B7681", edge="#B9B4BF", rim="#47424D"),
)


@lru_cache(maxsize=1024)
def tile_image(tile: int, tile_pixels: int) -> Image.Image | None:
    """The drawing of a tile; None for the empty one."""
    if tile == t.EMPTY:
        return None
    pen = Pen(t.TILE, t.TILE)
    _draw_tile(pen, tile)
    return pen.at(tile_pixels)


def _draw_tile(pen: Pen, tile: int) -> None:
    for look, offset in zip(LOOKS, t.GROUND_OFFSETS, strict=True):
        if tile in t.ground_tiles(offset):
            _ground(pen, tile - offset, look)
            return
    if tile in (*t.HILL_TOPS, *t.HILL_TOPS_JOINED, *t.HILL_BODIES):
        _hill(pen, tile)
    elif tile in t.PIPE_MOUTH or tile in t.PIPE_BODY:
        _pipe(pen, tile)
    elif tile in (t.BRICK, t.BRICK_COIN, t.BRICK_POWER_UP):
        _brick(pen)
    elif tile in (t.QUESTION_COIN, t.QUESTION_POWER_UP):
        _question(pen)
    elif tile == t.USED_BLOCK:
        pen.box((0, 0, 16, 16), "#A79A8B", INK, 1, 2)
        for x, y in ((3, 3), (11.5, 3), (3, 11.5), (11.5, 11.5)):
            pen.oval((x, y, x + 1.8, y + 1.8), INK)
    elif tile == t.STAIR:
        pen.box((0, 0, 16, 16), "#9C8F80", "#5E5449")
        pen.shape([(0.7, 0.7), (15.3, 0.7), (12, 4), (4, 4), (4, 12), (0.7, 15.3)], "#C9BDAE")
        pen.box((4, 4, 12, 12), "#B1A494")
    elif tile == t.COIN:
        pen.oval((3, 1.5, 13, 14.5), YELLOW, "#9A6A00", 1.3)
        pen.box((7, 4.5, 9, 11.5), ORANGE, radius=1)
    if tile in (t.BRICK_COIN, t.BRICK_POWER_UP, t.QUESTION_POWER_UP):
        _contents(pen, tile)


def _contents(pen: Pen, tile: int) -> None:
    """What a block hides: a coin, or an arrow for a power-up."""
    if tile == t.BRICK_COIN:
        pen.oval((4.8, 3.8, 11.2, 12.2), YELLOW, "#6A4A00", 1)
        return
    left, top = (9, 8) if tile == t.QUESTION_POWER_UP else (4.5, 4)
    size = 6 if tile == t.QUESTION_POWER_UP else 8
    arrow = [(0.5, 0), (1, 0.5), (0.7, 0.5), (0.7, 1), (0.3, 1), (0.3, 0.5), (0, 0.5)]
    pen.shape([(left + size * x, top + size * y) for x, y in arrow], WHITE, INK, 0.7)


def _ground(pen: Pen, tile: int, look: Look) -> None:
    pen.box((0, 0, 16, 16), look.ground)
    for x, y in ((2.5, 5), (10, 3.5), (6.5, 9), (12.5, 11), (3.5, 13)):
        pen.oval((x, y, x + 2, y + 1.4), look.speck)
    place, level = tile & 0x0F, tile >> 4
    if place == 3:
        _inner_corner(pen, level, look)
        return
    if place == 0:
        pen.box((0, 0, 2, 16), look.rim)
    if place == 2:
        pen.box((14, 0, 16, 16), look.rim)
    if level == 0xA:
        pen.box((0, 14, 16, 16), look.rim)
    if level == 8:
        pen.box((0, 0, 16, 4.6), look.rim)
        pen.box((0, 0, 16, 3.6), look.edge)


def _inner_corner(pen: Pen, level: int, look: Look) -> None:
    """The inside of the ground where two edges meet."""
    if level == 8:
        pen.box((0, 0, 2, 4.6), look.rim)
        pen.box((0, 0, 2, 3.6), look.edge)
    elif level == 9:
        pen.box((14, 0, 16, 4.6), look.rim)
        pen.box((14, 0, 16, 3.6), look.edge)
    elif level == 0xA:
        pen.box((14, 14, 16, 16), look.rim)
    else:
        pen.box((0, 14, 2, 16), look.rim)


def _hill(pen: Pen, tile: int) -> None:
    fill, side, top, rim = "#A9CF9B", "#7FAF74", "#E7F2B2", "#4E7F4A"
    place = tile % 16 - 4
    radius = 6 if tile in t.HILL_TOPS and place != 1 else 0
    pen.box((0, 0, 16, 16), fill) if not radius else _rounded_top(pen, place, fill, radius)
    if place != 1 and tile not in t.HILL_TOPS:
        pen.box((0, 0, 1.6, 16) if place == 0 else (14.4, 0, 16, 16), side)
    if tile not in t.HILL_BODIES:
        left, right = (3 if radius and place == 0 else 0), (13 if radius and place == 2 else 16)
        pen.box((left, 0, right, 3.6), rim)
        pen.box((left, 0, right, 2.6), top)
    else:
        for x, y in ((4, 4), (11, 10)):
            pen.oval((x, y, x + 1.8, y + 3), side)


def _rounded_top(pen: Pen, place: int, fill: str, radius: float) -> None:
    pen.box((0, 0, 26, 16) if place == 0 else (-10, 0, 16, 16), fill, radius=radius)
    pen.box((0, 8, 16, 16), fill)


def _pipe(pen: Pen, tile: int) -> None:
    left, mouth = tile in (t.PIPE_MOUTH[0], t.PIPE_BODY[0]), tile in t.PIPE_MOUTH
    side = 0 if mouth else 2
    box = (side, 0, 20, 16) if left else (-4, 0, 16 - side, 16)
    pen.box(box, GREEN, "#004D38", 1)
    if not mouth:
        pen.box((side + 1, -1, 16, 17) if left else (0, -1, 15 - side, 17), GREEN)
    if left:
        pen.box((side + 3, 1 if mouth else 0, side + 5.5, 15 if mouth else 16), "#7FD6B8")
    else:
        pen.box((10, 1 if mouth else 0, 12, 15 if mouth else 16), "#00795A")


def _brick(pen: Pen) -> None:
    pen.box((0, 0, 16, 16), "#B96A45", "#5B2F1C", 0.8)
    for y in (5.2, 10.6):
        pen.line([(0, y), (16, y)], "#5B2F1C", 0.8)
    for x, y in ((8, 0), (4, 5.2), (12, 5.2), (8, 10.6)):
        pen.line([(x, y), (x, y + 5.4)], "#5B2F1C", 0.8)


def _question(pen: Pen) -> None:
    pen.box((0, 0, 16, 16), YELLOW, "#7A5A00", 1, 2)
    hook = [(5.2, 5.6), (6, 3.9), (8, 3.3), (10.2, 4.2), (10.4, 6.2), (8.6, 7.8), (8, 9), (8, 10)]
    pen.line(hook, INK, 1.8)
    pen.oval((6.9, 11.2, 9.1, 13.4), INK)
