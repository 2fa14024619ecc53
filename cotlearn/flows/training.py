"""The training loop for any coupling, network and loss."""

import contextlib
import copy
import math
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cotlearn import validation
from cotlearn.couplings.base import Coupling, Pairs, Sampler, Source, generator_for
from cotlearn.flows.fingerprint import fingerprint
from cotlearn.flows.matching import Loss, conditional_flow_matching_loss, weighted_mean
from cotlearn.flows.prefetch import has_spare_core, prefetch
from cotlearn.progress import progress_bar
from cotlearn.storage import load_tensors, save_tensors

LOSS_RANDOMNESS = 1  #: `purpose` of the loss's generators (see `generator_for`)
SCHEDULES = ("cosine", "constant")


@dataclass(frozen=True)
class FitResult:
    """A trained network.

    Attributes:
        network: the network with the exponential moving average (EMA) of the weights, in eval mode.
        history: arrays "step", "loss" (mean since the previous entry) and "seconds" (training time
            without interruptions).
    """

    network: nn.Module
    history: dict[str, NDArray[np.float64]]


class _State:
    """The state of a training; `plan` holds the options that must not change when it resumes.

    `weights` and `averages` are the parameters of the two networks: to collect them at every step
    takes as long as the step of a small network's optimizer.
    """

    def __init__(self, network: nn.Module, coupling: Coupling, plan: dict[str, Any]) -> None:
        self.network = copy.deepcopy(network).train()
        if not any(p.requires_grad for p in network.parameters()):  # a network that `fit` returned
            self.network.requires_grad_(True)
        self.averaged = copy.deepcopy(network).requires_grad_(False).eval()
        self.weights: list[Tensor] = list(self.network.parameters())
        self.averages: list[Tensor] = list(self.averaged.parameters())
        self.optimizer = torch.optim.Adam(self.weights, lr=plan["learning_rate"], fused=True)
        self.coupling, self.plan = coupling, plan
        self.step, self.seconds = 0, 0.0
        self.unlogged: list[Tensor] = []
        self.log: list[tuple[float, ...]] = []


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
    """Train a copy of `network` on pairs from `coupling`.

    `network` itself is not changed, so several couplings can start from the same weights. All
    randomness derives from (seed, step): on one machine the same call gives the same result,
    interrupted or not. A background thread prepares pairs while the network trains, if a core is
    free (torch uses fewer threads than there are cores, or trains on a GPU) and the coupling does
    not use the network.

    Args:
        network: any module that `loss` can call; for the default loss, network(t, x, c) -> (B, d).
        data: has `sample(n, generator=g) -> (x1, c)`.
        coupling: pairs noise with data.
        steps: gradient steps, at least 1.
        batch_size: rows of a gradient step.
        ot_batch_size: rows that are paired at once, a multiple of batch_size; batch_size if None.
        source: draws the noise, `source(n, generator=g)`; standard normal if None.
        seed: of pairs and times; the initial weights are those of `network`.
        loss: loss(network, pairs, generator) -> one value per row, (B,). If it has
            `observe(network, step)`, that is called before each step.
        learning_rate: of Adam, above 0.
        schedule: "cosine" (the learning rate falls to 0) or "constant".
        ema: decay of the averaged weights, in [0, 1]; step s uses at most (1 + s)/(10 + s).
        log_every: steps between two entries of the history.
        checkpoint: a safetensors file, written every `checkpoint_every` steps, on Ctrl-C and at
            the end. If it exists, training resumes from it.
        checkpoint_every: steps between two checkpoints.
        progress: show a progress bar; if None, in terminals and notebooks.

    Returns:
        The trained network (EMA weights) and the history of its loss.

    Raises:
        TypeError: network, data or coupling is of another kind.
        ValueError: an option is out of range, or the checkpoint is damaged or of another training.
        RuntimeError: the loss is no longer finite.
        KeyboardInterrupt: Ctrl-C was pressed; the checkpoint has been written.
    """
    _check_kinds(network, data, coupling)
    validation.check_function(loss, "loss", "(network, pairs, generator) -> (B,)")
    if checkpoint is not None:
        validation.check_output(checkpoint, "checkpoint")
    validation.check_count(log_every, "log_every")
    validation.check_count(checkpoint_every, "checkpoint_every")
    ot_batch_size = batch_size if ot_batch_size is None else ot_batch_size
    plan = {
        "steps": validation.check_count(steps, "steps"),
        "batch_size": validation.check_count(batch_size, "batch_size"),
        "ot_batch_size": validation.check_count(ot_batch_size, "ot_batch_size"),
        "seed": validation.check_count(seed, "seed", minimum=0),
        "learning_rate": validation.check_positive(learning_rate, "learning_rate"),
        "schedule": validation.check_choice(schedule, "schedule", SCHEDULES),
        "ema": validation.check_share(ema, "ema"),
        "coupling": repr(coupling),
        "data": str(getattr(data, "name", type(data).__name__)),
        "loss": _name(loss),
    }
    if checkpoint is not None:
        plan |= fingerprint(network, data, source, loss)
    state = _State(network, coupling, plan)
    if checkpoint is not None and Path(checkpoint).exists():
        _load(checkpoint, state)
    first, device = state.step, next(network.parameters()).device
    stream = coupling.stream(
        data,
        batch_size=batch_size,
        ot_batch_size=ot_batch_size,
        source=source,
        generator=torch.Generator().manual_seed(seed),
        start=first,
    )
    bar = progress_bar(total=steps, initial=first, what=coupling.name, show=progress)
    on_gpu = device.type != "cpu"  # then the CPU is idle
    ahead = coupling.solves and not coupling.uses_network and (on_gpu or has_spare_core())
    batches: Any = prefetch(stream) if ahead else stream
    observers: list[Any] = [part for part in (coupling, loss) if hasattr(part, "observe")]
    with bar, contextlib.closing(batches), _interrupt_between_steps() as interrupted:
        while state.step < steps:
            started = time.perf_counter()
            for part in observers:
                part.observe(state.averaged, state.step)
            pairs = next(batches)
            if state.step == first:
                validation.check_inputs(network, pairs.x1, pairs.c, "x1")
            if pairs.x0.device != device:
                pairs = pairs.map(lambda value: value.to(device))
            _gradient_step(state, pairs, loss)
            state.step += 1
            state.seconds += time.perf_counter() - started
            if state.step % log_every == 0 or state.step == steps:
                _log(state, bar)
            bar.update()
            done = state.step == steps or interrupted.is_set()
            if checkpoint is not None and (done or state.step % checkpoint_every == 0):
                _save(checkpoint, state)
            if interrupted.is_set():
                raise KeyboardInterrupt(f"training stopped after step {state.step}")
    history = dict(zip(("step", "loss", "seconds"), np.array(state.log).T, strict=True))
    return FitResult(state.averaged.eval(), history)


def _name(loss: Loss) -> str:
    """A loss as a checkpoint records it: a function's name, or an object's parameters."""
    owner = getattr(loss, "__self__", None)
    name = str(getattr(loss, "__qualname__", None) or _printed(loss))
    return name if owner is None else f"{_printed(owner)}: {name}"


def _printed(value: Any) -> str:
    """An object's repr, or its class where the repr is an address that changes with the process."""
    kind: Any = type(value)
    return str(kind.__qualname__) if kind.__repr__ is object.__repr__ else repr(value)


def _gradient_step(state: _State, pairs: Pairs, loss: Loss) -> None:
    plan, step = state.plan, state.step
    if plan["schedule"] == "cosine":
        rate = plan["learning_rate"] * (1 + math.cos(math.pi * step / plan["steps"])) / 2
        state.optimizer.param_groups[0]["lr"] = rate
    generator = generator_for(plan["seed"], step, LOSS_RANDOMNESS)
    value = weighted_mean(loss(state.network, pairs, generator), pairs)
    for weight in state.weights:
        weight.grad = None
    value.backward()
    state.optimizer.step()
    state.unlogged.append(value.detach())
    decay = min(plan["ema"], (1 + step) / (10 + step))
    with torch.no_grad():
        torch._foreach_lerp_(state.averages, state.weights, 1 - decay)
        for buffer, now in zip(state.averaged.buffers(), state.network.buffers(), strict=True):
            buffer.copy_(now)


def _log(state: _State, bar: Any) -> None:
    mean = float(np.mean(_finite_losses(state)))
    state.unlogged.clear()
    state.log.append((state.step, mean, state.seconds))
    bar.set_postfix(loss=f"{mean:.3f}", refresh=False)


def _finite_losses(state: _State) -> list[float]:
    """The losses since the last entry of the history; raise RuntimeError if one is not finite."""
    losses = [float(value) for value in state.unlogged]
    for value in losses:
        if not math.isfinite(value):
            became = f"the loss became {value} by step {state.step}"
            raise RuntimeError(f"{became}: lower learning_rate, or check the data")
    return losses


@contextlib.contextmanager
def _interrupt_between_steps() -> Iterator[threading.Event]:
    """Turn Ctrl-C into an event, so that a step is completed; a second Ctrl-C interrupts it."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event  # only the main thread receives signals
        return

    def note(signum: int, frame: Any) -> None:
        if event.is_set():
            raise KeyboardInterrupt
        event.set()

    before = signal.signal(signal.SIGINT, note)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, before)


def _save(path: str | Path, state: _State) -> None:
    parts = {
        "network": state.network.state_dict(),
        "averaged": state.averaged.state_dict(),
        "coupling": state.coupling.state_dict(),
    }
    for i, moments in state.optimizer.state_dict()["state"].items():
        parts[f"optimizer.{i}"] = moments
    tensors = {f"{part}.{k}": v for part, values in parts.items() for k, v in values.items()}
    tensors["log"] = torch.tensor(state.log, dtype=torch.float64).reshape(-1, 3)
    tensors["unlogged"] = torch.tensor(_finite_losses(state), dtype=torch.float64)
    save_tensors(path, tensors, {n: getattr(state, n) for n in ("plan", "step", "seconds")})


def _load(path: str | Path, state: _State) -> None:
    tensors, about = load_tensors(path)
    then = about.get("plan", {})
    for name, value in state.plan.items():
        if then.get(name, value) != value:  # files of older versions say less
            raise ValueError(
                f"checkpoint {path} is of another training: {name} was {then[name]!r}, now it "
                f"is {value!r}; give another path, or delete the file to start again"
            )

    def part(prefix: str) -> dict[str, Tensor]:
        return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}

    try:
        state.network.load_state_dict(part("network."))
        state.averaged.load_state_dict(part("averaged."))
    except RuntimeError as error:
        raise ValueError(f"checkpoint {path} is of another network: {error}") from error
    numbers = {int(name.split(".")[0]) for name in part("optimizer.")}
    moments = {i: part(f"optimizer.{i}.") for i in sorted(numbers)}
    groups = state.optimizer.state_dict()["param_groups"]
    state.optimizer.load_state_dict({"state": moments, "param_groups": groups})
    state.coupling.load_state_dict(part("coupling."))
    state.log = [tuple(row) for row in tensors["log"].tolist()]
    state.unlogged = list(tensors["unlogged"])
    state.step, state.seconds = about["step"], about["seconds"]


def _check_kinds(network: Any, data: Any, coupling: Any) -> None:
    validation.check_has(network, "network", "a torch.nn.Module", "parameters")
    wanted = "an object with sample(n, generator=g), as Dataset(x1, c)"
    validation.check_has(data, "data", wanted, "sample")
    validation.check_has(coupling, "coupling", "a coupling such as Independent()", "stream")
    if next(network.parameters(), None) is None:
        raise ValueError("network has no parameters: there is nothing to train")
