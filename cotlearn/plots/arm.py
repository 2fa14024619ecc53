"""The arm: paths of its tip from above and in space, and a drawing of the arm itself."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from numpy.typing import ArrayLike, NDArray

from cotlearn.plots._arrays import as_array
from cotlearn.plots._canvas import finish, open_axes
from cotlearn.plots.style import PATH_COLOR, SOURCE_COLOR, condition_color
from cotlearn.robots.arm.drawing import GOAL_MARK, PILLAR, VIEWS, draw_arm, draw_pillar

SIZE = (4.6, 3.6)
_FAILED = -1

Array = NDArray[np.float64]


def arm_paths(
    paths: ArrayLike | Any,
    state: ArrayLike | Any,
    *,
    modes: ArrayLike | Any = None,
    labels: Sequence[str] = (),
    ax: Axes | None = None,
    title: str | None = None,
) -> Axes:
    """Draw paths of the tip from above, with the pillars to their scale; a ring is the goal.

    Args:
        paths: (n, T, 3), metres.
        state: (columns,): tip, goal and pillars, as `cotlearn.robots.arm.columns` has them.
        modes: (n,), the way round of each path, which colours it; -1, a failure, is grey, dashed
            and ends in a cross. All are alike if None.
        labels: of the ways 0, 1, ...; those that occur get a legend.
        ax: where to draw; a new figure by default.
        title: words above the panel.

    Raises:
        ValueError: a shape does not fit, or a value is not finite.
    """
    lines, ways, goal, posts = _read(paths, state, modes)
    ax = open_axes(ax, SIZE)
    for x, y, radius, _ in posts:
        ax.add_patch(Circle((x, y), radius, facecolor=PILLAR, edgecolor="none", zorder=3))
    ax.add_patch(
        Circle((goal[0], goal[1]), 0.025, fill=False, edgecolor=GOAL_MARK, linewidth=1.8, zorder=5)
    )
    for way, look in _looks(ways, labels):
        chosen = lines[ways == way][..., :2]
        ax.add_collection(LineCollection(list(chosen), zorder=2, **look))
        if way == _FAILED:
            ends = chosen[:, -1]
            ax.scatter(
                ends[:, 0],
                ends[:, 1],
                marker="x",
                s=22,
                color=SOURCE_COLOR,
                linewidths=1.0,
                zorder=6,
            )
    starts = lines[:, 0]
    ax.scatter(starts[:, 0], starts[:, 1], s=16, color=SOURCE_COLOR, zorder=5, linewidths=0)
    ax.set_aspect("equal", adjustable="datalim")
    ax.autoscale_view()
    finish(ax, xlabel="x in metres", ylabel="y in metres", title=title)
    ax.grid(False)
    if labels and modes is not None:
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


def arm_paths_3d(
    paths: ArrayLike | Any,
    state: ArrayLike | Any,
    *,
    modes: ArrayLike | Any = None,
    labels: Sequence[str] = (),
    ax: Any = None,
    title: str | None = None,
) -> Any:
    """Draw paths of the tip in space; arguments as for :func:`arm_paths`, ``ax`` in 3D."""
    lines, ways, goal, posts = _read(paths, state, modes)
    ax = _open_space(ax)
    for post in posts:
        draw_pillar(ax, post)
    for way, look in _looks(ways, labels):
        ax.add_collection3d(Line3DCollection(list(lines[ways == way]), **look))
    ax.scatter(*lines[:, 0].T, s=14, color=SOURCE_COLOR, depthshade=False)
    ax.scatter(*goal, s=34, facecolors="none", edgecolors=GOAL_MARK, linewidths=1.8)
    every = np.concatenate([lines.reshape(-1, 3), goal[None], posts[:, [0, 1, 3]]])
    _space(ax, every, title)
    if labels and modes is not None:
        ax.legend(loc="upper left", fontsize="small")
    return ax


def arm_pose(
    points: ArrayLike | Any,
    state: ArrayLike | Any,
    *,
    ax: Any = None,
    title: str | None = None,
) -> Any:
    """Draw the arm among its pillars, as lines between its joints.

    Args:
        points: (10, 3), base, seven joints, flange and tip: `cotlearn.robots.arm.skeleton(joints)`.
        state: (columns,), as in :func:`arm_paths`.
        ax: 3D axes; a new figure by default.
        title: words above the panel.

    Raises:
        ValueError: a shape does not fit, or a value is not finite.
    """
    skeleton, array = _skeleton(points), as_array(state, "state")
    _scenery(array)
    ax = _open_space(ax)
    draw_arm(ax, skeleton, array)
    _words(ax)
    if title is not None:
        ax.set_title(title)
    return ax


def _looks(ways: NDArray[np.int64], labels: Sequence[str]) -> Iterable[tuple[int, dict[str, Any]]]:
    for way in np.unique(ways).tolist():
        failed = way == _FAILED
        name = "failed" if failed else labels[way] if way < len(labels) else f"way {way}"
        look: dict[str, Any] = {
            "colors": PATH_COLOR if failed else condition_color(way),
            "linestyles": (0, (3, 2)) if failed or way >= 10 else "-",  # ten colours, then dashes
            "linewidths": 1.2,
            "alpha": 0.85,
            "label": name,
        }
        yield way, look


def _open_space(ax: Any) -> Any:
    if ax is not None:
        return ax
    figure = _figure(SIZE)
    return figure.add_axes((0.0, 0.06, 0.88, 0.88), projection="3d")


def _figure(size: tuple[float, float]) -> Figure:
    """A figure without a layout: layouts do not see the words of 3D axes."""
    figure = plt.figure(figsize=size, layout="constrained")
    figure.set_layout_engine("none")  # one that never was would come back when it is saved
    return figure


def _space(ax: Any, every: Array, title: str | None) -> None:
    low, high = every.min(axis=0) - 0.03, every.max(axis=0) + 0.03
    low[2] = 0.0
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low)
    ax.view_init(*VIEWS["front"])
    _words(ax)
    if title is not None:
        ax.set_title(title)


def _words(ax: Any) -> None:
    ax.set(xlabel="x in metres", ylabel="y in metres", zlabel="z in metres")
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_major_locator(MaxNLocator(3, prune="upper"))


def _read(
    paths: ArrayLike | Any, state: ArrayLike | Any, modes: ArrayLike | Any
) -> tuple[Array, NDArray[np.int64], Array, Array]:
    lines = as_array(paths, "paths")
    if lines.ndim != 3 or lines.shape[2] != 3 or 0 in lines.shape or not np.isfinite(lines).all():
        raise ValueError(f"paths must be finite of shape (n, T, 3), got {lines.shape}")
    ways = np.zeros(len(lines)) if modes is None else as_array(modes, "modes")
    if ways.shape != (len(lines),):
        raise ValueError(f"modes must have shape {(len(lines),)}, got {ways.shape}")
    _, goal, posts = _scenery(state)
    return lines, ways.astype(np.int64), goal, posts


def _scenery(state: ArrayLike | Any) -> tuple[Array, Array, Array]:
    """Tip, goal and pillars (p, 4)."""
    array = as_array(state, "state")
    if array.ndim != 1 or len(array) < 10 or (len(array) - 6) % 4 or not np.isfinite(array).all():
        raise ValueError(
            "state must be finite of shape (6 + 4 * pillars,): tip, goal and pillars; got "
            f"{array.shape}"
        )
    return array[:3], array[3:6], array[6:].reshape(-1, 4)


def _skeleton(points: ArrayLike | Any) -> Array:
    array = as_array(points, "points")
    if array.shape != (10, 3) or not np.isfinite(array).all():
        raise ValueError(f"points must be finite of shape (10, 3), got {array.shape}")
    return array
