"""gym-pusht 0.1.8 itself, made to run beside pymunk 7 and without its graphics libraries.

It asks for pymunk 6 only because of a contact counter, whose call pymunk 7 renamed; the counter
goes into `info` and touches nothing else. pygame and OpenCV are used for pictures alone.
"""

import sys
from unittest import mock

import pymunk

GRAPHICS = ("pygame", "pymunk.pygame_util", "cv2", "gym_pusht.envs.pymunk_override")


def make():
    """Returns gym-pusht's environment with state observations.

    Raises:
        ModuleNotFoundError: it or shapely is not installed.
    """
    with (
        mock.patch.dict(sys.modules, {name: mock.MagicMock() for name in GRAPHICS}),
        mock.patch.object(pymunk, "pygame_util", mock.MagicMock(), create=True),
    ):
        from gym_pusht.envs.pusht import PushTEnv
    return PushTEnv()


def without_counter():
    """A context in which gym-pusht's registration of its contact counter does nothing."""
    return mock.patch.object(pymunk.Space, "add_collision_handler", mock.Mock(), create=True)


def start(peer, state):
    """Puts gym-pusht at `state`, the pose of the T being the one asked for."""
    peer.reset(seed=0)
    with without_counter():
        peer._setup()
    peer.agent.position = tuple(state[:2])
    peer.block.angle = state[4]
    peer.block.position = tuple(state[2:4])
    peer.space.step(peer.dt)
