"""Push-T's coordinate frames: the T's, the agent's and the world's."""

import numpy as np

from cotlearn.robots.plane import rotate
from cotlearn.robots.push_t.constants import GOAL
from cotlearn.robots.task import Array, Frame


class BodyFrame(Frame):
    """The frame of the T.

    A state becomes the agent's position, the goal's position, and the cosine and sine of the goal's
    angle, all in the frame of the T in that state. Actions are in the frame of the T in the last
    state.
    """

    def __init__(self) -> None:
        super().__init__(features=6)

    def observe(self, history: Array) -> Array:
        """(B, T, 6) from states (B, T, 5)."""
        agent, place, angle = history[..., :2], history[..., 2:4], history[..., 4]
        goal = _turn(np.array(GOAL[:2]) - place, -angle)
        return _features(_turn(agent - place, -angle), goal, GOAL[2] - angle)

    def to_frame(self, actions: Array, history: Array) -> Array:
        """Transform world actions (B, n, 2) to the frame of the T in the last state."""
        pose = history[:, -1:, 2:]
        return _turn(actions - pose[..., :2], -pose[..., 2])

    def from_frame(self, actions: Array, history: Array) -> Array:
        """The inverse of `to_frame`."""
        pose = history[:, -1:, 2:]
        return _turn(actions, pose[..., 2]) + pose[..., :2]


class WorldFrame(Frame):
    """The world frame; observations hold the cosine and sine of the T's angle, not the angle."""

    def __init__(self) -> None:
        super().__init__(features=6)

    def observe(self, history: Array) -> Array:
        """(B, T, 6) from states (B, T, 5)."""
        return _features(history[..., :2], history[..., 2:4], history[..., 4])


class AgentFrame(WorldFrame):
    """States in the world frame, actions relative to the agent.

    A policy with a camera can use this frame: it knows the agent's position, but not the T's pose.
    """

    def to_frame(self, actions: Array, history: Array) -> Array:
        """Actions (B, n, 2) minus the agent's position in the last state."""
        return actions - history[:, -1:, :2]

    def from_frame(self, actions: Array, history: Array) -> Array:
        """The inverse of `to_frame`."""
        return actions + history[:, -1:, :2]


def _features(agent: Array, place: Array, angle: Array) -> Array:
    return np.concatenate([agent, place, np.cos(angle)[..., None], np.sin(angle)[..., None]], -1)


def _turn(points: Array, angle: Array) -> Array:
    """Rotate points (..., 2) by angles (...)."""
    return rotate(points, np.cos(angle), np.sin(angle))
