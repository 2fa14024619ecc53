"""How other projects' data sets show the states of a task."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Columns = Mapping[str, NDArray[Any]]

#: LeRobot's names of columns.
STATE, ENVIRONMENT_STATE = "observation.state", "observation.environment_state"
ACTION, EPISODE, FRAME = "action", "episode_index", "frame_index"


@dataclass(frozen=True)
class LeRobotLayout:
    """What a LeRobot data set of a task holds; `cotlearn.robots.episodes` reads and writes it.

    Attributes:
        instruction: the task, in English.
        robot: the type of the robot.
        control_seconds: between two frames.
        widths: columns of observations -> numbers in each frame.
        content: what these columns hold, for error messages.
        states: maps these columns (N, width), with `EPISODE` and `FRAME` (N,), to states
            (N, columns); raises ValueError where they are no states.
        observations: maps states to these columns.
        rewards: maps states to rewards (N,).
    """

    instruction: str
    robot: str
    control_seconds: float
    widths: Mapping[str, int]
    content: str
    states: Callable[[Columns], Array]
    observations: Callable[[Array], Columns]
    rewards: Callable[[Array], Array]
