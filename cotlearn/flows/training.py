"""The one training loop: any coupling, any network, any loss."""

from __future__ import annotations

import contextlib
import copy
import math
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cotlearn.couplings.base import Coupling, Sampler, Source, generator_for
from cotlearn.flows.ahead import has_spare_core, running_ahead
from cotlearn.flows.matching import Loss, conditional_flow_matching_loss, weighted_mean
from cotlearn.progress import progress_bar
from cotlearn.storage import load_tensors, save_tensors
from cotlearn.validation import check_choice, check_count, check_number

LOSS_RANDOMNESS = 1  #: keeps the times of the loss apart from the pairs (see `generator_for`)
SCHEDULES = ("cosine", "constant")


@dataclass(frozen=True)
class FitResult:
    """A trained network.

    Attributes:
        network: with the exponential moving average (EMA) of the weights, in eval mode.
        history: arrays "step", "loss" (mean since the entry before) and "seconds" (since the
            start of training, interruptions left out).
    """

    network: nn.Module
    history: dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class _Plan:
    """What must be the same when a training is resumed."""

    steps: int
    batch_size: int
    ot_batch_size: int
    seed: int
    learning_rate: float
    schedule: str
    ema: float
    coupling: str
    data: str
    loss: str


@dataclass
class _State:
    """What changes from step to step."""

    network: nn.Module
    averaged: nn.Module
    optimizer: torch.optim.Adam
    coupling: Coupling
    step: int = 0
    seconds: float = 0.0
    unlogged: list[Tensor] = field(default_factory=list)
    log: list[tuple[float, float, float]] = field(default_factory=list)

    def history(self) -> dict[str, NDArray[np.float64]]:
        rows = np.array(self.log, dtype=np.float64).reshape(-1, 3)
        return {"step": rows[:, 0], "loss": rows[:, 1], "seconds": rows[:, 2]}


def fit(
    network: nn.Module,
    data: Sampler,
    coupling: Coupling,
    *,
    steps: int,
    batch_size: int,
    ot_batch_size: int | None = None,
    source: Source | None = None,
    seed: int = 0,
    loss: Loss = conditional_flow_matching_loss,
    learning_rate: float = 2e-3,
    schedule: str = "cosine",
    ema: float = 0.99,
    log_every: int = 100,
    checkpoint: str | Path | None = None,
    checkpoint_every: int = 1000,
    progress: bool | None = None,
) -> FitResult:
    """Train a copy of `network` on pairs of `coupling`.

    The network that is passed in stays as it is, so that several couplings can start from the same
    weights. All randomness derives from (seed, step): the same call gives the same numbers on one
    machine, interrupted or not. Pairs are prepared in the background while the network trains,
    if a core is free for that (`torch.set_num_threads` below the number of cores, or training on a
    GPU) and the coupling does not look at the network.

    Args:
        network: any module that `loss` can call; with the default loss network(t, x, c) -> (B, d).
        data: has `sample(n, generator=g) -> (x1, c)`.
        coupling: pairs noise and data.
        steps: gradient steps, at least 1.
        batch_size: rows of a gradient step.
        ot_batch_size: rows that are paired at once; a multiple of batch_size (the default).
        source: draws the noise, `source(n, generator=g)`; standard normal if None.
        seed: of pairs and times. The initial weights are the network's own.
        loss: loss(network, pairs, generator) -> one value per row.
        learning_rate: of Adam, above 0.
        schedule: "cosine" lets the learning rate fall to 0 at the end, "constant" does not.
        ema: decay of the averaged weights per step, in [0, 1); smaller in the first steps.
        log_every: steps between two entries of the history.
        checkpoint: a safetensors file, written every `checkpoint_every` steps, on Ctrl-C and at
            the end. If it exists the training resumes from it.
        checkpoint_every: steps between two checkpoints.
        progress: show a bar; None: in terminals and notebooks.

    Raises:
        ValueError: an option out of range, a damaged checkpoint, or one of another training.
        RuntimeError: the loss is no longer finite.
        KeyboardInterrupt: Ctrl-C, after the checkpoint has been written.
    """
    _check_kinds(network, data, coupling)
    ot_batch_size = batch_size if ot_batch_size is None else ot_batch_size
    check_count(log_every, "log_every")
    check_count(checkpoint_every, "checkpoint_every")
    plan = _Plan(
        steps=check_count(steps, "steps"),
        batch_size=check_count(batch_size, "batch_size"),
        ot_batch_size=check_count(ot_batch_size, "ot_batch_size"),
        seed=check_count(seed, "seed", minimum=0),
        learning_rate=_positive(learning_rate, "learning_rate"),
        schedule=check_choice(schedule, "schedule", SCHEDULES),
        ema=_decay(ema),
        coupling=repr(coupling),
        data=str(getattr(data, "name", type(data).__name__)),
        loss=str(getattr(loss, "__qualname__", repr(loss))),
    )
    state = _start(network, coupling, plan)
    if checkpoint is not None and Path(checkpoint).exists():
        _load(checkpoint, state, plan)
    device = next(network.parameters()).device
    stream = coupling.stream(
        data,
        batch_size=plan.batch_size,
        ot_batch_size=plan.ot_batch_size,
        source=source,
        generator=torch.Generator().manual_seed(plan.seed),
        start=state.step,
    )
    bar = progress_bar(total=steps, initial=state.step, what=coupling.name, show=progress)
    on_gpu = device.type != "cpu"  # then the CPU waits
    ahead = coupling.solves and not coupling.uses_network and (on_gpu or has_spare_core())
    batches: Any = running_ahead(stream) if ahead else stream
    with bar, contextlib.closing(batches), _interrupt_between_steps() as interrupted:
        while state.step < steps:
            started = time.perf_counter()
            coupling.observe(state.averaged, state.step)
            pairs = next(batches).map(lambda value: value.to(device))
            _gradient_step(state, plan, pairs, loss)
            state.step += 1
            state.seconds += time.perf_counter() - started
            if state.step % log_every == 0 or state.step == steps:
                _log(state, bar)
            bar.update()
            done = state.step == steps or interrupted.is_set()
            if checkpoint is not None and (done or state.step % checkpoint_every == 0):
                _save(checkpoint, state, plan)
            if interrupted.is_set():
                raise KeyboardInterrupt(f"training stopped after step {state.step}")
    return FitResult(state.averaged.eval(), state.history())


def _start(network: nn.Module, coupling: Coupling, plan: _Plan) -> _State:
    trained = copy.deepcopy(network).train()
    if not any(p.requires_grad for p in trained.parameters()):  # as `fit` returns it
        trained.requires_grad_(True)
    averaged = copy.deepcopy(network).requires_grad_(False).eval()
    optimizer = torch.optim.Adam(trained.parameters(), lr=plan.learning_rate, fused=True)
    return _State(trained, averaged, optimizer, coupling)


def _gradient_step(state: _State, plan: _Plan, pairs: Any, loss: Loss) -> None:
    for group in state.optimizer.param_groups:
        group["lr"] = _learning_rate(plan, state.step)
    generator = generator_for(plan.seed, state.step, LOSS_RANDOMNESS)
    value = weighted_mean(loss(state.network, pairs, generator), pairs)
    state.optimizer.zero_grad(set_to_none=True)
    value.backward()
    state.optimizer.step()
    state.unlogged.append(value.detach())
    _average(state, min(plan.ema, (1 + state.step) / (10 + state.step)))


def _learning_rate(plan: _Plan, step: int) -> float:
    if plan.schedule == "constant":
        return plan.learning_rate
    return plan.learning_rate * (1 + math.cos(math.pi * step / plan.steps)) / 2


@torch.no_grad()
def _average(state: _State, decay: float) -> None:
    torch._foreach_lerp_(
        list(state.averaged.parameters()), list(state.network.parameters()), 1 - decay
    )
    for averaged, current in zip(state.averaged.buffers(), state.network.buffers(), strict=True):
        averaged.copy_(current)


def _log(state: _State, bar: Any) -> None:
    mean = float(np.mean(_finite_losses(state)))
    state.unlogged.clear()
    state.log.append((state.step, mean, state.seconds))
    bar.set_postfix(loss=f"{mean:.3f}")


def _finite_losses(state: _State) -> list[float]:
    """The losses since the last entry of the history; one that is not finite ends the training."""
    losses = [float(value) for value in state.unlogged]
    for value in losses:
        if not math.isfinite(value):
            raise RuntimeError(
                f"the loss became {value} by step {state.step}: lower learning_rate, or check the "
                "data"
            )
    return losses


@contextlib.contextmanager
def _interrupt_between_steps() -> Iterator[threading.Event]:
    """Turn Ctrl-C into an event, so that a step is never cut in half. A second one cuts it."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event  # only the main thread receives signals
        return

    def note(signum: int, frame: FrameType | None) -> None:
        if event.is_set():
            raise KeyboardInterrupt
        event.set()

    before = signal.signal(signal.SIGINT, note)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, before)


def _save(path: str | Path, state: _State, plan: _Plan) -> None:
    tensors = {f"network.{k}": v for k, v in state.network.state_dict().items()}
    tensors |= {f"averaged.{k}": v for k, v in state.averaged.state_dict().items()}
    for i, moments in state.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{i}.{k}": v for k, v in moments.items()}
    tensors |= {f"coupling.{k}": v for k, v in state.coupling.state_dict().items()}
    tensors["log"] = torch.tensor(state.log, dtype=torch.float64).reshape(-1, 3)
    tensors["unlogged"] = torch.tensor(_finite_losses(state), dtype=torch.float64)
    about = {"plan": asdict(plan), "step": state.step, "seconds": state.seconds}
    save_tensors(path, tensors, about)


def _load(path: str | Path, state: _State, plan: _Plan) -> None:
    tensors, about = load_tensors(path)
    _check_same_training(path, about.get("plan", {}), asdict(plan))
    parts: dict[str, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        part, _, rest = name.partition(".")
        parts.setdefault(part, {})[rest] = value
    try:
        state.network.load_state_dict(parts["network"])
        state.averaged.load_state_dict(parts["averaged"])
    except RuntimeError as error:
        raise ValueError(f"checkpoint {path} is of another network: {error}") from error
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in parts.get("optimizer", {}).items():
        i, _, key = name.partition(".")
        moments.setdefault(int(i), {})[key] = value
    groups = state.optimizer.state_dict()["param_groups"]
    state.optimizer.load_state_dict({"state": moments, "param_groups": groups})
    state.coupling.load_state_dict(parts.get("coupling", {}))
    state.log = [tuple(row) for row in tensors["log"].tolist()]
    state.unlogged = list(tensors["unlogged"])
    state.step, state.seconds = about["step"], about["seconds"]


def _check_same_training(path: str | Path, then: dict[str, Any], now: dict[str, Any]) -> None:
    for name, value in now.items():
        if then.get(name) != value:
            raise ValueError(
                f"checkpoint {path} is of another training: {name} was {then.get(name)!r}, now it "
                f"is {value!r}; give another path, or delete the file to start again"
            )


def _check_kinds(network: Any, data: Any, coupling: Any) -> None:
    if not isinstance(network, nn.Module):
        raise TypeError(f"network must be a torch.nn.Module, got {_kind(network)}")
    if next(network.parameters(), None) is None:
        raise ValueError("network has no parameters: there is nothing to train")
    if isinstance(data, type) or not hasattr(data, "sample"):
        raise TypeError(f"data must have sample(n, generator=g), got {_kind(data)}")
    if isinstance(coupling, type) or not hasattr(coupling, "stream"):
        raise TypeError(f"coupling must be a coupling such as Independent(), got {_kind(coupling)}")


def _kind(value: Any) -> str:
    """What a value is, for the learner who forgot the brackets."""
    return f"the class {value.__name__}" if isinstance(value, type) else type(value).__name__


def _positive(value: float, name: str) -> float:
    if check_number(value, name) == 0:
        raise ValueError(f"{name} must be above 0, got {value}")
    return float(value)


def _decay(ema: float) -> float:
    if check_number(ema, "ema") >= 1:
        raise ValueError(f"ema must lie in [0, 1), got {ema}")
    return float(ema)
