"""The physics of Push-T on pymunk, bare: for experts, rollouts and the gymnasium environment.

The agent is kinematic: a controller pulls it to the action, and nothing stops it. The T forgets
its velocity in every step (`damping` 0), so that it moves only while it is pushed. There is no
friction.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.push_t import task
from cotlearn.robots.push_t.geometry import coverage_of_one

Array = NDArray[np.float64]
State = tuple[float, float, float, float, float]


def random_state(generator: np.random.Generator) -> State:
    """Draws a start as gym-pusht does: the same generator gives the same start.

    gym-pusht sets the position of an upright T and then turns it about its centre of gravity.
    So it is the centre of gravity that is spread evenly over a square, and the T stays clear of
    the walls for nearly all starts.
    """
    agent = generator.integers(50, 450), generator.integers(50, 450)
    place = generator.integers(100, 400), generator.integers(100, 400)
    angle = float(generator.uniform(-math.pi, math.pi))
    gravity_x, gravity_y = task.CENTRE_OF_GRAVITY
    x = place[0] + gravity_x - (math.cos(angle) * gravity_x - math.sin(angle) * gravity_y)
    y = place[1] + gravity_y - (math.sin(angle) * gravity_x + math.cos(angle) * gravity_y)
    return float(agent[0]), float(agent[1]), float(x), float(y), angle


class Simulation:
    """One Push-T world.

    Args:
        state: (5,), agent x and y, T x, y and angle.
    """

    def __init__(self, state: ArrayLike) -> None:
        self.reset(state)

    def reset(self, state: ArrayLike) -> None:
        """Starts a new world at `state`.

        One physics step with a resting agent follows, as in gym-pusht: if the T overlaps the agent
        or a wall, it begins to be pushed out.

        Raises:
            ValueError: `state` is not five finite numbers.
        """
        values = np.asarray(state, dtype=np.float64)
        if values.shape != (5,) or not np.isfinite(values).all():
            raise ValueError(
                f"state must be 5 finite numbers (agent x, y, T x, y, angle), got {state!r}"
            )
        agent_x, agent_y, x, y, angle = values.tolist()
        import pymunk  # late: who wants the numbers of the task needs no physics

        self._space = pymunk.Space()
        self._space.damping = 0.0
        self._space.add(*_walls(self._space.static_body))
        self._agent = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        self._agent.position = agent_x, agent_y
        self._space.add(self._agent, pymunk.Circle(self._agent, task.AGENT_RADIUS))
        self._block, shapes = _tee()
        self._space.add(self._block, *shapes)
        self._block.angle = angle  # first: turning is about the centre of gravity
        self._block.position = x, y
        self._velocity = (0.0, 0.0)
        self._covered: tuple[float, float, float, float] | None = None
        self._space.step(task.PHYSICS_SECONDS)

    def step(self, x: float, y: float) -> None:
        """Lets the agent follow the target (x, y) for one control step. Nothing is checked."""
        space_step, agent = self._space.step, self._agent
        seconds, stiffness, damping = task.PHYSICS_SECONDS, task.STIFFNESS, task.DAMPING
        agent_x, agent_y = agent.position
        vx, vy = self._velocity
        for _ in range(task.SUBSTEPS):
            vx += (stiffness * (x - agent_x) - damping * vx) * seconds
            vy += (stiffness * (y - agent_y) - damping * vy) * seconds
            agent.velocity = vx, vy
            space_step(seconds)
            agent_x += vx * seconds
            agent_y += vy * seconds
        self._velocity = vx, vy

    @property
    def state(self) -> State:
        """Agent x and y, T x, y and angle; the angle is not reduced to one turn."""
        agent, block = self._agent.position, self._block.position
        return agent.x, agent.y, block.x, block.y, self._block.angle

    @property
    def velocity(self) -> tuple[float, float]:
        """Velocity of the agent, pixels a second."""
        return self._velocity

    @property
    def coverage(self) -> float:
        """The share of the goal that the T covers now."""
        block = self._block.position
        pose = block.x, block.y, self._block.angle
        if self._covered is None or self._covered[:3] != pose:  # a T at rest is not measured again
            self._covered = (*pose, coverage_of_one(*pose))
        return self._covered[3]


class Simulations:
    """Several Push-T worlds that are stepped one after the other.

    Args:
        states: (n, 5).
    """

    def __init__(self, states: ArrayLike) -> None:
        states = np.asarray(states, dtype=np.float64)
        if states.ndim != 2 or states.shape[1] != 5 or len(states) == 0:
            raise ValueError(f"states must have shape (n, 5) with n > 0, got {states.shape}")
        self.worlds = [Simulation(state) for state in states]

    def step(self, actions: ArrayLike, *, active: NDArray[np.bool_] | None = None) -> None:
        """Steps all worlds, or those that are `active`.

        Args:
            actions: (n, 2), targets of the agents; must be within [0, 512].
            active: (n,); the other worlds stand still and their actions are not looked at.

        Raises:
            TypeError: the actions are not real numbers.
            ValueError: they have another shape, are not finite or lie outside the world.
        """
        actions = np.asarray(actions)
        n = len(self.worlds)
        if actions.shape != (n, 2):
            raise ValueError(f"actions have shape {actions.shape}, expected {(n, 2)}")
        if active is not None and np.shape(active) != (n,):
            raise ValueError(f"active has shape {np.shape(active)}, expected {(n,)}")
        chosen = np.arange(n) if active is None else np.flatnonzero(active)
        if len(chosen) == 0:
            return
        for index, (x, y) in zip(
            chosen.tolist(), checked(actions[chosen], "actions").tolist(), strict=True
        ):
            self.worlds[index].step(x, y)

    @property
    def states(self) -> Array:
        """(n, 5): agent x and y, T x, y and angle (not reduced to one turn)."""
        return np.array([world.state for world in self.worlds])

    @property
    def coverage(self) -> Array:
        """(n,), the share of the goal that each T covers."""
        return np.array([world.coverage for world in self.worlds])


def checked(action: NDArray[Any], name: str = "action") -> Array:
    """Returns actions as float64 if they are finite real numbers in the world.

    Raises:
        TypeError: they are not real numbers.
        ValueError: they are not finite or lie outside [0, 512].
    """
    if action.dtype.kind not in "fiu":
        raise TypeError(f"{name} must be real numbers, got {action.dtype}")
    action = np.asarray(action, dtype=np.float64)
    if not np.isfinite(action).all():
        raise ValueError(f"{name} must be finite, got {action.tolist()}")
    if (action < 0).any() or (action > task.SIZE).any():
        raise ValueError(
            f"{name} must lie in [0, {task.SIZE:g}], got values from {action.min():g} to "
            f"{action.max():g}; clip them if that is what you mean"
        )
    return action


def _walls(static: Any) -> list[Any]:
    import pymunk

    low, high = task.WALLS
    left, right = ((low, high), (low, low)), ((high, low), (high, high))
    top, bottom = ((low, low), (high, low)), ((low, high), (high, high))
    # the order in which contacts are solved follows from this one, which is gym-pusht's
    return [pymunk.Segment(static, *ends, task.WALL_RADIUS) for ends in (left, top, right, bottom)]


def _tee() -> tuple[Any, list[Any]]:
    """The body of the T and its two shapes."""
    import pymunk

    bar, stem = (
        [(x0, y0), (x1, y0), (x1, y1), (x0, y1)] for x0, x1, y0, y1 in (task.BAR, task.STEM)
    )
    # gym-pusht takes the bar's moment of inertia for the stem, too.
    body = pymunk.Body(task.MASS, 2 * pymunk.moment_for_poly(task.MASS, bar))
    shapes = [pymunk.Poly(body, bar), pymunk.Poly(body, stem)]
    body.center_of_gravity = task.CENTRE_OF_GRAVITY
    return body, shapes
