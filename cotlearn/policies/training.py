"""Train policies: every method on the same data, network and budget."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cotlearn.couplings import (
    ConditionalOT,
    Coupling,
    Independent,
    MinibatchOT,
    ModelAligned,
    StratifiedOT,
)
from cotlearn.couplings.base import generator_for
from cotlearn.couplings.conditional import BALANCED
from cotlearn.couplings.conditions import EmbeddedClusters
from cotlearn.couplings.reflow import FixedPairs
from cotlearn.couplings.transformed import OfCondition, centred
from cotlearn.datasets import Dataset
from cotlearn.flows.diffusion import Diffusion, predict, regression_loss
from cotlearn.flows.matching import EarlyFlowMatching, Loss, conditional_flow_matching_loss
from cotlearn.flows.networks import ResidualMLP, TemporalUNet
from cotlearn.flows.solvers import integrate
from cotlearn.flows.training import FitResult, fit
from cotlearn.policies.policy import (
    ChunkPolicy,
    DDPMSampler,
    FlowSampler,
    MeanSampler,
    Sampler,
)
from cotlearn.policies.windows import Windows
from cotlearn.robots.episodes import Episodes
from cotlearn.validation import check_choice, check_count, check_number

#: name: what it is
METHODS = {
    "independent": "flow matching, independent pairs",
    "minibatch_ot": "flow matching, naive minibatch OT",
    "conditional_ot": "flow matching, COT with a condition weight",
    "stratified": "flow matching, one assignment for each cluster of conditions and epoch",
    "residual": "as stratified, by what the condition leaves over of the chunk",
    "centred": "as stratified, by what a regression, trained before, leaves over of the chunk",
    "aligned": "flow matching, model-aligned pairs (MAC, weighted)",
    "reflow": "rectified flow on the pairs of a flow with independent pairs",
    "behaviour_cloning": "regression of the chunk, mean squared error",
    "diffusion": "DDPM with 100 levels",
}
NETWORKS = ("mlp", "unet", "camera")
_LOSSES: dict[str, Loss] = {"behaviour_cloning": regression_loss, "diffusion": Diffusion().loss}


@dataclass(frozen=True)
class Options:
    """What a training is made of, the same for all methods unless said otherwise.

    Attributes:
        steps: gradient steps; of reflow, for the teacher and for the student; of "centred", for the
            flow, and a fifth of it for the regression before.
        batch_size: rows of a gradient step.
        learning_rate: of Adam, falling to 0 by a cosine.
        ema: decay of the averaged weights.
        network: "mlp", the residual MLP; "unet", the temporal U-Net; or, of `CameraOptions` alone,
            "camera".
        width: of the MLP's layers.
        blocks: of the MLP.
        frame: of the task, see `Windows`; its first if None.
        label: "intention" or "action", see `Windows.dataset`.
        scale: "deviation" or "range", see `Windows.fit`.
        observe: steps that a policy sees.
        predict: steps of a chunk.
        execute: steps that are done of it.
        knots: points that stand for a chunk; every step if None.
        whole: predict whole episodes from their starts, see `Windows`.
        early: share of the rows of a flow that are trained at t = 0, see `EarlyFlowMatching`.
        ot_batch_size: rows of minibatch OT and COT.
        condition_weight: of COT; None: COT Policy's rule, "balanced" (`bench` asks the frontier).
        clusters: of stratified OT; None where the frontier is to choose (`with_choice`).
        reflow_pairs: rows that the teacher pairs for reflow.
        reflow_nfe: evaluations with which it does.
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
    whole: bool = False
    early: float = 0.0
    ot_batch_size: int = 512
    condition_weight: float | None = None
    clusters: int | None = 4096
    reflow_pairs: int = 200_000
    reflow_nfe: int = 16

    def __post_init__(self) -> None:
        check_choice(self.network, "network", NETWORKS)
        for name in ("steps", "batch_size", "reflow_pairs", "reflow_nfe"):
            check_count(getattr(self, name), name)
        if self.clusters is not None:
            check_count(self.clusters, "clusters")
        if self.condition_weight is not None:
            check_number(self.condition_weight, "condition_weight")
        if check_count(self.execute, "execute") > check_count(self.predict, "predict"):
            raise ValueError(
                f"execute must be at most the {self.predict} predicted steps, got {self.execute}"
            )

    def loss_of(self, method: str) -> Loss:
        """What a method minimises."""
        if method in _LOSSES:
            return _LOSSES[method]
        return EarlyFlowMatching(self.early) if self.early else conditional_flow_matching_loss

    def make_network(self, windows: Windows, *, seed: int) -> nn.Module:
        """A network for chunks and observations of the windows' sizes."""
        if self.network == "unet":
            sizes = windows.points, windows.action_dim, windows.condition_dim
            return TemporalUNet(*sizes, seed=seed)
        return ResidualMLP(
            windows.dim, windows.condition_dim, width=self.width, blocks=self.blocks, seed=seed
        )

    def asks_the_frontier(self, method: str) -> bool:
        """Whether the frontier chooses what the method leaves open."""
        return True

    def condition_of(
        self, method: str, data: Dataset, windows: Windows | None = None
    ) -> EmbeddedClusters | None:
        """What the coupling of a method sees instead of the conditions; None: these themselves.

        Args:
            method: a key of `METHODS`.
            data: rows of the windows; what is seen is fitted to them.
            windows: that made the data.
        """
        return None

    def coupling_of(
        self, method: str, seen: EmbeddedClusters | None = None, windows: Windows | None = None
    ) -> Coupling:
        """The coupling that a method trains with (reflow: its teacher).

        Args:
            method: a key of `METHODS`.
            seen: what `condition_of` gave for it.
            windows: that made the data.
        """
        if method == "minibatch_ot":
            return MinibatchOT()
        if method == "conditional_ot":
            weight = BALANCED if self.condition_weight is None else self.condition_weight
            return ConditionalOT(weight, condition=seen)
        if method in ("stratified", "residual", "centred"):
            if self.clusters is None:
                raise ValueError("clusters must be a number by now, got None: see with_choice")
            return StratifiedOT(seen or self.clusters, residual=method == "residual")
        if method == "aligned":
            return ModelAligned("weighted", warmup_steps=self.steps // 5)
        return Independent()

    def fitting(self, episodes: Episodes) -> Options:
        """These options where the episodes have intentions; human demonstrators do not say."""
        return replace(self, label="action") if episodes.intention is None else self

    def windows(self, episodes: Episodes) -> Windows:
        """The windows of these options, with the scale of the episodes."""
        return Windows.fit(
            episodes,
            observe=self.observe,
            predict=self.predict,
            frame=self.frame,
            label=self.label,
            scale=self.scale,
            knots=self.knots,
            whole=self.whole,
        )


@dataclass(frozen=True)
class Trained:
    """A trained policy.

    Attributes:
        policy: with the sampler of most evaluations.
        history: as of `fit`; of reflow, the student's.
        seconds: of training, a teacher's included.
        parameters: weights of the network.
        coupling: that paired its batches.
    """

    policy: ChunkPolicy
    history: dict[str, NDArray[np.float64]]
    seconds: float
    parameters: int
    coupling: Coupling


def train(
    method: str,
    episodes: Episodes,
    *,
    seed: int = 0,
    options: Options | None = None,
    teacher: Trained | None = None,
    checkpoint: str | Path | None = None,
    progress: bool | None = None,
) -> Trained:
    """Trains a policy on all windows of the episodes.

    Args:
        method: a key of `METHODS`.
        episodes: to train on; hold some out before (`split`).
        seed: of weights, pairs and times. One seed gives all methods the same initial weights.
        options: the same for all methods that are to be compared.
        teacher: of reflow, trained with the same arguments as "independent"; made anew if None.
        checkpoint: a safetensors file to resume from.
        progress: show a bar; None: in terminals and notebooks.

    Raises:
        ValueError: an unknown method, or options or a checkpoint that do not fit.
        KeyboardInterrupt: Ctrl-C, after the checkpoint has been written.
    """
    check_choice(method, "method", tuple(METHODS))
    options = options or Options()
    options = options.fitting(episodes)
    windows = options.windows(episodes)
    data = windows.dataset(episodes, label=options.label)
    network = options.make_network(windows, seed=seed)
    seen = options.condition_of(method, data, windows)
    place = None if checkpoint is None else Path(checkpoint)
    if method == "reflow":
        if teacher is None:
            first = None if place is None else place.with_name(f"teacher_{place.name}")
            teacher = train(
                "independent",
                episodes,
                seed=seed,
                options=options,
                checkpoint=first,
                progress=progress,
            )
        result, coupling, seconds = _reflow(
            teacher.policy.network, data, seed, options, place, progress
        )
        seconds += teacher.seconds
    else:
        coupling, seconds = options.coupling_of(method, seen, windows), 0.0
        if method == "centred":
            mean, seconds = _regression(windows, data, seed, options, place, progress)
            coupling = centred(coupling, mean)
        loss = options.loss_of(method)
        result = _fit(network, data, coupling, loss, seed, options, place, progress)
    seconds += float(result.history["seconds"][-1])
    policy = ChunkPolicy(
        result.network,
        windows,
        sampler_for(method, float(data.x1.abs().max())),
        execute=options.execute,
        fitted=None if seen is None else seen.state_dict(),
    )
    parameters = sum(p.numel() for p in result.network.parameters())
    return Trained(policy, result.history, seconds, parameters, coupling)


def sampler_for(method: str, clip: float) -> Sampler:
    """How a policy of this method is drawn from at its best; diffusion keeps within clip."""
    if method == "behaviour_cloning":
        return MeanSampler()
    return DDPMSampler(clip=clip) if method == "diffusion" else FlowSampler(nfe=16)


def _fit(
    network: nn.Module,
    data: Dataset,
    coupling: Coupling,
    loss: Loss,
    seed: int,
    options: Options,
    checkpoint: Path | None,
    progress: bool | None,
) -> FitResult:
    return fit(
        network,
        data,
        coupling,
        steps=options.steps,
        batch_size=options.batch_size,
        ot_batch_size=options.ot_batch_size if coupling.uses_ot_batch else None,
        seed=seed,
        loss=loss,
        learning_rate=options.learning_rate,
        ema=options.ema,
        checkpoint=checkpoint,
        progress=progress,
    )


def _regression(
    windows: Windows,
    data: Dataset,
    seed: int,
    options: Options,
    checkpoint: Path | None,
    progress: bool | None,
) -> tuple[OfCondition, float]:
    """What a regression foretells of the chunk, after a fifth of the steps, and its seconds.

    A short training on purpose: one that remembers the rows leaves nothing of them over.
    """
    network = options.make_network(windows, seed=seed)
    shorter = replace(options, steps=max(1, options.steps // 5))
    place = None if checkpoint is None else checkpoint.with_name(f"regression_{checkpoint.name}")
    result = _fit(network, data, Independent(), regression_loss, seed, shorter, place, progress)

    def mean(c: Tensor) -> Tensor:
        parts = (predict(result.network, o.new_zeros(len(o), data.dim), o) for o in c.split(8192))
        return torch.cat(list(parts))

    return mean, float(result.history["seconds"][-1])


def _reflow(
    teacher: nn.Module,
    data: Dataset,
    seed: int,
    options: Options,
    checkpoint: Path | None,
    progress: bool | None,
) -> tuple[FitResult, Coupling, float]:
    """The student, which starts from its teacher's weights, and the seconds for its pairs."""
    started = time.perf_counter()
    rng = generator_for(seed, 0, purpose=21)
    _, c = data.sample(options.reflow_pairs, generator=rng)
    assert c is not None
    x0 = torch.randn(len(c), data.dim, generator=rng)
    parts = [
        integrate(teacher, noise, some, nfe=options.reflow_nfe).x1
        for noise, some in zip(x0.split(4096), c.split(4096), strict=True)
    ]
    made = Dataset(torch.cat(parts), c, name=f"{data.name}, made by a teacher")
    seconds = time.perf_counter() - started
    loss = options.loss_of("reflow")
    coupling = FixedPairs(x0)
    result = _fit(teacher, made, coupling, loss, seed, options, checkpoint, progress)
    return result, coupling, seconds
