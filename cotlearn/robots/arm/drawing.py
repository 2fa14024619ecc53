"""Draws the arm and its pillars with matplotlib, for machines without OpenGL."""

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from cotlearn.robots.arm.constants import GOAL, pillars
from cotlearn.robots.task import Array

Image = NDArray[np.uint8]

PILLAR, GOAL_MARK = "#E07B39", "#2CA05A"
SHELL, JOINT, ROD = "#F2F2F4", "#3D4552", "#1F6FB2"
TABLE, EDGE = "#EFE8DC", "#B9AE9C"
VIEWS = {"front": (26.0, -58.0), "above": (89.9, -180.0)}  #: elevation and azimuth, degrees


def arm_space(figure: Figure) -> Any:
    """Add 3D axes that cover a figure to its edges.

    3D axes draw in a square; this square is as wide as the longer side of the figure and extends
    beyond the shorter one.
    """
    width, height = figure.get_size_inches()
    wide, high = max(width, height) / width, max(width, height) / height
    return figure.add_axes(((1 - wide) / 2, (1 - high) / 2, wide, high), projection="3d")


def draw_picture(points: Array, state: Array, size: tuple[int, int], view: str) -> Image:
    """Render `draw_arm` without axes to an image (height, width, 3), uint8.

    Args:
        points: as for `draw_arm`.
        state: as for `draw_arm`.
        size: width and height in pixels.
        view: a key of `VIEWS`.
    """
    figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100)
    canvas, ax = FigureCanvasAgg(figure), arm_space(figure)
    draw_arm(ax, points, state, view=view, zoom=0.85 if view == "above" else 1.05)
    ax.set_axis_off()
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3].copy()


def draw_arm(ax: Any, points: Array, state: Array, *, view: str = "front", zoom: float = 1) -> None:
    """Draws the arm as lines between its joints, the table, the pillars and the goal.

    Args:
        ax: 3D axes.
        points: (10, 3), base, seven joints, flange and tip, as `skeleton` returns them.
        state: (columns,), see `constants.columns`.
        view: a key of `VIEWS`.
        zoom: magnification; 1 leaves room for the labels of the axes.
    """
    corners = np.array([[-0.13, -0.48], [0.88, -0.48], [0.88, 0.48], [-0.13, 0.48]])
    table = np.column_stack([corners, np.zeros(4)])
    ax.add_collection3d(Poly3DCollection([table], facecolor=TABLE, edgecolor=EDGE, zorder=0))
    ax.computed_zorder = False  # fixed order: table at the back, arm in front
    for pillar in pillars(state):
        draw_pillar(ax, pillar)
    ax.scatter(*state[GOAL], s=26, color=GOAL_MARK, zorder=3, depthshade=False)
    arm, joints, tool = points[:-1], points[[1, 3, 4, 5, 7]], points[-2:]
    ends: dict[str, Any] = {"solid_capstyle": "round", "solid_joinstyle": "round", "zorder": 5}
    ax.plot(*arm.T, color=JOINT, linewidth=11.0, **ends)
    ax.plot(*arm.T, color=SHELL, linewidth=8.5, **ends)
    ax.plot(*joints.T, color=JOINT, linestyle="none", marker="o", markersize=9, zorder=5)
    ax.plot(*tool.T, color=JOINT, linewidth=4.0, **ends)
    ax.plot(*tool.T, color=ROD, linewidth=2.4, **ends)
    ax.set(xlim=(-0.1, 0.85), ylim=(-0.45, 0.45), zlim=(0.0, 0.8))
    ax.set_box_aspect((0.95, 0.9, 0.8), zoom=zoom)
    ax.view_init(*VIEWS[view])


def draw_pillar(ax: Any, pillar: Array) -> None:
    """Draws a cylinder with a round top, lit from the front.

    Args:
        ax: 3D axes.
        pillar: x, y, radius and height.
    """
    x, y, radius, height = pillar
    turn = np.linspace(0, 2 * np.pi, 25)
    bow = np.linspace(0, np.pi / 2, 7)
    rise = np.concatenate([[0.0], height - radius + radius * np.sin(bow)])
    wide = np.concatenate([[radius], radius * np.cos(bow)])
    shade = 0.85 + 0.15 * np.cos(turn + 1.4)
    colour = np.broadcast_to(np.array(to_rgb(PILLAR)) * shade[:, None], (len(rise), 25, 3))
    ax.plot_surface(
        x + wide[:, None] * np.cos(turn),
        y + wide[:, None] * np.sin(turn),
        np.repeat(rise[:, None], len(turn), axis=1),
        facecolors=colour,
        shade=False,
        linewidth=0,
        antialiased=False,
        zorder=2,  # used because computed_zorder is False
    )
