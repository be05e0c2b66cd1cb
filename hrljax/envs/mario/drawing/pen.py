"""A pen for small drawings, and the colours of the platformer.

Lengths are the game's pixels: a tile is 16 x 16. The colours can be told apart by the colour-blind
(after Okabe and Ito), and things that differ in colour differ in a mark too.
"""

from PIL import Image, ImageDraw

from hrljax.envs.mario.levels.tiles import TILE

FINE = 8
"""Points per pixel while drawing; the picture is then shrunk, which smooths edges."""

INK = "#1B1F2A"
WHITE, CREAM = "#FFFFFF", "#FFF1D0"
ORANGE, SKY, GREEN, YELLOW = "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, RED, PINK, BROWN = "#0072B2", "#D55E00", "#CC79A7", "#A9714B"

Box = tuple[float, float, float, float]


class Pen:
    """Draws in the game's pixels on a transparent canvas."""

    def __init__(self, width: float, height: float):
        self.image = Image.new("RGBA", (round(width * FINE), round(height * FINE)))
        self._draw = ImageDraw.Draw(self.image)

    def box(self, box: Box, fill: str, line: str | None = None, width: float = 1, radius: float = 0) -> None:
        # Pillow draws the lower right point too.
        x0, y0, x1, y1 = (v * FINE for v in box)
        self._draw.rounded_rectangle((x0, y0, x1 - 1, y1 - 1), radius * FINE, fill, line, round(width * FINE))

    def oval(self, box: Box, fill: str, line: str | None = None, width: float = 1) -> None:
        x0, y0, x1, y1 = (v * FINE for v in box)
        self._draw.ellipse((x0, y0, x1 - 1, y1 - 1), fill, line, round(width * FINE))

    def slice(self, box: Box, start: float, end: float, fill: str, line: str | None = None, width: float = 1) -> None:
        """Part of an oval between two angles, in degrees clockwise from the right."""
        x0, y0, x1, y1 = (v * FINE for v in box)
        self._draw.pieslice((x0, y0, x1 - 1, y1 - 1), start, end, fill, line, round(width * FINE))

    def shape(self, points: list[tuple[float, float]], fill: str, line: str | None = None, width: float = 1) -> None:
        self._draw.polygon([(x * FINE, y * FINE) for x, y in points], fill, line, round(width * FINE))

    def line(self, points: list[tuple[float, float]], colour: str, width: float = 1) -> None:
        self._draw.line([(x * FINE, y * FINE) for x, y in points], colour, round(width * FINE), joint="curve")

    def at(self, tile_pixels: int) -> Image.Image:
        """The drawing at `tile_pixels` points per tile."""
        factor = tile_pixels / (TILE * FINE)
        size = (round(self.image.width * factor), round(self.image.height * factor))
        return self.image.resize(size, Image.Resampling.BOX)
