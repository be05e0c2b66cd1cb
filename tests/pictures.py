"""What drawings of maps show."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.quiver import Quiver


def strings(axes: Axes) -> list[str]:
    """The texts in a drawing."""
    return [text.get_text() for text in axes.texts]


def arrows(axes: Axes) -> Quiver:
    """The arrows of a drawing."""
    (quiver,) = (collection for collection in axes.collections if isinstance(collection, Quiver))
    return quiver


def image_of(axes: Axes) -> np.ma.MaskedArray:
    """The colours or values of the cells of a drawing; what has no value is masked."""
    (image,) = axes.images
    return np.ma.asarray(image.get_array())
