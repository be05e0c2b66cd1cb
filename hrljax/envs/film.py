"""Films of episodes, as GIFs: they need Pillow, but neither a display nor ffmpeg."""

from collections.abc import Iterable
from os import PathLike
from pathlib import Path

import numpy as np
from PIL import Image

from hrljax.core import checks

_PACK = np.array([1 << 16, 1 << 8, 1], np.uint32)
"""Makes one number of a colour."""


def save_gif(frames: Iterable[np.ndarray], path: str | PathLike[str], fps: float = 24) -> None:
    """Writes a film that plays for ever.

    All frames share one palette. A GIF counts in hundredths of a second, so the real speed is the
    nearest it can do: 25 for 24 frames a second. Nothing is left at `path` if this fails.

    Args:
        frames: ``[H, W, 3]`` uint8 arrays of one shape, at least one.
        path: where to.
        fps: frames a second, over 0 and up to 50.

    Raises:
        ValueError: there are no frames, they have another type or differ in shape, or `fps` is out of range.
    """
    checks.number("fps", fps, checks.Interval(0, 50, low_open=True))
    shots = []
    for i, frame in enumerate(frames):
        shape = shots[0].shape if shots else frame.shape
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[-1] != 3 or frame.shape != shape:
            raise ValueError(
                f"frame {i} must be a uint8 array of shape [H, W, 3] like the others, "
                f"got {frame.dtype} of shape {list(frame.shape)}"
            )
        shots.append(frame)
    if not shots:
        raise ValueError("frames must be at least one, got none")
    # Every colour counts once, however small the thing that has it.
    points = [shot[::2, ::2].reshape(-1, 3).astype(np.uint32) @ _PACK for shot in shots]
    colours = np.unique(np.concatenate([np.unique(point) for point in points]))
    unpacked = (colours[:, None] // _PACK % 256).astype(np.uint8)
    palette = Image.fromarray(unpacked[None]).quantize(255, Image.Quantize.MEDIANCUT)
    images = [Image.fromarray(shot).quantize(palette=palette, dither=Image.Dither.NONE) for shot in shots]
    target = Path(path)
    unfinished = target.with_name(target.name + ".part")
    try:
        images[0].save(
            *(unfinished, "GIF"), save_all=True, append_images=images[1:], duration=10 * round(100 / fps), loop=0
        )
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)
