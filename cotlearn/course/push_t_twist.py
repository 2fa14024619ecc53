"""Push-T with a twist, for homework 4: another goal, or a round obstacle in the way.

The obstacle is not solid: the finger can pass over it, and the steps inside it are counted.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cotlearn.robots.plane import rotate
from cotlearn.robots.push_t import GOAL, PushTVectorSim, coverage, random_state
from cotlearn.robots.push_t.constants import MAX_STEPS
from cotlearn.robots.push_t.definition import PUSH_T
from cotlearn.robots.task import check_numbers

Array = NDArray[np.float64]
EPISODES = 20


@dataclass(frozen=True)
class Twist:
    """A change to Push-T.

    Attributes:
        goal: x, y and angle of the T's target pose.
        obstacle: x, y and radius of a disc that the finger's centre should avoid; radius 0 means no
            obstacle.
    """

    goal: tuple[float, float, float] = GOAL
    obstacle: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Played:
    """The results of E = 20 episodes.

    Attributes:
        coverage: (E,), best coverage of the new goal.
        touched: (E,), number of control steps that ended with the finger inside the obstacle.
        path: (T + 1, E, 5), all states.
    """

    coverage: Array
    touched: NDArray[np.int64]
    path: Array


def covered(states: Array, goal: tuple[float, float, float]) -> Array:
    """The share of a goal that the T covers, (n,) from states (n, 5)."""
    turn = GOAL[2] - goal[2]
    place = rotate(states[:, 2:4] - goal[:2], np.cos(turn), np.sin(turn)) + GOAL[:2]
    return np.asarray(coverage(np.column_stack([place, states[:, 4] + turn])))


def play(act: Callable[[Array], Array], twist: Twist) -> Played:
    """Plays 20 episodes in parallel for `MAX_STEPS` steps, from starts outside the obstacle.

    Args:
        act: Maps histories of two states (20, 2, 5) to actions (20, n, 2) in world coordinates; all
            n actions are executed before the next call.
        twist: The goal and the obstacle.

    Raises:
        ValueError: `act` returns another shape or a position outside the world.
    """
    sim = PushTVectorSim(_starts(twist))
    path = [sim.states]
    plan = np.zeros((EPISODES, 0, 2))
    for _ in range(MAX_STEPS):
        if plan.shape[1] == 0:
            plan = np.asarray(act(np.stack([path[max(len(path) - 2, 0)], path[-1]], axis=1)))
            if plan.ndim != 3 or plan.shape[::2] != (EPISODES, 2) or plan.shape[1] == 0:
                raise ValueError(f"act must return shape ({EPISODES}, n, 2), got {plan.shape}")
            check_numbers(plan, PUSH_T.action_limits, "actions of act", shape=plan.shape)
        sim.step(plan[:, 0])
        plan = plan[:, 1:]
        path.append(sim.states)
    states = np.array(path)
    scores = np.array([covered(row, twist.goal) for row in states])
    return Played(scores.max(axis=0), _inside(states[1:], twist).sum(axis=0), states)


def _inside(states: Array, twist: Twist) -> NDArray[np.bool_]:
    x, y, radius = twist.obstacle
    return np.asarray(np.hypot(states[..., 0] - x, states[..., 1] - y) < radius)


def _starts(twist: Twist) -> Array:
    seeds = itertools.count(2_000_000)  # as `COUNTED` of the course, whose tasks have no obstacle
    drawn = (np.array(random_state(np.random.default_rng(seed))) for seed in seeds)
    free = (state for state in drawn if not _inside(state, twist))
    return np.array(list(itertools.islice(free, EPISODES)))
