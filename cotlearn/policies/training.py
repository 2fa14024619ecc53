"""Train policies: every method on the same data, network and budget."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import nn

from cotlearn.couplings import Coupling
from cotlearn.datasets import Dataset
from cotlearn.flows.matching import Loss
from cotlearn.flows.training import FitResult, fit
from cotlearn.policies.methods import Method, find_method
from cotlearn.policies.options import Options
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.robots.episodes import Episodes
from cotlearn.validation import check_has, check_seed


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
        many = self.options.ot_batch_size if self.coupling.traits.uses_ot_batch else None
        place = self.checkpoint and self.checkpoint.with_name(f"{prefix}{self.checkpoint.name}")
        result = fit(
            self.network,
            self.data,
            self.coupling,
            steps=self.options.steps,
            batch_size=self.options.batch_size,
            ot_batch_size=many,
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
    method, seed = find_method(method), check_seed(seed)
    check_has(episodes, "episodes", "Episodes", "intention", "task")
    options = method.settle(options or Options())
    windows = options.windows(episodes)
    data = windows.dataset(episodes, label=options.label)
    pictures, loss = method.fitted_pictures(options, data, windows), method.loss(options)
    run = Run(
        options=replace(options, steps=max(1, round(options.steps / method.cost))),
        data=data,
        network=method.make_network(options, windows, seed=seed),
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
