"""The gymnasium environment `cotlearn/PushT-v0`."""

import copy
import math
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from cotlearn.robots.push_t import constants
from cotlearn.robots.push_t.geometry import corners
from cotlearn.robots.push_t.rasteriser import draw
from cotlearn.robots.push_t.simulation import Simulation, random_state
from cotlearn.robots.task import check_numbers, check_started, chosen_start
from cotlearn.validation import check_choice, check_seed

PIXELS = 96  #: width and height of an observed picture
FRAME = 512  #: width and height of a rendered picture

_STARTS = (
    [0.0] * 4 + [-math.inf],
    [constants.SIZE] * 4 + [math.inf],
)  #: limits of states and actions
_ACTIONS = [0.0] * 2, [constants.SIZE] * 2
_AGENT = spaces.Box(0.0, constants.SIZE, shape=(2,), dtype=np.float64)
_POINTS = spaces.Box(0.0, constants.SIZE, shape=(16,), dtype=np.float64)
_PICTURE = spaces.Box(0, 255, shape=(PIXELS, PIXELS, 3), dtype=np.uint8)
OBSERVATIONS: dict[str, spaces.Space[Any]] = {
    "state": spaces.Box(
        np.zeros(5), np.array([constants.SIZE] * 4 + [2 * math.pi]), dtype=np.float64
    ),
    "keypoints": spaces.Dict({"environment_state": _POINTS, "agent_pos": _AGENT}),
    "pixels": _PICTURE,
    "pixels_agent_pos": spaces.Dict({"pixels": _PICTURE, "agent_pos": _AGENT}),
}

Observation = NDArray[Any] | dict[str, NDArray[Any]]


class PushT(gymnasium.Env[Any, Any]):
    """Push the T onto its outline.

    Spaces, dynamics, reward, success and time limit are those of gym-pusht 0.1.8, and the same seed
    gives the same start.

    Actions: (2,) float32, the target position of the agent, in [0, 512]². Observations:

    - "state": (5,) float64, agent x and y, T x, y and angle in [0, 2π);
    - "keypoints": {"environment_state": (16,), "agent_pos": (2,)}, corners of bar and stem;
    - "pixels": (96, 96, 3) uint8, similar to gym-pusht's images, but not identical;
    - "pixels_agent_pos": {"pixels": (96, 96, 3), "agent_pos": (2,)}.

    The agent can overshoot the edge of the world by a few pixels, and so can a T that starts in a
    wall: such an observation lies outside the observation space, as in gym-pusht.

    The reward is min(coverage / 0.95, 1). The episode terminates when the coverage exceeds 0.95
    (`info["is_success"]`); after 300 steps `gymnasium.make` truncates it. `info["coverage"]` is
    the share of the goal that is covered.

    Args:
        obs_type: "state", "keypoints", "pixels" or "pixels_agent_pos".
        render_mode: "rgb_array" or None. No display is needed.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(1 / constants.CONTROL_SECONDS)}  # noqa: RUF012

    def __init__(self, obs_type: str = "state", render_mode: str | None = None) -> None:
        self.obs_type = check_choice(obs_type, "obs_type", tuple(OBSERVATIONS))
        if render_mode is not None:
            check_choice(render_mode, "render_mode", ("rgb_array",))
        self.render_mode = render_mode
        self.observation_space = copy.deepcopy(OBSERVATIONS[obs_type])  # each is seeded by itself
        self.action_space = spaces.Box(0.0, constants.SIZE, shape=(2,), dtype=np.float32)
        self._world: Any = None  # until `reset`
        self._action: tuple[float, float] | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: of the random start.
            options: {"state": (5,)} sets the start, with exactly this pose of the T (gym-pusht's
                "reset_to_state" rotates the T after placing it, which moves it).

        Raises:
            TypeError: the state does not hold real numbers.
            ValueError: `options` has another key, or the state lies outside the world.
        """
        super().reset(seed=None if seed is None else check_seed(seed))
        state = chosen_start(options, _STARTS)
        self._world = Simulation(random_state(self.np_random) if state is None else state)
        self._action = None
        return self._observe(), self._info()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Pulls the agent towards `action` for one control step of 0.1 s.

        Raises:
            TypeError: `action` does not hold real numbers.
            ValueError: `action` does not have shape (2,), is not finite or lies outside the world.
            RuntimeError: `reset` was not called.
        """
        x, y = check_numbers(action, _ACTIONS, "action", shape=(2,)).tolist()
        check_started(self._world).step(x, y)
        self._action = (x, y)
        info = self._info()
        reward = min(info["coverage"] / constants.SUCCESS, 1.0)
        return self._observe(), reward, info["is_success"], False, info

    def render(self) -> NDArray[np.uint8] | None:
        """An image (512, 512, 3) with a cross at the last action; None if render_mode is None.

        Raises:
            RuntimeError: `reset` was not called.
        """
        if self.render_mode is None:
            return None
        return draw(check_started(self._world).state, size=FRAME, action=self._action)

    def _observe(self) -> Observation:
        agent_x, agent_y, x, y, angle = state = self._world.state
        if self.obs_type == "state":
            return np.array([agent_x, agent_y, x, y, angle % (2 * math.pi)])
        agent = np.array([agent_x, agent_y])
        if self.obs_type == "keypoints":
            points = corners(state[2:], constants.KEYPOINTS)
            return {"environment_state": points.ravel(), "agent_pos": agent}
        picture = draw(state, size=PIXELS)
        return picture if self.obs_type == "pixels" else {"pixels": picture, "agent_pos": agent}

    def _info(self) -> dict[str, Any]:
        coverage = self._world.coverage
        return {"coverage": coverage, "is_success": coverage > constants.SUCCESS}
