"""The course's protocols by name: a task, the options of every training and the methods."""

from dataclasses import dataclass, replace
from typing import Literal

from cotlearn.policies.options import Options
from cotlearn.policies.pixels import Pixels
from cotlearn.robots.registry import TASKS

#: What every lesson on robots compares.
COMPARED = (
    *("independent", "minibatch_ot", "residual", "centred"),
    *("behaviour_cloning", "diffusion", "reflow", "mean_flow_data"),
)


@dataclass(frozen=True)
class Setting:
    """A task with its training options and methods.

    Attributes:
        task: name of the task in `cotlearn.robots.registry`.
        options: training options of all methods.
        methods: names of the methods to compare.
        held_out: demonstrations kept for the energy score.
        shipped: whether the course has the demonstrations; others are asked for.
        name: of the task in the tables of results, where it is not `task`.
    """

    task: str
    options: Options
    methods: tuple[str, ...] = COMPARED
    held_out: int = 200
    shipped: bool = True
    name: str = ""

    @property
    def table(self) -> str:
        """The name of the task in the tables of results."""
        return self.name or self.task

    @property
    def regime(self) -> Literal["whole", "replanning"]:
        """Whether a policy plans the whole path once, or plans again."""
        return "whole" if self.options.open_loop else "replanning"


#: Push-T. The network predicts the chunk: held-out energy score and exploration rollouts prefer it.
_PUSH = Options(frame="body", prediction="data")
#: People's demonstrations of Push-T: few, and labelled with what was done.
_PEOPLE = replace(_PUSH, label="action", clusters=512, steps=8000)
#: With a camera and smaller batches: a gradient step takes twice as long, and so do rollouts.
_CAMERA = Options(
    frame="agent",
    prediction="data",
    steps=6000,
    batch_size=128,
    width=256,
    condition_weight="balanced",
    clusters=1024,
    camera=Pixels(),
)
#: The arm, planning again. The network predicts the velocity, which held-out paths prefer.
_ARM = Options(frame="goal", steps=6000, width=256, clusters=1024)
#: The arm's whole path as one chunk of ten knots from the start to the goal.
_WHOLE = replace(
    _ARM,
    observe=1,
    predict=40,
    execute=40,
    knots=10,
    open_loop=True,
    share_at_t0=0.3,
    clusters=None,
)
#: The rows of pillars hardly move, so here the frame of the world is better.
_ROWS = replace(_WHOLE, frame="world", learning_rate=3e-3)

SETTINGS = {
    "push-t": Setting("push-t", _PUSH),
    "push-t-human": Setting("push-t", _PEOPLE, held_out=30, shipped=False, name="push-t-human"),
    "push-t-pixels": Setting("push-t", _CAMERA, name="push-t-pixels"),
    "arm-ring": Setting("arm-ring", _WHOLE),
    "arm-ring-replanning": Setting("arm-ring", _ARM),
    "arm-avoid": Setting("arm-avoid", _ROWS),
}
for _name in TASKS:  # one without a row has the usual options
    SETTINGS.setdefault(_name, Setting(_name, Options()))
