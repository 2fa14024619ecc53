"""The gymnasium environments `cotlearn/ArmRing-v0` and `cotlearn/ArmAvoid-v0`."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from cotlearn.robots.arm import constants
from cotlearn.robots.arm.rendering import Painter
from cotlearn.robots.arm.simulation import ArmVectorSim, random_start
from cotlearn.robots.task import Array, check_numbers, check_started, chosen_start
from cotlearn.validation import check_choice, check_count, check_seed


class Arm(gymnasium.Env[Array, NDArray[np.float32]]):
    """Reach around pillars to a goal.

    Observations: the state, float64, metres. Its columns are named by
    `cotlearn.robots.arm.constants.columns(kind)`: tip, goal, then x, y, radius and height of each
    pillar.

    Actions, float32: the target (3,) of the tip at the end of the control step, metres; the tool
    points down.

    An episode terminates when the arm touches a pillar, the table or itself, or after 40 control
    steps of 0.1 s, when the arm has settled. The reward is 0 before the end. At the end it is 1 if
    the tip is within 2.5 cm of the goal, below 0.5 if it is farther away, and 0 after a
    collision.

    `info` has "success", "collision", "touched" (the touched object, or ""), "goal_error" (metres),
    "unreachable" (whether the last target was out of reach, so that the arm moved to the nearest
    posture it found) and "mode", an index of `cotlearn.robots.arm.MODES`, -1 without success.

    Args:
        kind: "ring" or "avoid".
        render_mode: "rgb_array" or None. No display is needed; without OpenGL, matplotlib draws.
        width: of an image, in pixels.
        height: of an image, in pixels.
        camera: "front" or "above".

    Raises:
        ValueError: an option is unknown, or the image is larger than 960 x 720.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(1 / constants.CONTROL_SECONDS)}  # noqa: RUF012

    def __init__(
        self,
        kind: str = "ring",
        *,
        render_mode: str | None = None,
        width: int = 320,
        height: int = 240,
        camera: str = "front",
    ) -> None:
        self.kind = check_choice(kind, "kind", constants.KINDS)
        if render_mode is not None:
            check_choice(render_mode, "render_mode", ("rgb_array",))
        self.render_mode = render_mode
        self.camera = check_choice(camera, "camera", ("front", "above"))
        self.size = check_count(width, "width"), check_count(height, "height")
        if width > constants.PICTURE[0] or height > constants.PICTURE[1]:
            raise ValueError(
                f"width and height must be at most {constants.PICTURE}, got {self.size}"
            )
        widest = np.full(len(constants.columns(kind)), constants.FAR)
        self._state_limits = np.stack([-widest, widest])
        self.observation_space = spaces.Box(*self._state_limits, dtype=np.float64)
        self._limits = np.stack([constants.LOW, constants.HIGH])
        self.action_space = spaces.Box(*self._limits.astype(np.float32))
        self._sim: Any = None  # until `reset`
        self._painter: Painter | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: of the random start.
            options: {"state": (columns,)} sets the start; None draws it.

        Raises:
            TypeError: the state does not hold real numbers.
            ValueError: `options` has another key, or the start is impossible.
        """
        super().reset(seed=None if seed is None else check_seed(seed))
        state = chosen_start(options, self._state_limits)
        if state is None:
            state = random_start(self.np_random, self.kind)
        radius, height = constants.pillars(state)[:, 2:].T
        if not ((radius > 0) & (height > radius)).all():
            raise ValueError(f"state: pillars need 0 < radius < height, got {radius}, {height}")
        self._sim = ArmVectorSim(state[None], self.kind)
        return self._sim.states[0], self._info()

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Moves the arm towards `action` for one control step of 0.1 s.

        Raises:
            TypeError: `action` does not hold real numbers.
            ValueError: `action` has a wrong shape, is not finite or lies outside the action space.
            RuntimeError: `reset` was not called.
        """
        sim, limits = check_started(self._sim), self._limits
        target = check_numbers(action, limits, "action", shape=limits[0].shape)
        sim.step(target[None])
        over, info = bool(sim.done[0]), self._info()
        reward = float(over and not info["collision"])
        if not info["success"]:
            reward *= constants.SUCCESS / (2 * max(info["goal_error"], constants.SUCCESS))
        return sim.states[0], reward, over, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """An image (height, width, 3), uint8; None if render_mode is None.

        Raises:
            RuntimeError: `reset` was not called.
        """
        if self.render_mode is None:
            return None
        sim = check_started(self._sim)
        if self._painter is None:
            self._painter = Painter(sim.models[0], self.size, self.camera)
        return self._painter.paint(sim.models[0], sim.data[0], sim.states[0])

    def close(self) -> None:
        """Frees the resources of rendering; may be called twice."""
        if self._painter is not None:
            self._painter.close()
            self._painter = None

    def __getstate__(self) -> dict[str, Any]:
        """A copy opens graphics of its own; its physics goes on bit for bit."""
        return {**self.__dict__, "_painter": None}

    def _info(self) -> dict[str, Any]:
        found = {name: values[0] for name, values in self._sim.outcomes().items()}
        return {
            "success": bool(found["success"]),
            "collision": bool(found["collision"]),
            "touched": self._sim.touched()[0],
            "goal_error": float(found["goal_error"]),
            "unreachable": bool(self._sim.unreachable[0]),
            "mode": int(found["mode"]),
        }
