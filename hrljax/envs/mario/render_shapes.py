"""The drawings of the platformer: tiles and figures of our own, from simple shapes.

Measures are the game's pixels: a tile is 16 x 16, a figure is drawn on a canvas of 32 x 72 with the
middle of its lower edge at (16, 34), looking right. Colours keep their distance for colour-blind
eyes (after Okabe and Ito), and things that differ in colour differ in a mark too.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

from PIL import Image, ImageDraw, ImageOps

from hrljax.envs.mario import tiles as t
from hrljax.envs.mario.level import GOOMBA, GREEN_KOOPA, PIRANHA, RED_KOOPA, SPIKY
from hrljax.envs.mario.state import FIREBALL, FLOWER, MUSHROOM, SHELL

CANVAS = (32, 72)
ANCHOR = (16, 34)
_FINE = 8
"""Points per pixel while drawing; the picture is then shrunk, which smooths edges."""

INK = "#1B1F2A"
_WHITE, _CREAM = "#FFFFFF", "#FFF1D0"
_ORANGE, _SKY, _GREEN, _YELLOW = "#E69F00", "#56B4E9", "#009E73", "#F0E442"
_BLUE, _RED, _PINK, _BROWN = "#0072B2", "#D55E00", "#CC79A7", "#A9714B"

Box = tuple[float, float, float, float]


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


class Pen:
    """Draws in the game's pixels on a transparent canvas."""

    def __init__(self, width: float, height: float):
        self.image = Image.new("RGBA", (round(width * _FINE), round(height * _FINE)))
        self._draw = ImageDraw.Draw(self.image)

    def box(self, box: Box, fill: str, line: str | None = None, width: float = 1, radius: float = 0) -> None:
        # The lower right point belongs to what Pillow draws.
        x0, y0, x1, y1 = (v * _FINE for v in box)
        self._draw.rounded_rectangle((x0, y0, x1 - 1, y1 - 1), radius * _FINE, fill, line, round(width * _FINE))

    def oval(self, box: Box, fill: str, line: str | None = None, width: float = 1) -> None:
        x0, y0, x1, y1 = (v * _FINE for v in box)
        self._draw.ellipse((x0, y0, x1 - 1, y1 - 1), fill, line, round(width * _FINE))

    def slice(self, box: Box, start: float, end: float, fill: str, line: str | None = None, width: float = 1) -> None:
        """Part of an oval between two angles, in degrees clockwise from the right."""
        x0, y0, x1, y1 = (v * _FINE for v in box)
        self._draw.pieslice((x0, y0, x1 - 1, y1 - 1), start, end, fill, line, round(width * _FINE))

    def shape(self, points: list[tuple[float, float]], fill: str, line: str | None = None, width: float = 1) -> None:
        self._draw.polygon([(x * _FINE, y * _FINE) for x, y in points], fill, line, round(width * _FINE))

    def line(self, points: list[tuple[float, float]], colour: str, width: float = 1) -> None:
        self._draw.line([(x * _FINE, y * _FINE) for x, y in points], colour, round(width * _FINE), joint="curve")

    def at(self, tile_pixels: int) -> Image.Image:
        """The drawing at `tile_pixels` points per tile."""
        factor = tile_pixels / (t.TILE * _FINE)
        size = (round(self.image.width * factor), round(self.image.height * factor))
        return self.image.resize(size, Image.Resampling.BOX)


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
        pen.oval((3, 1.5, 13, 14.5), _YELLOW, "#9A6A00", 1.3)
        pen.box((7, 4.5, 9, 11.5), _ORANGE, radius=1)
    if tile in (t.BRICK_COIN, t.BRICK_POWER_UP, t.QUESTION_POWER_UP):
        _contents(pen, tile)


def _contents(pen: Pen, tile: int) -> None:
    """What a block hides: a coin, or an arrow for a power-up."""
    if tile == t.BRICK_COIN:
        pen.oval((4.8, 3.8, 11.2, 12.2), _YELLOW, "#6A4A00", 1)
        return
    left, top = (9, 8) if tile == t.QUESTION_POWER_UP else (4.5, 4)
    size = 6 if tile == t.QUESTION_POWER_UP else 8
    arrow = [(0.5, 0), (1, 0.5), (0.7, 0.5), (0.7, 1), (0.3, 1), (0.3, 0.5), (0, 0.5)]
    pen.shape([(left + size * x, top + size * y) for x, y in arrow], _WHITE, INK, 0.7)


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
    pen.box(box, _GREEN, "#004D38", 1)
    if not mouth:
        pen.box((side + 1, -1, 16, 17) if left else (0, -1, 15 - side, 17), _GREEN)
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
    pen.box((0, 0, 16, 16), _YELLOW, "#7A5A00", 1, 2)
    hook = [(5.2, 5.6), (6, 3.9), (8, 3.3), (10.2, 4.2), (10.4, 6.2), (8.6, 7.8), (8, 9), (8, 10)]
    pen.line(hook, INK, 1.8)
    pen.oval((6.9, 11.2, 9.1, 13.4), INK)


class Pose(NamedTuple):
    """How a figure is shown; hashable, so that drawings are kept."""

    kind: int  # 0 Mario, else the kind of sprite
    size: int = 0  # Mario: 0 small, 1 large, 2 fire; shell: 0 red, 1 green
    winged: bool = False
    left: bool = False
    step: int = 0  # phase of the walk, 0 or 1
    aloft: bool = False
    dead: bool = False
    squashed: bool = False


@lru_cache(maxsize=1024)
def figure_image(pose: Pose, tile_pixels: int) -> Image.Image:
    """The drawing of a figure at `tile_pixels` points per tile."""
    pen = Pen(*CANVAS)
    if pose.winged:
        _wing(pen)
    _FIGURES[pose.kind](pen, pose)
    if pose.winged:
        _wing(pen, front=True)
    image = pen.image
    if pose.squashed:
        image = _squash(image)
    elif pose.dead and pose.kind:
        image = _upside_down(image)
    pen.image = ImageOps.mirror(image) if pose.left else image
    return pen.at(tile_pixels)


def _squash(image: Image.Image) -> Image.Image:
    """The figure pressed flat onto the ground."""
    ground = ANCHOR[1] * _FINE
    flat = image.crop((0, 0, image.width, ground)).resize((image.width, ground * 2 // 5))
    out = Image.new("RGBA", image.size)
    out.paste(flat, (0, ground - flat.height))
    return out


def _upside_down(image: Image.Image) -> Image.Image:
    box = image.getbbox() or (0, 0, 1, 1)
    out = Image.new("RGBA", image.size)
    out.paste(ImageOps.flip(image.crop(box)), box[:2])
    return out


def _eye(pen: Pen, x: float, y: float, size: float = 3) -> None:
    pen.oval((x, y, x + size, y + size), _WHITE, INK, 0.5)
    pen.oval((x + size * 0.45, y + size * 0.3, x + size * 0.95, y + size * 0.8), INK)


def _feet(pen: Pen, pose: Pose, colour: str, middle: float = 16, ground: float = 34, spread: float = 2) -> None:
    stride = 1.5 if pose.step else 0
    lift = 1.5 if pose.aloft else 0
    for side in (-1, 1):
        x = middle + side * (spread + stride)
        y = ground - (lift if side < 0 else 0)
        pen.oval((x - 2.8, y - 3.4, x + 2.8, y), colour, INK, 0.7)


def _mario(pen: Pen, pose: Pose) -> None:
    """A round fellow with a visor and a cap; his colours tell what he can do, his height that he is large."""
    body, cap, mark = ((_BLUE, _ORANGE, ""), (_BLUE, _ORANGE, _SKY), (_RED, _WHITE, _YELLOW))[pose.size]
    height = 26 if pose.size else 15
    top = ANCHOR[1] - height
    _feet(pen, pose, INK)
    pen.box((10.5, top + 2, 21.5, 32.5), body, INK, 0.8, 5)
    pen.box((13.5, top + 5.5, 22, top + 9.8), _CREAM, INK, 0.6, 2)
    if pose.dead:
        for x in (16, 19.5):
            pen.line([(x - 1, top + 6.6), (x + 1, top + 8.8)], INK, 0.7)
            pen.line([(x + 1, top + 6.6), (x - 1, top + 8.8)], INK, 0.7)
    else:
        for x in (16, 19.3):
            pen.oval((x - 0.8, top + 6.4, x + 0.9, top + 9), INK)
    pen.slice((9.5, top - 1, 22.5, top + 11), 180, 360, cap, INK, 0.8)
    pen.box((17, top + 3.8, 25.2, top + 5.6), cap, INK, 0.7, 0.8)
    if pose.size:
        pen.box((10.5, 25, 21.5, 27.2), mark, INK, 0.5)
        pen.oval((14.3, 19.5, 17.7, 22.9), mark, INK, 0.5)
    if pose.size == 2:
        pen.shape([(16, 17.2), (18.8, 21.5), (16, 23.6), (13.2, 21.5)], _YELLOW, INK, 0.5)


def _shell_dome(pen: Pen, box: Box, green: bool) -> None:
    """Red shells have a stripe, green ones dots."""
    x0, y0, x1, y1 = box
    width, height = x1 - x0, y1 - y0
    pen.slice((x0, y0, x1, y1 + height), 180, 360, _GREEN if green else _RED, INK, 0.8)
    if green:
        for x, y in ((0.28, 0.62), (0.5, 0.32), (0.72, 0.62)):
            pen.oval((x0 + x * width - 1, y0 + y * height - 1, x0 + x * width + 1, y0 + y * height + 1), _CREAM)
    else:
        pen.line([(x0 + 0.3 * width, y1), (x0 + 0.5 * width, y0 + 1), (x0 + 0.7 * width, y1)], _CREAM, 1.3)
    pen.box((x0 - 0.8, y1 - 1.6, x1 + 0.8, y1 + 0.9), _CREAM, INK, 0.6, 1)


def _koopa(pen: Pen, pose: Pose) -> None:
    _feet(pen, pose, _ORANGE)
    pen.box((17.5, 14, 21.5, 28), _CREAM, INK, 0.7, 2)
    pen.oval((16, 9, 25, 18), _CREAM, INK, 0.8)
    _eye(pen, 20, 10.8)
    _shell_dome(pen, (8.5, 19, 21.5, 30.5), pose.kind == GREEN_KOOPA)


def _goomba(pen: Pen, pose: Pose) -> None:
    _feet(pen, pose, INK, spread=3)
    pen.box((12.5, 26, 19.5, 32.5), _CREAM, INK, 0.7, 2)
    pen.shape([(9, 28.5), (11.5, 21.5), (14, 19.8), (18, 19.8), (20.5, 21.5), (23, 28.5)], _BROWN, INK, 0.9)
    pen.line([(11.8, 22.8), (14.6, 24.4)], INK, 1)
    pen.line([(20.2, 22.8), (17.4, 24.4)], INK, 1)
    _eye(pen, 12.4, 24.2, 2.8)
    _eye(pen, 16.8, 24.2, 2.8)


def _spiky(pen: Pen, pose: Pose) -> None:
    _feet(pen, pose, _BROWN, spread=3)
    for x, y, tip in ((10.2, 26, 7), (13.8, 23.5, 12.4), (18.2, 23.5, 19.6), (21.8, 26, 25)):
        pen.shape([(x - 2.6, y + 2), (tip, y - 6), (x + 2.6, y + 2)], _WHITE, INK, 0.7)
    pen.slice((8.5, 21, 23.5, 43), 180, 360, _PINK, INK, 0.8)
    pen.box((7.8, 30.2, 24.2, 32.8), _CREAM, INK, 0.6, 1)
    _eye(pen, 18.6, 25.6, 3)


def _piranha(pen: Pen, pose: Pose) -> None:
    """A plant with an open mouth; its stem goes down into the pipe, however high it rises."""
    pen.box((14.6, 25, 17.4, 40 if pose.dead or pose.squashed else CANVAS[1]), _GREEN, INK, 0.7)
    for side in (-1, 1):
        leaf = [(16, 34), (16 + side * 6.5, 30), (16 + side * 7, 34.5), (16, 37)]
        pen.shape(leaf, "#5FC9A6", INK, 0.7)
    gape = 26 if pose.step else 14
    pen.slice((9, 14, 23, 28), 270 + gape, 270 - gape + 360, _PINK, INK, 0.9)
    for x, y in ((11.6, 21.5), (15.2, 24.4), (18.8, 21.5)):
        pen.oval((x, y, x + 2, y + 2), _WHITE)
    pen.shape([(12.4, 15.4), (14.4, 14.6), (14.8, 18.2)], _WHITE, INK, 0.4)
    pen.shape([(19.6, 15.4), (17.6, 14.6), (17.2, 18.2)], _WHITE, INK, 0.4)


def _mushroom(pen: Pen, pose: Pose) -> None:
    pen.box((12.5, 26, 19.5, 34), _CREAM, INK, 0.7, 2)
    pen.slice((8.5, 19, 23.5, 37), 180, 360, _SKY, INK, 0.9)
    for x, y, r in ((11.5, 24.8, 1.5), (16, 22, 2), (20.5, 24.8, 1.5)):
        pen.oval((x - r, y - r, x + r, y + r), _WHITE)
    for x in (14.6, 17.4):
        pen.oval((x - 0.6, 29, x + 0.6, 31.4), INK)


def _flower(pen: Pen, pose: Pose) -> None:
    pen.box((15.2, 26, 16.8, 34), _GREEN)
    pen.shape([(16, 33.5), (10.5, 29.5), (11.5, 33.5)], _GREEN, INK, 0.5)
    pen.shape([(16, 33.5), (21.5, 29.5), (20.5, 33.5)], _GREEN, INK, 0.5)
    for x, y in ((16, 19.5), (20, 21), (20.5, 25), (16, 27), (11.5, 25), (12, 21)):
        pen.oval((x - 2.6, y - 2.6, x + 2.6, y + 2.6), _RED, INK, 0.5)
    pen.oval((12.5, 20, 19.5, 27), _YELLOW, INK, 0.6)


def _fireball(pen: Pen, pose: Pose) -> None:
    pen.oval((11.5, 25.5, 20.5, 34.5), _RED, INK, 0.6)
    pen.oval((13.2, 27.2, 18.8, 32.8), _ORANGE)
    pen.oval((14.6, 28.6, 17.4, 31.4), _YELLOW)


def _shell(pen: Pen, pose: Pose) -> None:
    _shell_dome(pen, (8.5, 22, 23.5, 31.5), bool(pose.size))
    pen.box((10, 31.2, 22, 34), _CREAM, INK, 0.6, 1.2)


def _wing(pen: Pen, front: bool = False) -> None:
    """Wings stand out behind the figure on both sides."""
    side, root = (1, 10) if front else (-1, 13)
    points = [(0, 6), (-3, 0), (-8, -5), (-9, 0), (-7, 2), (-8, 4), (-5, 5), (-5, 7)]
    lift = 0 if side > 0 else -3
    pen.shape([(root + x, 22 + y + lift) for x, y in points], _WHITE, INK, 0.7)


_FIGURES: dict[int, Callable[[Pen, Pose], None]] = {
    0: _mario,
    RED_KOOPA: _koopa,
    GREEN_KOOPA: _koopa,
    GOOMBA: _goomba,
    SPIKY: _spiky,
    PIRANHA: _piranha,
    MUSHROOM: _mushroom,
    FLOWER: _flower,
    FIREBALL: _fireball,
    SHELL: _shell,
}
