"""The course's benchmark settings by name: a task, training options and the compared methods."""

from dataclasses import dataclass, replace

from cotlearn.policies.methods import METHODS
from cotlearn.policies.pixels import Pixels
from cotlearn.policies.training import Options
from cotlearn.robots.registry import TASKS


@dataclass(frozen=True)
class Setting:
    """A task with its training options and methods.

    Attributes:
        task: name of the task in `cotlearn.robots.registry`.
        options: training options of all methods.
        methods: names of the methods to compare.
        held_out: demonstrations kept for the energy score.
        shipped: whether the course has the demonstrations; others are asked for.
        temperatures: that a comparison tries by rollouts, see `Protocol`.
    """

    task: str
    options: Options
    methods: tuple[str, ...] = tuple(METHODS)
    held_out: int = 200
    shipped: bool = True
    temperatures: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8)


#: Open loop: one chunk of ten knots from the start to the goal.
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
#: The world frame, because the rows of pillars hardly move. It was chosen by the energy score on
#: held-out starts after short trainings with independent pairs: .4304 m in the world frame, .4328 m
#: in the goal frame, and .4275 m in the world frame with this learning rate.
_ROWS = replace(_WHOLE, frame="world", learning_rate=3e-3)
#: Receding horizon, as on Push-T, in the world frame.
_RECEDING = Options(frame="world", steps=6000, width=256, clusters=1024)

#: Push-T, with the data as the target: held-out energy score and exploration rollouts prefer it,
#: for flows and for diffusion (data/results/policy_targets_push_t.json). The arm's prefer velocity.
_PUSH = Options(frame="body", prediction="data")
#: People's demonstrations of Push-T: few, and labelled with what was done. Held-out chunks prefer
#: velocity here (data/results/few_data.json); nothing is chosen by rollouts, so no temperature.
_HUMAN = replace(_PUSH, prediction="velocity", label="action", clusters=512, steps=8000)
#: With a camera and smaller batches: a gradient step takes twice as long, and so do rollouts.
_CAMERA = Options(
    frame="agent",
    steps=6000,
    batch_size=128,
    width=256,
    condition_weight="balanced",
    clusters=1024,
    camera=Pixels(),
)
#: Methods that can be compared in an hour or two.
_MAIN = ("independent", "conditional_ot", "stratified", "residual", "minibatch_ot", "diffusion")

SETTINGS = {
    "push-t": Setting("push-t", _PUSH),
    "push-t-human": Setting("push-t", _HUMAN, held_out=30, shipped=False, temperatures=()),
    "push-t-pixels": Setting("push-t", _CAMERA, _MAIN),
    "arm-ring": Setting("arm-ring", _WHOLE),
    "arm-ring-receding": Setting("arm-ring", _RECEDING),
    "arm-avoid": Setting("arm-avoid", _ROWS),
    "arm-avoid-receding": Setting("arm-avoid", _RECEDING),
}
for _name in TASKS:  # one without a row has the usual options
    SETTINGS.setdefault(_name, Setting(_name, Options()))
