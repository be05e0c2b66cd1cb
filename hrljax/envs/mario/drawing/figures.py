"""The drawings of Mario and the sprites: our own, from simple shapes, looking right."""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

from PIL import Image, ImageOps

from hrljax.envs.mario.drawing.pen import (
    BLUE,
    BROWN,
    CREAM,
    FINE,
    GREEN,
    INK,
    ORANGE,
    PINK,
    RED,
    SKY,
    WHITE,
    YELLOW,
    Box,
    Pen,
)
from hrljax.envs.mario.engine.state import FIREBALL, FLOWER, MUSHROOM, SHELL
from hrljax.envs.mario.levels.level import GOOMBA, GREEN_KOOPA, PIRANHA, RED_KOOPA, SPIKY

CANVAS = (32, 72)
"""Width and height of the canvas of a figure in the game's pixels."""
ANCHOR = (16, 34)
"""The middle of the lower edge of a figure on its canvas."""


class Pose(NamedTuple):
    """How a figure is shown; hashable, so that drawings can be cached."""

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
    ground = ANCHOR[1] * FINE
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
    pen.oval((x, y, x + size, y + size), WHITE, INK, 0.5)
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
    body, cap, mark = ((BLUE, ORANGE, ""), (BLUE, ORANGE, SKY), (RED, WHITE, YELLOW))[pose.size]
    height = 26 if pose.size else 15
    top = ANCHOR[1] - height
    _feet(pen, pose, INK)
    pen.box((10.5, top + 2, 21.5, 32.5), body, INK, 0.8, 5)
    pen.box((13.5, top + 5.5, 22, top + 9.8), CREAM, INK, 0.6, 2)
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
        pen.shape([(16, 17.2), (18.8, 21.5), (16, 23.6), (13.2, 21.5)], YELLOW, INK, 0.5)


def _shell_dome(pen: Pen, box: Box, green: bool) -> None:
    """Red shells have a stripe, green ones dots."""
    x0, y0, x1, y1 = box
    width, height = x1 - x0, y1 - y0
    pen.slice((x0, y0, x1, y1 + height), 180, 360, GREEN if green else RED, INK, 0.8)
    if green:
        for x, y in ((0.28, 0.62), (0.5, 0.32), (0.72, 0.62)):
            pen.oval((x0 + x * width - 1, y0 + y * height - 1, x0 + x * width + 1, y0 + y * height + 1), CREAM)
    else:
        pen.line([(x0 + 0.3 * width, y1), (x0 + 0.5 * width, y0 + 1), (x0 + 0.7 * width, y1)], CREAM, 1.3)
    pen.box((x0 - 0.8, y1 - 1.6, x1 + 0.8, y1 + 0.9), CREAM, INK, 0.6, 1)


def _koopa(pen: Pen, pose: Pose) -> None:
    _feet(pen, pose, ORANGE)
    pen.box((17.5, 14, 21.5, 28), CREAM, INK, 0.7, 2)
    pen.oval((16, 9, 25, 18), CREAM, INK, 0.8)
    _eye(pen, 20, 10.8)
    _shell_dome(pen, (8.5, 19, 21.5, 30.5), pose.kind == GREEN_KOOPA)


def _goomba(pen: Pen, pose: Pose) -> None:
    _feet(pen, pose, INK, spread=3)
    pen.box((12.5, 26, 19.5, 32.5), CREAM, INK, 0.7, 2)
    pen.shape([(9, 28.5), (11.5, 21.5), (14, 19.8), (18, 19.8), (20.5, 21.5), (23, 28.5)], BROWN, INK, 0.9)
    pen.line([(11.8, 22.8), (14.6, 24.4)], INK, 1)
    pen.line([(20.2, 22.8), (17.4, 24.4)], INK, 1)
    _eye(pen, 12.4, 24.2, 2.8)
    _eye(pen, 16.8, 24.2, 2.8)


def _spiky(pen: Pen, pose: Pose) -> None:
    _feet(pen, pose, BROWN, spread=3)
    for x, y, tip in ((10.2, 26, 7), (13.8, 23.5, 12.4), (18.2, 23.5, 19.6), (21.8, 26, 25)):
        pen.shape([(x - 2.6, y + 2), (tip, y - 6), (x + 2.6, y + 2)], WHITE, INK, 0.7)
    pen.slice((8.5, 21, 23.5, 43), 180, 360, PINK, INK, 0.8)
    pen.box((7.8, 30.2, 24.2, 32.8), CREAM, INK, 0.6, 1)
    _eye(pen, 18.6, 25.6, 3)


def _piranha(pen: Pen, pose: Pose) -> None:
    """A plant with an open mouth; its stem goes down into the pipe, however high it rises."""
    pen.box((14.6, 25, 17.4, 40 if pose.dead or pose.squashed else CANVAS[1]), GREEN, INK, 0.7)
    for side in (-1, 1):
        leaf = [(16, 34), (16 + side * 6.5, 30), (16 + side * 7, 34.5), (16, 37)]
        pen.shape(leaf, "#5FC9A6", INK, 0.7)
    gape = 26 if pose.step else 14
    pen.slice((9, 14, 23, 28), 270 + gape, 270 - gape + 360, PINK, INK, 0.9)
    for x, y in ((11.6, 21.5), (15.2, 24.4), (18.8, 21.5)):
        pen.oval((x, y, x + 2, y + 2), WHITE)
    pen.shape([(12.4, 15.4), (14.4, 14.6), (14.8, 18.2)], WHITE, INK, 0.4)
    pen.shape([(19.6, 15.4), (17.6, 14.6), (17.2, 18.2)], WHITE, INK, 0.4)


def _mushroom(pen: Pen, pose: Pose) -> None:
    pen.box((12.5, 26, 19.5, 34), CREAM, INK, 0.7, 2)
    pen.slice((8.5, 19, 23.5, 37), 180, 360, SKY, INK, 0.9)
    for x, y, r in ((11.5, 24.8, 1.5), (16, 22, 2), (20.5, 24.8, 1.5)):
        pen.oval((x - r, y - r, x + r, y + r), WHITE)
    for x in (14.6, 17.4):
        pen.oval((x - 0.6, 29, x + 0.6, 31.4), INK)


def _flower(pen: Pen, pose: Pose) -> None:
    pen.box((15.2, 26, 16.8, 34), GREEN)
    pen.shape([(16, 33.5), (10.5, 29.5), (11.5, 33.5)], GREEN, INK, 0.5)
    pen.shape([(16, 33.5), (21.5, 29.5), (20.5, 33.5)], GREEN, INK, 0.5)
    for x, y in ((16, 19.5), (20, 21), (20.5, 25), (16, 27), (11.5, 25), (12, 21)):
        pen.oval((x - 2.6, y - 2.6, x + 2.6, y + 2.6), RED, INK, 0.5)
    pen.oval((12.5, 20, 19.5, 27), YELLOW, INK, 0.6)


def _fireball(pen: Pen, pose: Pose) -> None:
    pen.oval((11.5, 25.5, 20.5, 34.5), RED, INK, 0.6)
    pen.oval((13.2, 27.2, 18.8, 32.8), ORANGE)
    pen.oval((14.6, 28.6, 17.4, 31.4), YELLOW)


def _shell(pen: Pen, pose: Pose) -> None:
    _shell_dome(pen, (8.5, 22, 23.5, 31.5), bool(pose.size))
    pen.box((10, 31.2, 22, 34), CREAM, INK, 0.6, 1.2)


def _wing(pen: Pen, front: bool = False) -> None:
    """Wings stand out behind the figure on both sides."""
    side, root = (1, 10) if front else (-1, 13)
    points = [(0, 6), (-3, 0), (-8, -5), (-9, 0), (-7, 2), (-8, 4), (-5, 5), (-5, 7)]
    lift = 0 if side > 0 else -3
    pen.shape([(root + x, 22 + y + lift) for x, y in points], WHITE, INK, 0.7)


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
