"""Figures of the arm: paths of its tip from above and in 3D, and the arm itself."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from cotlearn.plots._canvas import Array, Numbers, as_array, open_axes
from cotlearn.plots.style import PATH_COLOR, SOURCE_COLOR, condition_color
from cotlearn.robots.arm.constants import GOAL, pillars
from cotlearn.robots.arm.drawing import GOAL_MARK, PILLAR, VIEWS, draw_arm, draw_pillar

SIZE = (4.6, 3.6)
_FAILED = -1


def arm_paths(
    paths: Numbers, state: Numbers, *, modes: Numbers, ax: Axes | None = None, title: str = ""
) -> Axes:
    """Draw paths of the tip from above, with the pillars to scale and a ring at the goal.

    Args:
        paths: (n, T, 3), metres.
        state: (columns,): tip, goal and pillars; see `cotlearn.robots.arm.constants.columns`.
        modes: (n,), the mode of each path, which colours it; -1, a failure, is grey,
            dashed and ends in a cross.
        ax: Axes to draw into; a new figure by default.
        title: title of the panel.
    """
    lines, scene = as_array(paths, "n", "T", 3), as_array(state, "columns")
    ax = open_axes(ax, SIZE)
    for x, y, radius, _ in pillars(scene):
        ax.add_patch(Circle((x, y), radius, facecolor=PILLAR, edgecolor="none", zorder=3))
    goal, ring = scene[GOAL][:2], {"edgecolor": GOAL_MARK, "linewidth": 1.8, "zorder": 5}
    ax.add_patch(Circle(goal, 0.025, fill=False, **ring))
    of_mode = _by_mode(lines, modes)
    for mode, some in of_mode.items():
        ax.add_collection(LineCollection(some[..., :2], zorder=2, **_look(mode)))
    x, y, _ = of_mode.get(_FAILED, lines[:0])[:, -1].T
    ax.scatter(x, y, marker="x", s=22, color=SOURCE_COLOR, linewidths=1.0, zorder=6)
    x, y, _ = lines[:, 0].T
    ax.scatter(x, y, s=16, color=SOURCE_COLOR, zorder=5, linewidths=0)
    ax.set_aspect("equal", adjustable="datalim")
    ax.autoscale_view()
    ax.set(xlabel="x in metres", ylabel="y in metres", title=title)
    return ax


def arm_paths_3d(
    paths: Numbers,
    state: Numbers,
    *,
    modes: Numbers,
    labels: Sequence[str],
    ax: Any = None,
    title: str = "",
) -> Any:
    """Draw paths of the tip in 3D, with a legend of the modes that occur.

    Args:
        paths: (n, T, 3), metres.
        state: (columns,), as in :func:`arm_paths`.
        modes: (n,), as in :func:`arm_paths`.
        labels: labels of the modes 0, 1, ...
        ax: 3D axes; a new figure by default.
        title: title of the panel.
    """
    lines, scene = as_array(paths, "n", "T", 3), as_array(state, "columns")
    ax = _open_space(ax)
    for pillar in pillars(scene):
        draw_pillar(ax, pillar)
    for mode, some in _by_mode(lines, modes).items():
        label = "failed" if mode == _FAILED else labels[mode]
        ax.add_collection3d(Line3DCollection(some, label=label, **_look(mode)))
    ax.scatter(*lines[:, 0].T, s=14, color=SOURCE_COLOR, depthshade=False)
    ax.scatter(*scene[GOAL], s=34, facecolors="none", edgecolors=GOAL_MARK, linewidths=1.8)
    tops = pillars(scene)[:, [0, 1, 3]]
    every = np.concatenate([lines.reshape(-1, 3), scene[None, GOAL], tops])
    low, high = every.min(axis=0) - 0.03, every.max(axis=0) + 0.03
    low[2] = 0.0
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low)
    ax.view_init(*VIEWS["front"])
    ax.legend(loc="upper left", fontsize="small")
    return _finish_space(ax, title)


def arm_pose(points: Numbers, state: Numbers, *, ax: Any = None, title: str = "") -> Any:
    """Draw the arm among its pillars, as lines between its joints.

    Args:
        points: (10, 3), base, seven joints, flange and tip: `cotlearn.robots.arm.skeleton(joints)`.
        state: (columns,), as in :func:`arm_paths`.
        ax: 3D axes; a new figure by default.
        title: title of the panel.
    """
    ax = _open_space(ax)
    draw_arm(ax, as_array(points, 10, 3), as_array(state, "columns"))
    return _finish_space(ax, title)


def _by_mode(lines: Array, modes: Numbers) -> dict[int, Array]:
    """The lines of each mode that occurs."""
    numbers = as_array(modes, len(lines)).astype(int)
    return {mode: lines[numbers == mode] for mode in np.unique(numbers).tolist()}


def _look(mode: int) -> dict[str, Any]:
    """A colour for each of ten modes, then dashed lines; failures are grey and dashed."""
    failed = mode == _FAILED
    return {
        "colors": PATH_COLOR if failed else condition_color(mode),
        "linestyles": (0, (3, 2)) if failed or mode >= 10 else "-",
        "linewidths": 1.2,
        "alpha": 0.85,
    }


def _open_space(ax: Any) -> Any:
    if ax is not None:
        return ax
    figure = plt.figure(figsize=SIZE, layout="none")  # no layout sees the words of 3D axes
    return figure.add_axes((0.0, 0.06, 0.88, 0.88), projection="3d")


def _finish_space(ax: Any, title: str) -> Any:
    ax.set(xlabel="x in metres", ylabel="y in metres", zlabel="z in metres", title=title)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_major_locator(MaxNLocator(3, prune="upper"))
    return ax
