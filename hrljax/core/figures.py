"""Figures without pyplot, that show themselves as the last expression of a notebook's cell."""

from io import BytesIO
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A figure that notebooks show."""

    def _repr_png_(self) -> bytes:
        drawn = BytesIO()
        self.savefig(drawn, format="png")
        return drawn.getvalue()


class ShownAxes(Axes):
    """Axes of which notebooks show the figure, in which they are alone."""

    def _repr_png_(self) -> bytes:
        assert isinstance(self.figure, ShownFigure)
        return self.figure._repr_png_()


def new_axes(width: float, height: float, extent: tuple[float, float, float, float] | None = None) -> Axes:
    """Axes in a figure of their own, of a size in inches; where they lie in it is left to the layout, if not given."""
    layout: Literal["constrained"] | None = "constrained" if extent is None else None
    figure = ShownFigure(figsize=(width, height), layout=layout)
    kind: dict[str, Any] = {"axes_class": ShownAxes}
    return figure.add_subplot(**kind) if extent is None else figure.add_axes(extent, **kind)
