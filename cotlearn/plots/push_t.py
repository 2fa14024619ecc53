"""Push-T from above: a state, the path of the T in an episode, chunks of actions, an animation."""

from collections.abc import Mapping

import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle, Polygon

from cotlearn.plots._canvas import Numbers, as_array, open_plane, panels
from cotlearn.plots.motion import animation_of
from cotlearn.plots.style import COLORS, CONDITION_MAP, SOURCE_COLOR
from cotlearn.robots.push_t.constants import AGENT_RADIUS, GOAL, SIZE
from cotlearn.robots.push_t.geometry import corners

BLOCK, GOAL_AREA = "#8895A7", "#B5DDB0"


def push_t_state(state: Numbers, *, ax: Axes | None = None, title: str = "") -> Axes:
    """Draw one state: the goal in green, the T in grey, the round agent.

    Args:
        state: (5,): agent x and y, T x, y and angle.
        ax: Axes to draw into; a new figure by default.
        title: title of the panel.
    """
    now = as_array(state, 5)
    ax = _world(ax, title)
    ax.add_patch(Polygon(corners(now[2:]), facecolor=BLOCK, edgecolor=SOURCE_COLOR, zorder=2))
    ax.add_patch(Circle(now[:2], AGENT_RADIUS, color=COLORS["independent"], zorder=3))
    return ax


def push_t_episode(states: Numbers, *, ax: Axes | None = None, title: str = "") -> Axes:
    """Draw an episode: the agent's path, early dark and late bright, and the T at six times.

    Args:
        states: (T, 5), T at least 2, as in :func:`push_t_state`.
        ax: Axes to draw into; a new figure by default.
        title: title of the panel.
    """
    array = as_array(states, "T", 5)
    ax = _world(ax, title)
    times = np.linspace(0, len(array) - 1, 6).round().astype(int)
    for pose, strength in zip(array[times, 2:], np.linspace(0.25, 1, 6), strict=True):
        line = {"edgecolor": SOURCE_COLOR, "alpha": strength, "linewidth": 0.8 + strength}
        ax.add_patch(Polygon(corners(pose), fill=False, **line))
    agent = array[:, :2]
    pieces = list(np.stack([agent[:-1], agent[1:]], axis=1))
    path = LineCollection(pieces, cmap=CONDITION_MAP, linewidths=1.4, zorder=3)
    path.set_array(np.linspace(0, 1, len(pieces)))
    ax.add_collection(path, autolim=False)
    ax.add_patch(Circle(agent[0], AGENT_RADIUS, fill=False, edgecolor=SOURCE_COLOR, zorder=4))
    return ax


def push_t_chunks(
    state: Numbers,
    chunks: Numbers,
    *,
    ax: Axes | None = None,
    title: str = "",
    color: str = COLORS["minibatch_ot"],
) -> Axes:
    """Draw chunks of actions over the state in which they begin; a dot ends each.

    Args:
        state: (5,), as in :func:`push_t_state`.
        chunks: (n, T, 2), targets of the agent in pixels.
        ax: Axes to draw into; a new figure by default.
        title: title of the panel.
        color: color of the chunks.
    """
    array = as_array(chunks, "n", "T", 2)
    ax = push_t_state(state, ax=ax, title=title)
    begin = np.broadcast_to(as_array(state)[:2], (len(array), 1, 2))
    lines = list(np.concatenate([begin, array], axis=1))
    drawn = LineCollection(lines, colors=color, linewidths=0.8, alpha=0.5, zorder=4)
    ax.add_collection(drawn, autolim=False)
    ax.scatter(array[:, -1, 0], array[:, -1, 1], s=9, color=color, zorder=5, linewidths=0)
    return ax


def push_t_animation(episodes: Mapping[str, Numbers], *, every: int, panel: float) -> FuncAnimation:
    """Animate episodes side by side; ended episodes stand still. Show it with `plots.gif`.

    Args:
        episodes: title -> (T, 5) states.
        every: steps from one frame to the next.
        panel: side of a panel in inches.
    """
    arrays = {name: as_array(states, "T", 5) for name, states in episodes.items()}
    figure, axes = panels(len(arrays), size=panel)
    for ax, (name, array) in zip(axes, arrays.items(), strict=True):
        push_t_state(array[0], ax=ax, title=name)

    def draw(frame: int) -> None:
        for ax, array in zip(axes, arrays.values(), strict=True):
            state = array[min(frame * every, len(array) - 1)]
            *_, tee, disc = ax.patches
            tee.set_xy(corners(state[2:]))
            disc.center = state[:2]

    # the last frame shows the end of the longest episode
    return animation_of(figure, draw, frames=1 - (1 - max(map(len, arrays.values()))) // every)


def _world(ax: Axes | None, title: str) -> Axes:
    """The empty world with its goal, y pointing down as in the environment's pictures."""
    ax = open_plane(ax)
    ax.add_patch(Polygon(corners(GOAL), facecolor=GOAL_AREA, edgecolor="none", zorder=1))
    ax.set(xlabel="x in pixels", ylabel="y in pixels", title=title)
    ax.set(xlim=(0, SIZE), ylim=(SIZE, 0), xticks=(0, 256, 512), yticks=(0, 256, 512))
    ax.set_aspect("equal", adjustable="box")
    ax.label_outer()
    return ax
