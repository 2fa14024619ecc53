"""Train policies: every method on the same data, network and budget."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from torch import nn

from cotlearn.couplings import Coupling, EmbeddedClusters
from cotlearn.datasets import Dataset
from cotlearn.flows.matching import Loss
from cotlearn.flows.networks import ResidualMLP, TemporalUNet
from cotlearn.flows.training import FitResult, fit
from cotlearn.policies.methods import Method, find_method
from cotlearn.policies.pixels import Pixels
from cotlearn.policies.policy import ChunkPolicy, check_execute
from cotlearn.policies.windows import Windows
from cotlearn.robots.episodes import Episodes
from cotlearn.validation import check_choice, check_count, check_has, check_positive, check_share

NETWORKS = ("mlp", "unet")
_SHAPE = ("observe", "predict", "label", "scale", "knots", "open_loop")  #: for `Windows.fit`
_OLD_NAMES = {"whole": "open_loop", "early": "share_at_t0"}


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
        network: "mlp", the residual MLP; or "unet", the temporal U-Net. A camera has its own.
        width: of the MLP's layers.
        blocks: of the MLP.
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
    network: str = "mlp"
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
        check_choice(self.network, "network", NETWORKS)
        for name in ("steps", "batch_size", "ot_batch_size", "width", "observe", "predict"):
            check_count(getattr(self, name), name)
        check_positive(self.learning_rate, "learning_rate")
        check_share(self.ema, "ema")
        check_execute(self.execute, self.predict)
        sees = self.network, self.frame or "agent"
        if self.camera and sees != ("mlp", "agent"):
            raise ValueError(f"with a camera, network and frame must be mlp and agent, got {sees}")

    @classmethod
    def from_stored(cls, stored: Mapping[str, Any]) -> Self:
        """Reads what `dataclasses.asdict` made of options, also under the names of version 0.1."""
        values = {_OLD_NAMES.get(name, name): value for name, value in stored.items()}
        old = [field.name for field in fields(Pixels) if field.name in values]
        camera = values.pop("camera", None) or {name: values.pop(name) for name in old}
        if values.get("network") == "camera":
            values["network"] = "mlp"
            values["condition_weight"] = values["condition_weight"] or "balanced"
        return cls(**values, camera=Pixels(**camera) if camera else None)

    def make_network(
        self, windows: Windows, method: str | Method = "independent", *, seed: int
    ) -> nn.Module:
        """The network of a method, for chunks and observations of the windows' sizes.

        Raises:
            ValueError: the method adds columns to the condition, and the network is not the MLP.
        """
        method = find_method(method)
        sizes: dict[str, Any] = {"width": self.width, "blocks": self.blocks, "seed": seed}
        columns = windows.condition_dim + method.columns
        if method.columns and self.network != "mlp":
            raise ValueError(f"{method.name} needs network mlp, got {self.network}")
        if self.camera:
            return self.camera.network(windows, mean=method.columns > 0, **sizes)
        if self.network == "unet":
            return TemporalUNet(windows.points, len(windows.task.action), columns, seed=seed)
        return method.network(ResidualMLP(windows.dim, columns, **sizes))

    def pictures(self, method: Method, data: Dataset, windows: Windows) -> EmbeddedClusters | None:
        """The clusters of pictures that the coupling of a method is given, fitted to the data."""
        clusters = method.pictures(self) if self.camera and method.pictures else None
        if clusters is None or self.camera is None or data.c is None:
            return None
        return self.camera.condition(data.c, windows, clusters=clusters)

    def windows(self, episodes: Episodes) -> Windows:
        """The windows of these options, with the scale of the episodes."""
        frame = self.frame or ("agent" if self.camera else None)
        return Windows.fit(episodes, frame=frame, **{name: getattr(self, name) for name in _SHAPE})


@dataclass(frozen=True)
class Trained:
    """A trained policy.

    Attributes:
        policy: with the sampler of most evaluations.
        history: as of `fit`; of reflow, the student's.
        seconds: of training, preparations and teachers included.
        parameters: weights of the network.
        coupling: that paired its batches.
        checkpoints: files of this training, those of its preparations first.
    """

    policy: ChunkPolicy
    history: dict[str, NDArray[np.float64]]
    seconds: float
    parameters: int
    coupling: Coupling
    checkpoints: tuple[Path, ...] = ()


@dataclass
class Run:
    """A training that is about to start, which `Method.prepare` can change.

    Attributes:
        options: of the training.
        data: all windows.
        network: whose weights the training starts from.
        coupling: that pairs.
        loss: that is minimised.
        seed: of pairs and times.
        checkpoint: a file to resume from.
        progress: show a bar.
        checkpoints: that were written so far.
        seconds: spent on training so far.
    """

    options: Options
    data: Dataset
    network: nn.Module
    coupling: Coupling
    loss: Loss
    seed: int
    checkpoint: Path | None
    progress: bool | None
    checkpoints: list[Path]
    seconds: float = 0.0

    def fit(self, prefix: str = "") -> FitResult:
        """Trains a copy of the network; the checkpoint of a preparation has a prefix."""
        place = self.checkpoint and self.checkpoint.with_name(f"{prefix}{self.checkpoint.name}")
        result = fit(
            self.network,
            self.data,
            self.coupling,
            steps=self.options.steps,
            batch_size=self.options.batch_size,
            ot_batch_size=self.options.ot_batch_size if self.coupling.uses_ot_batch else None,
            seed=self.seed,
            loss=self.loss,
            learning_rate=self.options.learning_rate,
            ema=self.options.ema,
            checkpoint=place,
            progress=self.progress,
        )
        self.seconds += float(result.history["seconds"][-1])
        self.checkpoints += [place] if place else []
        return result


def train(
    method: str | Method,
    episodes: Episodes,
    *,
    seed: int = 0,
    options: Options | None = None,
    checkpoint: str | Path | None = None,
    progress: bool | None = None,
) -> Trained:
    """Trains a policy on all windows of the episodes.

    Args:
        method: a name in `METHODS`, or a row of one's own.
        episodes: to train on; hold some out before (`split`).
        seed: of weights, pairs and times. One seed gives all methods the same initial weights.
        options: the same for all methods that are to be compared.
        checkpoint: a safetensors file to resume from.
        progress: show a bar; None: in terminals and notebooks.

    Raises:
        ValueError: an unknown method, or options or a checkpoint that do not fit.
        KeyboardInterrupt: Ctrl-C, after the checkpoint has been written.
    """
    method, seed = find_method(method), check_count(seed, "seed", minimum=0)
    check_has(episodes, "episodes", "Episodes", "intention", "task")
    options = method.settle(options or Options())
    windows = options.windows(episodes)
    data = windows.dataset(episodes, label=options.label)
    pictures, loss = options.pictures(method, data, windows), method.loss(options)
    run = Run(
        options=replace(options, steps=max(1, round(options.steps / method.cost))),
        data=data,
        network=options.make_network(windows, method, seed=seed),
        coupling=method.coupling(options, pictures),
        loss=options.camera.loss(loss) if options.camera else loss,
        seed=seed,
        checkpoint=Path(checkpoint) if checkpoint else None,
        progress=progress,
        checkpoints=[],
    )
    if method.prepare:
        method.prepare(run)
    result = run.fit()
    policy = ChunkPolicy(
        result.network,
        windows,
        method.sampler(options, float(data.x1.abs().max())),
        execute=options.execute,
        fitted=pictures.state_dict() if pictures else {},
    )
    size = sum(p.numel() for p in result.network.parameters())
    return Trained(policy, result.history, run.seconds, size, run.coupling, tuple(run.checkpoints))
