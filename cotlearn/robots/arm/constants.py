"""The constants of the arm's tasks: lengths in metres, angles in radians, times in seconds.

The arm stands at the origin and faces along x; the table top is z = 0. The tool is a rod that
always points straight down; actions move its tip. Pillars are upright capsules: cylinders with a
round top.
"""

import numpy as np
from numpy.typing import NDArray

KINDS = ("ring", "avoid")
ROWS = {"ring": (1,), "avoid": (2, 3)}  #: pillars in each row that the tip has to pass
PILLARS = {kind: sum(rows) for kind, rows in ROWS.items()}
#: Names of the modes, the ways past the pillars: left and right in the direction from start to
#: goal; gaps in the order of y.
MODES = {
    "ring": ("left", "right", "over"),
    "avoid": tuple(f"gap {first}, gap {second}" for first in range(3) for second in range(4)),
}

TIP, GOAL = slice(0, 3), slice(3, 6)  #: columns of a state
FIRST_PILLAR = 6  #: first column of the pillars: x, y, radius and height of each

MAX_STEPS = 40  #: control steps of an episode
CONTROL_SECONDS = 0.1  #: between two actions
PHYSICS_SECONDS = 0.01
SUBSTEPS = round(CONTROL_SECONDS / PHYSICS_SECONDS)
SETTLE = 3  #: control steps for which the last target is held before success is judged
SUCCESS = 0.025  #: the tip must end this close to the goal

ROD_RADIUS = 0.01
TOOL = 0.26  #: from the flange to the tip

#: Targets of the tip lie in this box; not every point in it can be reached.
LOW = np.array([0.15, -0.45, 0.0])
HIGH = np.array([0.85, 0.45, 0.6])

UNIT = 2.0**-14  #: unit of stored positions, metres; the expert's actions are multiples of it
FAR = 2.0  #: largest absolute value in a state
PICTURE = (960, 720)  #: largest width and height of a rendered image, pixels

#: Ranges of the random starts.
RING_RADIUS = (0.15, 0.20)  #: distance of start and goal from the pillar
RING_TURN = 0.5  #: largest deviation of the goal from the direction opposite to the start
RING_PILLAR = ((0.49, 0.55), (-0.05, 0.05), (0.03, 0.05), (0.12, 0.20))  #: x, y, radius, height
RING_HEIGHT = (0.04, 0.08)  #: of start and goal
AVOID_START = ((0.30, 0.33), (-0.12, 0.12), (0.04, 0.08))  #: x, y, z
AVOID_GOAL = ((0.70, 0.73), (-0.12, 0.12), (0.04, 0.08))
AVOID_ROWS = ((0.42, (-0.075, 0.075)), (0.61, (-0.145, 0.0, 0.145)))  #: x, and y of each pillar
AVOID_JITTER = (0.01, 0.015)  #: of x and y of a pillar
AVOID_PILLAR = ((0.02, 0.03), (0.12, 0.18))  #: radius, height


def columns(kind: str) -> tuple[str, ...]:
    """The names of a state's columns."""
    names = ["tip x", "tip y", "tip z", "goal x", "goal y", "goal z"]
    for number in range(1, PILLARS[kind] + 1):
        names += [f"pillar {number} {what}" for what in ("x", "y", "radius", "height")]
    return tuple(names)


def pillars(states: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pillars (..., pillars, 4) of states (..., columns): x, y, radius and height."""
    return states[..., FIRST_PILLAR:].reshape(*states.shape[:-1], -1, 4)
