"""What the course trains and compares, by name: a task and the options of its trainings."""

from dataclasses import dataclass, replace

from cotlearn.policies.methods import METHODS
from cotlearn.policies.pixels import Pixels
from cotlearn.policies.training import Options


@dataclass(frozen=True)
class Setting:
    """A task as it stands in the course.

    Attributes:
        task: its name in `cotlearn.robots.registry`.
        options: of every training.
        methods: that are compared.
    """

    task: str
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
    open_loop=True,
    share_at_t0=0.3,
    clusters=None,
)
#: Between two rows of pillars, which always stand nearly alike, the world is as good a frame. The
#: error at held-out starts decided, after short trainings with independent pairs: energy scores of
#: .4304 m in the world and .4328 m in the goal frame, and .4275 m with this learning rate.
_ROWS = replace(_WHOLE, frame="world", learning_rate=3e-3)
#: Some steps at a time, as on Push-T, in the coordinates of the world.
_RECEDING = Options(frame="world", steps=6000, width=256, clusters=1024)

#: With a camera, and a smaller budget: a step takes twice as long.
_CAMERA = Options(
    frame="agent",
    steps=6000,
    batch_size=128,
    width=256,
    condition_weight="balanced",
    clusters=1024,
    camera=Pixels(),
)
#: What an hour or two is enough for.
_MAIN = ("independent", "conditional_ot", "stratified", "residual", "minibatch_ot", "diffusion")

SETTINGS = {
    "push-t": Setting("push-t", Options(frame="body")),
    "push-t-pixels": Setting("push-t", _CAMERA, _MAIN),
    "arm-ring": Setting("arm-ring", _WHOLE),
    "arm-ring-receding": Setting("arm-ring", _RECEDING),
    "arm-avoid": Setting("arm-avoid", _ROWS),
    "arm-avoid-receding": Setting("arm-avoid", _RECEDING),
}
