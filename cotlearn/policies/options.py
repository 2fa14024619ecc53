"""The options of a training, the same for all methods that are compared."""

from dataclasses import dataclass
from typing import Any

from torch import nn

from cotlearn.flows.networks import ResidualMLP
from cotlearn.policies.pixels import Pixels
from cotlearn.policies.policy import check_execute
from cotlearn.policies.windows import Windows
from cotlearn.robots.episodes import Episodes
from cotlearn.validation import check_count, check_positive, check_share


@dataclass(frozen=True)
class Options:
    """The options of a training, the same for all methods unless said otherwise.

    Attributes:
        steps: gradient steps, fewer of a method whose steps cost more (`Method.cost`); of reflow,
            for the teacher and for the student; of "centred", for the flow, and a fifth of it for
            the regression before.
        batch_size: rows of a gradient step.
        learning_rate: of Adam, falling to 0 by a cosine.
        ema: decay of the averaged weights.
        width: of the layers of the residual MLP.
        blocks: of the residual MLP.
        frame: of the task, see `Windows`; its first if None, "agent" with a camera.
        label: "intention" or "action", see `Windows.dataset`.
        scale: "deviation" or "range", see `Windows.fit`.
        observe: steps that a policy sees.
        predict: steps of a chunk.
        execute: steps of a chunk to execute before the next is sampled.
        knots: number of predicted points per chunk; every step if None.
        open_loop: predict whole episodes from their starts, see `Windows`.
        share_at_t0: share of the rows of a flow that are trained at t = 0, see `FlowMatching`.
        ot_batch_size: rows of minibatch OT and COT.
        condition_weight: of COT; "balanced": COT Policy's rule; None: the frontier chooses where it
            is asked (`with_choice`), else "balanced".
        clusters: of stratified OT; None where the frontier is to choose.
        reflow_pairs: rows that the teacher pairs for reflow.
        reflow_nfe: evaluations of the teacher per pair; four times as many backwards.
        camera: makes the images that the policy observes; None: the policy observes the state.
        prediction: what the network predicts, "noise", "data" or "velocity"; "": the first of the
            method's `predictions`. A method with only one of them keeps it.
    """

    steps: int = 15_000
    batch_size: int = 256
    learning_rate: float = 1e-3
    ema: float = 0.999
    width: int = 384
    blocks: int = 4
    frame: str | None = None
    label: str = "intention"
    scale: str = "deviation"
    observe: int = 2
    predict: int = 16
    execute: int = 8
    knots: int | None = None
    open_loop: bool = False
    share_at_t0: float = 0.0
    ot_batch_size: int = 512
    condition_weight: float | str | None = None
    clusters: int | None = 4096
    reflow_pairs: int = 200_000
    reflow_nfe: int = 16
    camera: Pixels | None = None
    prediction: str = ""

    def __post_init__(self) -> None:
        for name in ("steps", "batch_size", "ot_batch_size", "width", "observe", "predict"):
            check_count(getattr(self, name), name)
        check_positive(self.learning_rate, "learning_rate")
        check_share(self.ema, "ema")
        check_execute(self.execute, self.predict)
        if self.camera and self.frame not in (None, "agent"):
            raise ValueError(f"frame must be agent with a camera, got {self.frame}")

    def make_network(self, windows: Windows, *, columns: int = 0, seed: int) -> nn.Module:
        """A network for chunks and observations of the windows' sizes.

        Args:
            windows: of the training.
            columns: that a method adds to the condition; a camera's network then predicts mean
                velocities.
            seed: of the initial weights.
        """
        sizes: dict[str, Any] = {"width": self.width, "blocks": self.blocks, "seed": seed}
        if self.camera:
            return self.camera.network(windows, mean=columns > 0, **sizes)
        return ResidualMLP(windows.dim, windows.condition_dim + columns, **sizes)

    def windows(self, episodes: Episodes) -> Windows:
        """The windows of these options, with the scale of the episodes."""
        frame = self.frame or ("agent" if self.camera else None)
        return Windows.fit(
            episodes,
            frame=frame,
            label=self.label,
            scale=self.scale,
            observe=self.observe,
            predict=self.predict,
            knots=self.knots,
            open_loop=self.open_loop,
        )
