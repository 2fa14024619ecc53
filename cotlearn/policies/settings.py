"""What the course trains and compares, by name: a task's demonstrations and options."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cotlearn.policies.pixels import CameraOptions
from cotlearn.policies.training import METHODS, Options


@dataclass(frozen=True)
class Setting:
    """A task as it stands in the course.

    Attributes:
        demonstrations: the file in `data/`.
        options: of every training.
        methods: that are compared.
    """

    demonstrations: str
    options: Options
    methods: tuple[str, ...] = tuple(METHODS)


#: The whole way to the goal at once, as ten knots, from where the arm starts.
_WHOLE = Options(
    frame="goal",
    steps=6000,
    width=256,
    observe=1,
    predict=40,
    execute=40,
    knots=10,
    whole=True,
    early=0.3,
    clusters=None,
)
#: Between two rows of pillars, which always stand nearly alike, the world is as good a frame. The
#: error at held-out starts decided, after short trainings with independent pairs: energy scores of
#: .4304 m in the world and .4328 m in the goal frame, and .4275 m with this learning rate.
_ROWS = replace(_WHOLE, frame="world", learning_rate=3e-3)
#: Some steps at a time, as on Push-T, in the coordinates of the world.
_RECEDING = Options(frame="world", steps=6000, width=256, clusters=1024)

#: With a camera, and a smaller budget: a step takes twice as long.
_CAMERA = CameraOptions(steps=6000, batch_size=128, width=256, clusters=1024)
#: What an hour or two is enough for.
_MAIN = ("independent", "conditional_ot", "stratified", "residual", "minibatch_ot", "diffusion")

SETTINGS = {
    "push-t": Setting("push_t_demos.npz", Options(frame="body")),
    "push-t-pixels": Setting("push_t_demos.npz", _CAMERA, _MAIN),
    "arm-ring": Setting("arm_ring_demos.npz", _WHOLE),
    "arm-ring-receding": Setting("arm_ring_demos.npz", _RECEDING),
    "arm-avoid": Setting("arm_avoid_demos.npz", _ROWS),
    "arm-avoid-receding": Setting("arm_avoid_demos.npz", _RECEDING),
}
