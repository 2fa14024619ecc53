"""Small animations that supplement the figures."""

import base64
import io
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from cotlearn.plots._canvas import Numbers, as_array, finish_plane, panels
from cotlearn.plots.style import condition_colors, label_of


def animate(paths: Mapping[str, Numbers], c: Numbers = None, *, limit: float) -> FuncAnimation:
    """Animate samples of several methods side by side, all starting from the same noise.

    Show it with :func:`gif` (small, plays everywhere) or ``.to_jshtml()`` (with a slider).

    Args:
        paths: name -> (times, n, 2); the same number of times and samples for each.
        c: the condition of each sample, as in :func:`scatter`.
        limit: all axes run from -limit to limit.
    """
    arrays = {name: as_array(path, "times", "n", 2) for name, path in paths.items()}
    times, n, _ = next(iter(arrays.values())).shape
    colors = condition_colors(c, n)
    figure, axes = panels(len(arrays), size=2.5, shared=True)
    for ax, (name, array) in zip(axes, arrays.items(), strict=True):
        ax.scatter(*array[0].T, s=6, c=colors, alpha=0.8, linewidths=0)
        finish_plane(ax, label_of(name), limit)

    def draw(frame: int) -> None:
        for ax, array in zip(axes, arrays.values(), strict=True):
            ax.collections[0].set_offsets(array[min(frame, times - 1)])

    return animation_of(figure, draw, frames=times + 6)  # the last six frames stand still


def animation_of(figure: Figure, draw: Callable[[int], None], *, frames: int) -> FuncAnimation:
    """Animate a figure and close it, so that a notebook does not also show its first frame."""
    for _ in range(4):  # until the layout has settled: else the first frames are cut and jump
        figure.draw_without_rendering()
    figure.set_layout_engine("none")
    plt.close(figure)
    return FuncAnimation(figure, draw, frames=frames, interval=100, blit=False)


@dataclass(frozen=True)
class Gif:
    """A GIF that is displayed in notebooks and in HTML pages made from them."""

    data: bytes

    def _repr_mimebundle_(self, **options: Any) -> dict[str, str]:
        encoded = base64.b64encode(self.data).decode()
        page = f'<img alt="animation" src="data:image/gif;base64,{encoded}">'
        return {"image/gif": encoded, "text/html": page, "text/plain": "<animation>"}


def gif(animation: FuncAnimation, *, fps: int = 9, dpi: int = 72) -> Gif:
    """Render an animation as a GIF for display in a notebook.

    Args:
        animation: from :func:`animate` or :func:`push_t_animation`.
        fps: frames per second.
        dpi: dots an inch; 72 keeps three panels of 30 frames well below 1 MB.

    Returns:
        An object that a cell displays; its bytes are in ``.data``.
    """
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "animation.gif"
        animation.save(target, writer=PillowWriter(fps=fps), dpi=dpi)
        return Gif(target.read_bytes())


def film(images: Sequence[NDArray[np.uint8]], *, fps: int = 10) -> Gif:
    """Make a GIF of rendered pictures for display in a notebook.

    Args:
        images: (height, width, 3) each, as `env.render()` gives them.
        fps: frames per second.
    """
    # by coverage of the colours, not of the area: the small goal stays green
    method, dither = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
    first, *others = (Image.fromarray(i).quantize(64, method, dither=dither) for i in images)
    with io.BytesIO() as target:
        loop: dict[str, Any] = {"save_all": True, "duration": round(1000 / fps), "loop": 0}
        first.save(target, format="GIF", append_images=others, **loop)
        return Gif(target.getvalue())
