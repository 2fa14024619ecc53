"""The physics of Push-T on pymunk, for experts, rollouts and the gymnasium environment.

The agent is kinematic: a controller pulls it to the action, and nothing stops it. The T loses its
velocity in every step (`damping` 0), so that it moves only while it is pushed. There is no
friction. Actions are not checked here, but in the environment and in `rollout`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.push_t import constants
from cotlearn.robots.push_t.geometry import coverage_of_one, nearest_side
from cotlearn.robots.task import Array
from cotlearn.validation import check_array, check_seeds

State = tuple[float, float, float, float, float]

MOVED = 1e-6  #: pixels of movement above which the T counts as pushed


def random_state(generator: np.random.Generator) -> State:
    """Draws the same start as gym-pusht would with the same generator.

    gym-pusht sets the position of an upright T and then rotates it about its centre of gravity. So
    the centre of gravity is uniform over a square, and the T is clear of the walls in nearly all
    starts.
    """
    agent = generator.integers(50, 450), generator.integers(50, 450)
    place = generator.integers(100, 400), generator.integers(100, 400)
    angle = float(generator.uniform(-math.pi, math.pi))
    gravity_x, gravity_y = constants.CENTRE_OF_GRAVITY
    x = place[0] + gravity_x - (math.cos(angle) * gravity_x - math.sin(angle) * gravity_y)
    y = place[1] + gravity_y - (math.sin(angle) * gravity_x + math.cos(angle) * gravity_y)
    return float(agent[0]), float(agent[1]), float(x), float(y), angle


class Simulation:
    """One simulation of Push-T.

    As in gym-pusht, the constructor takes one physics step with the agent at rest, which starts to
    push out a T that overlaps the agent or a wall.

    A copy, by `copy.deepcopy` or pickle, goes on bit for bit: it takes the same steps again from
    the same start (0.1 ms each), because pymunk's copies lose digits and forget contacts.

    Args:
        state: (5,), agent x and y, T x, y and angle.
    """

    def __init__(self, state: ArrayLike) -> None:
        import pymunk  # late: the definition of the task is of use without its physics

        self._start = check_array(state, "state", (5,)).tolist()
        self._targets: list[tuple[float, float]] = []
        agent_x, agent_y, x, y, angle = self._start
        space = pymunk.Space()
        space.damping = 0.0
        low, high = constants.WALLS
        left, right = ((low, high), (low, low)), ((high, low), (high, high))
        top, bottom = ((low, low), (high, low)), ((low, high), (high, high))
        # gym-pusht's order of walls, which determines the order of contacts
        for ends in (left, top, right, bottom):
            space.add(pymunk.Segment(space.static_body, *ends, constants.WALL_RADIUS))
        agent = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        agent.position = agent_x, agent_y
        space.add(agent, pymunk.Circle(agent, constants.AGENT_RADIUS))
        bar, stem = constants.KEYPOINTS[:4], constants.KEYPOINTS[4:]
        # gym-pusht takes the bar's moment of inertia for the stem, too.
        block = pymunk.Body(constants.MASS, 2 * pymunk.moment_for_poly(constants.MASS, bar))
        block.center_of_gravity = constants.CENTRE_OF_GRAVITY
        space.add(block, pymunk.Poly(block, bar), pymunk.Poly(block, stem))
        block.angle = angle  # before the position: it rotates about the centre of gravity
        block.position = x, y
        self._space, self._agent, self._block, self._velocity = space, agent, block, (0.0, 0.0)
        space.step(constants.PHYSICS_SECONDS)

    def step(self, x: float, y: float) -> None:
        """Pulls the agent towards the target (x, y) for one control step."""
        space_step, agent = self._space.step, self._agent
        seconds, stiffness, damping = (
            constants.PHYSICS_SECONDS,
            constants.STIFFNESS,
            constants.DAMPING,
        )
        agent_x, agent_y = agent.position
        vx, vy = self._velocity
        for _ in range(constants.SUBSTEPS):
            vx += (stiffness * (x - agent_x) - damping * vx) * seconds
            vy += (stiffness * (y - agent_y) - damping * vy) * seconds
            agent.velocity = vx, vy
            space_step(seconds)
            agent_x += vx * seconds
            agent_y += vy * seconds
        self._velocity = vx, vy
        self._targets.append((x, y))

    def __reduce__(self) -> tuple[Any, ...]:
        return _replayed, (self._start, self._targets)

    @property
    def state(self) -> State:
        """Agent x and y, T x, y and angle; the angle is not reduced to one turn."""
        agent, block = self._agent.position, self._block.position
        return agent.x, agent.y, block.x, block.y, self._block.angle

    @property
    def coverage(self) -> float:
        """The share of the goal that the T covers, in [0, 1]."""
        return coverage_of_one(*self.state[2:])


def _replayed(start: list[float], targets: list[tuple[float, float]]) -> Simulation:
    """A simulation after these steps."""
    simulation = Simulation(start)
    for x, y in targets:
        simulation.step(x, y)
    return simulation


class PushTVectorSim:
    """Several Push-T simulations that are stepped one after the other.

    Args:
        states: (n, 5), where they start.
    """

    def __init__(self, states: ArrayLike) -> None:
        self._sims = [Simulation(state) for state in check_array(states, "states", (None, 5))]
        self._best = self.coverage
        self._mode = np.full(len(self._sims), -1.0)

    @classmethod
    def from_seeds(cls, seeds: Sequence[int]) -> PushTVectorSim:
        """The simulations that `env.reset(seed=...)` would start for these seeds."""
        return cls([random_state(np.random.default_rng(seed)) for seed in check_seeds(seeds)])

    def step(self, actions: ArrayLike, *, active: NDArray[np.bool_] | None = None) -> None:
        """Steps all simulations, or those that are `active`.

        Args:
            actions: (n, 2), targets of the agents, in [0, 512].
            active: (n,), which simulations to step; the others stand still. None: all.
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
        """The share of the goal that each T covers, (n,), in [0, 1]."""
        return np.array([sim.coverage for sim in self._sims])

    @property
    def finished(self) -> NDArray[np.bool_]:
        """Whether the T has ever covered more than 0.95 of the goal, (n,)."""
        return self._best > constants.SUCCESS

    def outcomes(self) -> dict[str, Array]:
        """The results of each episode so far, name -> (n,).

        - "coverage": the best coverage; Diffusion Policy's score is min(1, coverage / 0.95);
        - "last": the current coverage;
        - "mode": the side of the T (0 to 7, around its outline) that was pushed first, or -1.
        """
        return {"coverage": self._best.copy(), "last": self.coverage, "mode": self._mode.copy()}
