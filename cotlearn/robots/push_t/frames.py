"""Push-T seen from the T, from the agent, or as it is."""

import numpy as np

from cotlearn.robots.plane import rotate
from cotlearn.robots.push_t.task import GOAL
from cotlearn.robots.task import Array, IdentityFrame


class BodyFrame:
    """Everything seen from the T.

    A state becomes the agent's place, the goal's place, and the cosine and sine of the goal's
    angle, all in the frame of the T of that state; actions are seen from the T of the last one.
    """

    features = 6

    def observe(self, history: Array) -> Array:
        """(B, T, 6) from states (B, T, 5)."""
        agent, place, angle = history[..., :2], history[..., 2:4], history[..., 4]
        goal = _turn(np.array(GOAL[:2]) - place, -angle)
        return _features(_turn(agent - place, -angle), goal, GOAL[2] - angle)

    def to_frame(self, actions: Array, history: Array) -> Array:
        """Actions (B, n, 2) seen from the T of the last state."""
        pose = history[:, -1:, 2:]
        return _turn(actions - pose[..., :2], -pose[..., 2])

    def from_frame(self, actions: Array, history: Array) -> Array:
        """The inverse of `to_frame`."""
        pose = history[:, -1:, 2:]
        return _turn(actions, pose[..., 2]) + pose[..., :2]


class WorldFrame(IdentityFrame):
    """Actions as they are; of a state, the cosine and sine of the T's angle for the angle."""

    def __init__(self) -> None:
        super().__init__(features=6)

    def observe(self, history: Array) -> Array:
        """(B, T, 6) from states (B, T, 5)."""
        return _features(history[..., :2], history[..., 2:4], history[..., 4])


class AgentFrame(WorldFrame):
    """States as in the world, actions as seen from the agent.

    A policy with a camera can have this frame: it knows where its hand is, and not where the T is.
    """

    def to_frame(self, actions: Array, history: Array) -> Array:
        """Actions (B, n, 2) less the place of the agent in the last state."""
        return actions - history[:, -1:, :2]

    def from_frame(self, actions: Array, history: Array) -> Array:
        """The inverse of `to_frame`."""
        return actions + history[:, -1:, :2]


def _features(agent: Array, place: Array, angle: Array) -> Array:
    return np.concatenate([agent, place, np.cos(angle)[..., None], np.sin(angle)[..., None]], -1)


def _turn(points: Array, angle: Array) -> Array:
    """Points (..., 2) turned by angles (...)."""
    return rotate(points, np.cos(angle), np.sin(angle))
