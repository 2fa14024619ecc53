"""Animations: small, extra, and never carrying the argument."""

from __future__ import annotations

import base64
import io
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from cotlearn.plots._arrays import as_classes, as_path
from cotlearn.plots._canvas import finish_plane, panels
from cotlearn.plots.style import COLORS, condition_colors, label_of


def animate(
    paths: Mapping[str, ArrayLike | Any],
    c: ArrayLike | Any = None,
    *,
    limit: float,
    titles: Mapping[str, str] | None = None,
    size: float = 6.0,
    panel: float = 2.5,
    hold: int = 6,
    interval: int = 110,
) -> FuncAnimation:
    """Animate samples of several methods side by side, all starting from the same noise.

    Show it with :func:`gif` (small, plays everywhere) or ``.to_jshtml()`` (with a slider).

    Args:
        paths: name -> (times, n, 2); the same number of times and samples for each.
        c: the condition of each sample, as in :func:`scatter`.
        limit: all axes run from -limit to limit.
        titles: words above the panels where they differ from ``LABELS``.
        size: marker area in points squared.
        panel: side of a panel in inches.
        hold: the last frame is shown this many times more.
        interval: milliseconds a frame.

    Raises:
        ValueError: no paths, or shapes that do not fit.
    """
    arrays = {name: as_path(path, f"paths[{name!r}]") for name, path in paths.items()}
    if not arrays:
        raise ValueError("paths is empty, expected at least one (times, n, 2)")
    shapes = {array.shape for array in arrays.values()}
    if len(shapes) > 1:
        raise ValueError(f"paths have different shapes {sorted(shapes)}, expected one")
    times, n = next(iter(shapes))[:2]
    values, n_classes = as_classes(c, n)
    colors = condition_colors(values, n_classes, plain=COLORS["independent"])
    figure, axes = panels(len(arrays), size=panel, shared=True)
    dots = []
    for ax, (name, array) in zip(axes, arrays.items(), strict=True):
        dots.append(ax.scatter(*array[0].T, s=size, c=colors, alpha=0.8, linewidths=0))
        finish_plane(ax, label_of(name, titles), limit)

    def draw(frame: int) -> list[Any]:
        index = min(frame, times - 1)
        for dot, array in zip(dots, arrays.values(), strict=True):
            dot.set_offsets(array[index])
        return dots

    animation = FuncAnimation(figure, draw, frames=times + hold, interval=interval, blit=False)
    plt.close(figure)  # the notebook shows the animation, not its first frame beside it
    return animation


@dataclass(frozen=True)
class Gif:
    """A GIF that notebooks display, and pages made from them too."""

    data: bytes

    def _repr_mimebundle_(self, **options: Any) -> dict[str, str]:
        encoded = base64.b64encode(self.data).decode()
        page = f'<img alt="animation" src="data:image/gif;base64,{encoded}">'
        return {"image/gif": encoded, "text/html": page, "text/plain": "<animation>"}


def gif(animation: FuncAnimation, *, fps: int = 9, dpi: int = 72) -> Gif:
    """Render an animation as a GIF for display in a notebook.

    Args:
        animation: from :func:`animate`.
        fps: frames a second.
        dpi: dots an inch; 72 keeps three panels of 30 frames well below 1 MB.

    Returns:
        What a cell displays; the bytes are in ``.data``.
    """
    return Gif(gif_bytes(animation, fps=fps, dpi=dpi))


def film(images: Sequence[NDArray[np.uint8]], *, fps: int = 10, colors: int = 64) -> Gif:
    """Make a GIF of rendered pictures for display in a notebook.

    Args:
        images: (height, width, 3) each, as `env.render()` gives them.
        fps: frames a second.
        colors: in all; fewer make a smaller file.

    Raises:
        ValueError: no images, or arrays that are none.
    """
    if np.ndim(images) == 0 or len(images) == 0 or any(not _is_picture(i) for i in images):
        raise ValueError("images must be uint8 arrays of shape (height, width, 3), at least one")
    pictures = [Image.fromarray(np.asarray(image)) for image in images]
    # by coverage of the colours, not of the area: the small goal stays green
    method, dither = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
    frames = [picture.quantize(colors, method, dither=dither) for picture in pictures]
    with io.BytesIO() as target:
        frames[0].save(
            target,
            format="GIF",
            save_all=True,
            append_images=frames[1:],
            duration=round(1000 / fps),
            loop=0,
        )
        return Gif(target.getvalue())


def _is_picture(image: Any) -> bool:
    array = np.asarray(image)
    return array.dtype == np.uint8 and array.ndim == 3 and array.shape[2] == 3 and array.size > 0


def gif_bytes(animation: FuncAnimation, *, fps: int = 9, dpi: int = 72) -> bytes:
    """The bytes of an animation as a GIF, drawn by Pillow."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "animation.gif"
        animation.save(target, writer=PillowWriter(fps=fps), dpi=dpi)
        return target.read_bytes()
