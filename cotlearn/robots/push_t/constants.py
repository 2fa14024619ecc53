"""The constants of Push-T: lengths in pixels, angles in radians, times in seconds."""

import math

SIZE = 512.0  #: the world is the square [0, SIZE]², and so is the space of actions
GOAL = (256.0, 256.0, math.pi / 4)  #: pose of the block that covers the outline: x, y, angle
AGENT_RADIUS = 15.0
MAX_STEPS = 300  #: control steps of an episode
SUCCESS = 0.95  #: coverage above this ends the episode

CONTROL_SECONDS = 0.1  #: between two actions
PHYSICS_SECONDS = 0.01
SUBSTEPS = round(CONTROL_SECONDS / PHYSICS_SECONDS)
STIFFNESS, DAMPING = 100.0, 20.0  #: gains of the controller that pulls the agent to the action

#: The T in its own frame as rectangles (x0, x1, y0, y1). The origin, whose position a pose gives,
#: is the middle of the bar's outer edge.
BAR = (-60.0, 60.0, 0.0, 30.0)
STEM = (-15.0, 15.0, 30.0, 120.0)
RECTANGLES = (BAR, STEM)
AREA = sum((x1 - x0) * (y1 - y0) for x0, x1, y0, y1 in RECTANGLES)

_X = (-60.0, 60.0, 60.0, 15.0, 15.0, -15.0, -15.0, -60.0)
_Y = (0.0, 0.0, 30.0, 30.0, 120.0, 120.0, 30.0, 30.0)
#: The outline of the T, counterclockwise where y points up.
OUTLINE = tuple(zip(_X, _Y, strict=True))

#: The corners of bar and stem, in the order of gym-pusht's keypoints.
KEYPOINTS = tuple(
    corner for x0, x1, y0, y1 in RECTANGLES for corner in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
)

PIXEL = 1 / 32  #: unit of stored positions, pixels; the expert's actions are multiples of it
TURN = 2 * math.pi / 65536  #: unit of stored angles: one turn fills 16 bits

MASS = 1.0
CENTRE_OF_GRAVITY = (0.0, 45.0)  #: in the frame of the T; not the centroid of its area
WALLS = (5.0, 506.0)  #: the middle lines of the four walls, which stop the T but not the agent
WALL_RADIUS = 2.0
