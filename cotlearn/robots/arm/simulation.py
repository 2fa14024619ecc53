"""Simulations of the arm among pillars with MuJoCo's physics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.arm import constants
from cotlearn.robots.arm.kinematics import SPEED, solve
from cotlearn.robots.arm.model import model_of, mujoco
from cotlearn.robots.arm.modes import mode_of_path
from cotlearn.robots.task import Array
from cotlearn.validation import check_array, check_choice, check_seeds


def random_start(generator: np.random.Generator, kind: str) -> Array:
    """Draws the start state (columns,) of an episode; see `constants.columns`.

    In "ring" a pillar stands near the middle of the table, and start and goal lie on opposite sides
    of it in a random direction. In "avoid" two rows of pillars stand between a start near the arm
    and a goal far from it.
    """
    draw = generator.uniform
    if kind == "ring":
        pillar = [draw(*span) for span in constants.RING_PILLAR]
        angle = draw(-np.pi, np.pi)
        places = []
        for turn in (angle, angle + np.pi + draw(-constants.RING_TURN, constants.RING_TURN)):
            away = draw(*constants.RING_RADIUS)
            x, y = pillar[0] + away * np.cos(turn), pillar[1] + away * np.sin(turn)
            places += [x, y, draw(*constants.RING_HEIGHT)]
        return np.array(places + pillar)
    places = [draw(*span) for span in (*constants.AVOID_START, *constants.AVOID_GOAL)]
    posts = []
    for x, row in constants.AVOID_ROWS:
        for y in row:
            jitter = [draw(-size, size) for size in constants.AVOID_JITTER]
            posts += [
                x + jitter[0],
                y + jitter[1],
                *(draw(*span) for span in constants.AVOID_PILLAR),
            ]
    return np.array(places + posts)


class ArmVectorSim:
    """Several simulations of the arm that are stepped one after the other.

    An action is the target of the tip at the end of the control step. Inverse kinematics converts
    it to joint angles, to which the joints move at constant speed, within a Panda's speed limits.

    Args:
        states: (n, columns), the start states; see `constants.columns`.
        kind: "ring" or "avoid".

    Raises:
        ValueError: a start or goal is out of reach or inside a pillar.
    """

    def __init__(self, states: Array, kind: str) -> None:
        self.kind = check_choice(kind, "kind", constants.KINDS)
        states = check_array(states, "states", (None, len(constants.columns(kind))))
        self._states = states.copy()
        self.models = [model_of(state) for state in states]  #: (n,), `MjModel`
        self.data = [mujoco().MjData(model) for model in self.models]  #: (n,), `MjData`
        self._site = self.models[0].site("tip").id
        self._lag = -self.models[0].actuator_biasprm[:, 2] / self.models[0].actuator_gainprm[:, 0]
        self._place("goal", states[:, constants.GOAL])
        self._place("tip", states[:, constants.TIP])
        n = len(states)
        self._paths = np.repeat(self.states[:, None], constants.MAX_STEPS + 1, axis=1)
        self._steps, self._missed = np.zeros((2, n), dtype=np.int64)
        self._collision = np.zeros(n, dtype=bool)
        self.unreachable = np.zeros(n, dtype=bool)  #: whether the last target was out of reach

    @classmethod
    def from_seeds(cls, seeds: Sequence[int], kind: str = "ring") -> ArmVectorSim:
        """The simulations that `env.reset(seed=...)` would start for these seeds."""
        check_choice(kind, "kind", constants.KINDS)
        starts = [random_start(np.random.default_rng(seed), kind) for seed in check_seeds(seeds)]
        return cls(np.array(starts), kind)

    def _place(self, name: str, targets: Array) -> None:
        """Place the tips at targets (n, 3); raise ValueError where that is impossible."""
        found = solve(targets)
        self.joints = found.joints  #: (n, 7), the last commanded joint angles
        for index, (data, joints) in enumerate(zip(self.data, found.joints, strict=True)):
            what = f"the {name} {targets[index].round(4).tolist()} of states[{index}]"
            if not found.reached[index]:
                near = f"the tip comes within {found.error[index]:.3f} m of it"
                raise ValueError(f"{what} is out of reach: {near}")
            data.qpos[:] = joints
            data.ctrl[:] = joints
            mujoco().mj_forward(self.models[index], data)
            if data.ncon:
                raise ValueError(f"{what} is in {self.touched()[index]}")

    @property
    def states(self) -> Array:
        """The current states, (n, columns); see `constants.columns`."""
        for state, data in zip(self._states, self.data, strict=True):
            state[constants.TIP] = data.site_xpos[self._site]
        return self._states.copy()

    @property
    def finished(self) -> NDArray[np.bool_]:
        """Whether each episode has ended by a collision, (n,)."""
        return self._collision.copy()

    @property
    def done(self) -> NDArray[np.bool_]:
        """Whether each episode has ended by a collision or the time limit, (n,)."""
        return self._collision | (self._steps >= constants.MAX_STEPS)

    def step(self, actions: ArrayLike, *, active: NDArray[np.bool_] | None = None) -> None:
        """Moves the tips towards their targets for one control step.

        After the last step of an episode the target is held for 0.3 s, so that the arm settles.

        Args:
            actions: (n, 3), targets of the tips, metres. For a target out of reach the arm moves to
                the nearest posture that was found, and `unreachable` is set.
            active: (n,), which simulations to step; None: all. Simulations that are inactive or
                done stand still, and their actions are ignored.
        """
        rows = np.flatnonzero(~self.done if active is None else ~self.done & active)
        if not len(rows):
            return
        found = solve(np.asarray(actions, dtype=np.float64)[rows], self.joints[rows])
        self._lead(rows, found.joints, ~found.reached)

    def outcomes(self) -> dict[str, Array]:
        """The results of each episode so far, name -> (n,).

        - "success": 1 if the episode ended with the tip within 2.5 cm of the goal, no collision;
        - "collision": 1 after a collision;
        - "goal_error": current distance of the tip from the goal, metres;
        - "unreachable": number of control steps whose target was out of reach;
        - "mode": index in `constants.MODES`, -1 without success.
        """
        states = self.states
        error = np.linalg.norm(states[:, constants.TIP] - states[:, constants.GOAL], axis=1)
        success = self.done & ~self._collision & (error <= constants.SUCCESS)
        mode = np.where(success, mode_of_path(self._paths, self.kind), -1)
        found = {"success": success, "collision": self._collision, "goal_error": error}
        found |= {"unreachable": self._missed, "mode": mode}
        return {name: values.astype(np.float64) for name, values in found.items()}

    def touched(self) -> list[str]:
        """The name of the object that each arm touches, (n,); "" for none."""
        found = []
        for model, data in zip(self.models, self.data, strict=True):
            names = [model.geom(geom).name for geom in data.contact.geom[:1].ravel()]
            scenery = [name for name in names if name.startswith(("pillar", "table"))]
            found.append(scenery[0] if scenery else "the arm itself" if names else "")
        return found

    def _lead(self, rows: NDArray[np.int64], goals: Array, missed: NDArray[np.bool_]) -> None:
        """Move the joints of some simulations to goals (rows, 7) at constant speed."""
        self.unreachable[rows] = missed
        self._missed[rows] += missed
        before = self.joints[rows]
        most = (np.abs(goals - before) / (SPEED * constants.CONTROL_SECONDS)).max(axis=1)
        after = before + (goals - before) / np.maximum(most, 1.0)[:, None]
        self.joints[rows] = after
        # a joint lags behind its command by lag x speed, so the command is advanced by as much
        ahead = (after - before) / constants.CONTROL_SECONDS * self._lag
        shares = np.arange(1, constants.SUBSTEPS + 1) / constants.SUBSTEPS
        commands = before[:, None] + shares[:, None] * (after - before)[:, None] + ahead[:, None]
        self._steps[rows] += 1
        for row, course, end in zip(rows.tolist(), commands, after, strict=True):
            touched = self._follow(row, course)
            if not touched and self._steps[row] == constants.MAX_STEPS:
                touched = self._follow(
                    row, np.tile(end, (constants.SETTLE * constants.SUBSTEPS, 1))
                )
            self._collision[row] = touched
            place = self._paths[row, self._steps[row] :]
            place[:, constants.TIP] = self.data[row].site_xpos[self._site]

    def _follow(self, row: int, course: Array) -> bool:
        """Simulate along commands (steps, 7) until a contact; return whether there was one."""
        model, data, step = self.models[row], self.data[row], mujoco().mj_step
        for command in course:
            data.ctrl[:] = command
            step(model, data)
            if data.ncon:
                break
        mujoco().mj_forward(model, data)
        return bool(data.ncon)
