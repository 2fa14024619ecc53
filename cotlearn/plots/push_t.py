"""Push-T from above: a state, the T's way through an episode, chunks of actions, an animation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle, Polygon
from numpy.typing import ArrayLike, NDArray

from cotlearn.plots._arrays import as_array
from cotlearn.plots._canvas import finish, open_plane, panels
from cotlearn.plots.style import COLORS, CONDITION_MAP, SOURCE_COLOR

BLOCK, GOAL_AREA = "#8895A7", "#B5DDB0"


def push_t_state(
    state: ArrayLike | Any, *, ax: Axes | None = None, title: str | None = None
) -> Axes:
    """Draw one state: the goal in green, the T in grey, the round agent.

    Args:
        state: (5,): agent x and y, T x, y and angle.
        ax: where to draw; a new figure by default.
        title: words above the panel.

    Raises:
        ValueError: not five finite numbers.
    """
    agent, pose = _split(state, "state", 1)
    ax = _world(ax, title)
    ax.add_patch(Polygon(_tee(pose), facecolor=BLOCK, edgecolor=SOURCE_COLOR, zorder=2))
    ax.add_patch(
        Circle((agent[0], agent[1]), _agent_radius(), color=COLORS["independent"], zorder=3)
    )
    return ax


def push_t_episode(
    states: ArrayLike | Any,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    outlines: int = 6,
) -> Axes:
    """Draw an episode: the agent's path, early dark and late bright, and the T at a few times.

    Args:
        states: (T, 5), T at least 2, as in :func:`push_t_state`.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        outlines: how often the T is drawn, at least 2; later ones have stronger lines.

    Raises:
        ValueError: a shape does not fit, or a state is not finite.
    """
    agent, pose = _split(states, "states", 2)
    if outlines < 2:
        raise ValueError(f"outlines must be at least 2, got {outlines}")
    ax = _world(ax, title)
    for rank, row in enumerate(np.linspace(0, len(pose) - 1, outlines).round().astype(int)):
        strength = 0.25 + 0.75 * rank / (outlines - 1)
        line: dict[str, Any] = {
            "edgecolor": SOURCE_COLOR,
            "alpha": strength,
            "linewidth": 0.8 + strength,
        }
        ax.add_patch(Polygon(_tee(pose[row]), fill=False, **line))
    pieces = np.stack([agent[:-1], agent[1:]], axis=1)
    path = LineCollection(list(pieces), cmap=CONDITION_MAP, linewidths=1.4, zorder=3)
    path.set_array(np.linspace(0, 1, len(pieces)))
    ax.add_collection(path, autolim=False)
    ax.add_patch(
        Circle(tuple(agent[0]), _agent_radius(), fill=False, edgecolor=SOURCE_COLOR, zorder=4)
    )
    return ax


def push_t_chunks(
    state: ArrayLike | Any,
    chunks: ArrayLike | Any,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    color: str = COLORS["minibatch_ot"],
) -> Axes:
    """Draw chunks of actions over the state in which they begin; a dot ends each.

    Args:
        state: (5,), as in :func:`push_t_state`.
        chunks: (n, T, 2), targets of the agent in pixels.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        color: of the chunks.

    Raises:
        ValueError: a shape does not fit, or a value is not finite.
    """
    array = as_array(chunks, "chunks")
    if array.ndim != 3 or array.shape[2] != 2 or 0 in array.shape or not np.isfinite(array).all():
        raise ValueError(f"chunks must be finite of shape (n, T, 2), got {array.shape}")
    ax = push_t_state(state, ax=ax, title=title)
    begin = np.broadcast_to(_split(state, "state", 1)[0], (len(array), 1, 2))
    lines = list(np.concatenate([begin, array], axis=1))
    look: dict[str, Any] = {"colors": color, "linewidths": 0.8, "alpha": 0.5, "zorder": 4}
    ax.add_collection(LineCollection(lines, **look), autolim=False)
    ax.scatter(array[:, -1, 0], array[:, -1, 1], s=9, color=color, zorder=5, linewidths=0)
    return ax


def push_t_animation(
    episodes: Mapping[str, ArrayLike | Any],
    *,
    every: int = 4,
    panel: float = 2.2,
    interval: int = 80,
) -> FuncAnimation:
    """Animate episodes side by side; one that is over stands still. Show it with `plots.gif`.

    Args:
        episodes: title -> (T, 5) states.
        every: steps from one frame to the next.
        panel: side of a panel in inches.
        interval: milliseconds a frame.

    Raises:
        ValueError: no episodes, a shape that does not fit, or ``every`` below 1.
    """
    parts = {name: _split(states, f"episodes[{name!r}]", 2) for name, states in episodes.items()}
    if not parts or every < 1:
        raise ValueError(f"expected at least one episode and every >= 1, got {every=}")
    figure, axes = panels(len(parts), size=panel)
    drawn = []
    for ax, (name, (agent, pose)) in zip(axes, parts.items(), strict=True):
        push_t_state(np.concatenate([agent[0], pose[0]]), ax=ax, title=name)
        drawn.append((ax.patches[-2], ax.patches[-1]))
    longest = max(len(agent) for agent, _ in parts.values())

    def draw(frame: int) -> list[Any]:
        for (tee, disc), (agent, pose) in zip(drawn, parts.values(), strict=True):
            row = min(frame * every, len(agent) - 1)
            tee.set_xy(_tee(pose[row]))
            disc.center = tuple(agent[row])
        return [patch for pair in drawn for patch in pair]

    frames = -(-(longest - 1) // every) + 1
    animation = FuncAnimation(figure, draw, frames=frames, interval=interval, blit=False)
    plt.close(figure)
    return animation


def _world(ax: Axes | None, title: str | None) -> Axes:
    """The empty world with its goal, y pointing down as in the environment's pictures."""
    from cotlearn.robots.push_t.task import GOAL, SIZE  # late: it loads the physics

    ax = open_plane(ax)
    ax.add_patch(Polygon(_tee(np.array(GOAL)), facecolor=GOAL_AREA, edgecolor="none", zorder=1))
    finish(ax, xlabel="x in pixels", ylabel="y in pixels", title=title)
    ax.set(xlim=(0, SIZE), ylim=(SIZE, 0), xticks=(0, 256, 512), yticks=(0, 256, 512))
    ax.set_aspect("equal", adjustable="box")
    ax.grid(False)
    ax.label_outer()
    return ax


def _tee(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    from cotlearn.robots.push_t.geometry import corners

    return corners(pose)


def _agent_radius() -> float:
    from cotlearn.robots.push_t.task import AGENT_RADIUS

    return AGENT_RADIUS


def _split(
    value: ArrayLike | Any, name: str, ndim: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Agent and pose of one state (5,) or of several (T, 5)."""
    array = as_array(value, name)
    short = ndim == 2 and len(np.atleast_1d(array)) < 2
    if array.ndim != ndim or array.shape[-1] != 5 or short or not np.isfinite(array).all():
        expected = "(5,)" if ndim == 1 else "(T >= 2, 5)"
        raise ValueError(f"{name} must be finite of shape {expected}, got {array.shape}")
    return array[..., :2], array[..., 2:]
