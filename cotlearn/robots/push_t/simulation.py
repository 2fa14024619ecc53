"""The physics of Push-T on pymunk, bare: for experts, rollouts and the gymnasium environment.

The agent is kinematic: a controller pulls it to the action, and nothing stops it. The T forgets
its velocity in every step (`damping` 0), so that it moves only while it is pushed. There is no
friction. Nothing is checked here; the environment and `rollout` have done it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.push_t import task
from cotlearn.robots.push_t.geometry import coverage_of_one, nearest_side
from cotlearn.robots.task import Array

State = tuple[float, float, float, float, float]

MOVED = 1e-6  #: pixels by which a T that is pushed moves at least


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

    One physics step with a resting agent is done at once, as in gym-pusht: if the T overlaps the
    agent or a wall, it begins to be pushed out.

    Args:
        state: (5,), agent x and y, T x, y and angle.
    """

    def __init__(self, state: ArrayLike) -> None:
        import pymunk  # late: the definition of the task is of use without its physics

        agent_x, agent_y, x, y, angle = np.asarray(state, np.float64).tolist()
        space = pymunk.Space()
        space.damping = 0.0
        low, high = task.WALLS
        left, right = ((low, high), (low, low)), ((high, low), (high, high))
        top, bottom = ((low, low), (high, low)), ((low, high), (high, high))
        # the order in which contacts are solved follows from this one, which is gym-pusht's
        for ends in (left, top, right, bottom):
            space.add(pymunk.Segment(space.static_body, *ends, task.WALL_RADIUS))
        agent = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        agent.position = agent_x, agent_y
        space.add(agent, pymunk.Circle(agent, task.AGENT_RADIUS))
        bar, stem = task.KEYPOINTS[:4], task.KEYPOINTS[4:]
        # gym-pusht takes the bar's moment of inertia for the stem, too.
        block = pymunk.Body(task.MASS, 2 * pymunk.moment_for_poly(task.MASS, bar))
        block.center_of_gravity = task.CENTRE_OF_GRAVITY
        space.add(block, pymunk.Poly(block, bar), pymunk.Poly(block, stem))
        block.angle = angle  # first: turning is about the centre of gravity
        block.position = x, y
        self._space, self._agent, self._block, self._velocity = space, agent, block, (0.0, 0.0)
        space.step(task.PHYSICS_SECONDS)

    def step(self, x: float, y: float) -> None:
        """Lets the agent follow the target (x, y) for one control step."""
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
    def coverage(self) -> float:
        """The share of the goal that the T covers now."""
        return coverage_of_one(*self.state[2:])


class PushTVectorSim:
    """Several Push-T simulations that are stepped one after the other.

    Args:
        states: (n, 5), where they start.
    """

    def __init__(self, states: ArrayLike) -> None:
        self._sims = [Simulation(state) for state in np.asarray(states)]
        self._best = self.coverage
        self._mode = np.full(len(self._sims), -1.0)

    @classmethod
    def from_seeds(cls, seeds: Sequence[int]) -> PushTVectorSim:
        """The simulations that `env.reset(seed=...)` would start for these seeds."""
        return cls([random_state(np.random.default_rng(seed)) for seed in seeds])

    def step(self, actions: ArrayLike, *, active: NDArray[np.bool_] | None = None) -> None:
        """Steps all simulations, or those that are `active`.

        Args:
            actions: (n, 2), targets of the agents, in [0, 512].
            active: (n,); the others stand still and their actions are not looked at.
        """
        before, targets = self.states, np.asarray(actions, dtype=np.float64).tolist()
        chosen = range(len(self._sims)) if active is None else np.flatnonzero(active)
        for index in chosen:
            self._sims[index].step(*targets[index])
        now = self.states
        self._best = np.maximum(self._best, self.coverage)
        pushed = np.abs(now[:, 2:4] - before[:, 2:4]).max(axis=1) > MOVED
        first = np.flatnonzero(pushed & (self._mode < 0))
        if len(first):
            self._mode[first] = nearest_side(now[first, :2], now[first, 2:])

    @property
    def states(self) -> Array:
        """(n, 5): agent x and y, T x, y and angle (not reduced to one turn)."""
        return np.array([sim.state for sim in self._sims])

    @property
    def coverage(self) -> Array:
        """(n,), the share of the goal that each T covers."""
        return np.array([sim.coverage for sim in self._sims])

    @property
    def finished(self) -> NDArray[np.bool_]:
        """(n,), whether the T has once covered more than 0.95 of the goal."""
        return self._best > task.SUCCESS

    def outcomes(self) -> dict[str, Array]:
        """Name -> (n,).

        - "coverage", the best at any time: the score of Diffusion Policy is min(1, it / 0.95);
        - "last", the coverage now;
        - "mode", the side of the T (0 to 7, around its outline) that was pushed first, or -1.
        """
        return {"coverage": self._best.copy(), "last": self.coverage, "mode": self._mode.copy()}
