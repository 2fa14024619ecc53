"""The training loop for any coupling, network and loss."""

import contextlib
import math
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from cotlearn import validation
from cotlearn.couplings.base import Coupling, Pairs, Sampler, Source
from cotlearn.files import check_output
from cotlearn.flows.checkpoint import State, load, save
from cotlearn.flows.contents import contents
from cotlearn.flows.fingerprint import described, fingerprint
from cotlearn.flows.matching import Loss, conditional_flow_matching_loss, weighted_mean
from cotlearn.flows.prefetch import has_spare_core, prefetch
from cotlearn.interrupt import interrupt_between_steps
from cotlearn.progress import progress_bar
from cotlearn.randomness import Purpose, generator_for

SCHEDULES = ("cosine", "constant")
LAYERS = 1  #: what tells the seed of a step's dropout from that of its loss
CHECKPOINT_EVERY = 1000  #: steps between two checkpoints


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


@torch.inference_mode(False)
@torch.enable_grad()
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
    progress: bool | None = None,
) -> FitResult:
    """Train a copy of `network` on pairs from `coupling`.

    `network` itself is not changed, so several couplings can start from the same weights. All
    randomness derives from (seed, step): on one machine the same call gives the same result,
    interrupted or not; with dropout only while no other thread trains, because layers draw from
    torch's one generator. A background thread prepares pairs while the network trains, if a core is
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
        checkpoint: a safetensors file, written every `CHECKPOINT_EVERY` steps, on Ctrl-C and at the
            end. If it exists, training resumes from it. Of a coupling and a loss of one's own,
            attributes with a leading underscore may differ from those of the first training.
        progress: show a progress bar; if None, in terminals and notebooks.

    Returns:
        The trained network (EMA weights) and the history of its loss. All its weights are frozen;
        a further `fit` trains all of them, so freeze again what is to stay. A network is trained
        as a whole in train mode, layers that the caller has in eval mode, too.

    Raises:
        TypeError: network, data or coupling is of another kind.
        ValueError: an option is out of range, the coupling has too few batches, or the checkpoint
            is damaged or of another training.
        RuntimeError: the loss is no longer finite.
        KeyboardInterrupt: Ctrl-C was pressed; the checkpoint has been written.
    """
    ot_batch_size = batch_size if ot_batch_size is None else ot_batch_size
    _check_parts(network, data, coupling, loss)
    seed = validation.check_seed(seed)
    validation.check_count(log_every, "log_every")
    plan = {
        "steps": validation.check_count(steps, "steps"),
        "batch_size": validation.check_count(batch_size, "batch_size"),
        "ot_batch_size": validation.check_count(ot_batch_size, "ot_batch_size"),
        "seed": seed,
        "learning_rate": validation.check_positive(learning_rate, "learning_rate"),
        "schedule": validation.check_choice(schedule, "schedule", SCHEDULES),
        "ema": validation.check_share(ema, "ema"),
        "coupling": repr(coupling),
        "data": str(getattr(data, "name", type(data).__name__)),
        "loss": described(loss),
    }
    if checkpoint is not None:
        check_output(checkpoint, "checkpoint")
        plan |= fingerprint(network, data, source)
        plan |= {
            "contents of the network": contents(network),
            "contents of the coupling": contents(coupling),
            "contents of the loss": contents(loss),
        }
    state = State(network, coupling, plan)
    if checkpoint is not None and Path(checkpoint).exists():
        load(checkpoint, state)

    first, device = state.step, next(network.parameters()).device
    # Pairs that a network chose for several batches at once are not chosen again on resuming.
    block = ot_batch_size // batch_size if coupling.traits.needs_network else 1
    stream = coupling.stream(
        data,
        batch_size=batch_size,
        ot_batch_size=ot_batch_size,
        source=source,
        generator=torch.Generator().manual_seed(seed),
        start=first,
    )
    batches = _ahead(stream, coupling, on_gpu=device.type != "cpu")
    observers: list[Any] = [part for part in (coupling, loss) if hasattr(part, "observe")]
    bar = progress_bar(total=steps, initial=first, what=coupling.name, show=progress)
    forked = torch.random.fork_rng([device] if device.type == "cuda" else [])  # for dropout
    alone, closed = _observed_alone(coupling), contextlib.closing(batches)
    with bar, forked, alone, closed, interrupt_between_steps() as interrupted:
        while state.step < steps:
            started = time.perf_counter()
            for part in observers:
                part.observe(state.averaged, state.step)
            if (pairs := next(batches, None)) is None:
                ended = f"the stream of {type(coupling).__name__} ended after {state.step} batches"
                raise ValueError(f"{ended}, and steps is {steps}")
            if state.step == first:
                validation.check_inputs(network, pairs.x1, pairs.c, "x1")
                bar.unpause()  # what the coupling prepared first does not count for a step
            if pairs.x0.device != device:
                pairs = pairs.map(lambda value: value.to(device))
            _gradient_step(state, pairs, loss)
            state.step += 1
            state.seconds += time.perf_counter() - started
            if state.step % log_every == 0 or state.step == steps:
                _log(state, bar)
            bar.update()
            if state.step < steps and state.step % block:
                continue
            done = state.step == steps or interrupted.is_set()
            due = state.step // CHECKPOINT_EVERY > (state.step - block) // CHECKPOINT_EVERY
            if checkpoint is not None and (done or due):
                save(checkpoint, state)
            if interrupted.is_set():
                raise KeyboardInterrupt(f"training stopped after step {state.step}")
    history = dict(zip(("step", "loss", "seconds"), np.array(state.log).T, strict=True))
    return FitResult(state.averaged.eval(), history)


_observing: set[int] = set()  #: couplings that trainings of this process show their networks


@contextlib.contextmanager
def _observed_alone(coupling: Coupling) -> Iterator[None]:
    """Refuse a coupling that keeps the network of another training that still runs.

    Raises:
        RuntimeError: another thread trains with this object.
    """
    if not coupling.traits.needs_network:
        yield
        return
    if id(coupling) in _observing:
        raise RuntimeError(
            f"another training uses this {type(coupling).__name__}, which keeps one network at a "
            "time: take a coupling for each training"
        )
    _observing.add(id(coupling))
    try:
        yield
    finally:
        _observing.discard(id(coupling))


def _gradient_step(state: State, pairs: Pairs, loss: Loss) -> None:
    """One step of Adam, and of the average of the weights."""
    plan, step = state.plan, state.step
    if plan["schedule"] == "cosine":
        rate = plan["learning_rate"] * (1 + math.cos(math.pi * step / plan["steps"])) / 2
        state.optimizer.param_groups[0]["lr"] = rate
    generator = generator_for(plan["seed"], step, Purpose.LOSS)
    _seed_layers(generator.initial_seed() ^ LAYERS, state.weights[0].device)
    value = weighted_mean(loss(state.network, pairs, generator), pairs)
    if not value.requires_grad:
        raise ValueError("loss must depend on the weights of the network: it has no gradient")
    for weight in state.weights:
        weight.grad = None
    value.backward()
    state.optimizer.step()
    torch.clear_autocast_cache()  # around the whole training it would keep the weights of this step
    state.unlogged.append(value.detach())
    decay = min(plan["ema"], (1 + step) / (10 + step))
    with torch.no_grad():
        torch._foreach_lerp_(state.averages, state.weights, 1 - decay)
        for buffer, now in zip(state.averaged.buffers(), state.network.buffers(), strict=True):
            buffer.copy_(now)


def _seed_layers(seed: int, device: torch.device) -> None:
    """Seed the global generator from which layers such as dropout draw.

    `torch.manual_seed` also notes the stack for devices that are not in use, each time. On a CPU
    that takes a fifth of a small network's step.
    """
    if device.type == "cpu":
        torch.default_generator.manual_seed(seed)
    else:
        torch.manual_seed(seed)


def _log(state: State, bar: Any) -> None:
    mean = float(np.mean(state.finite_losses()))
    state.unlogged.clear()
    state.log.append((state.step, mean, state.seconds))
    bar.set_postfix(loss=f"{mean:.3f}", refresh=False)


def _ahead(stream: Iterator[Pairs], coupling: Coupling, *, on_gpu: bool) -> Any:
    """The same batches, made by a background thread where that is faster."""
    spare = on_gpu or has_spare_core()  # while a GPU trains, the CPU is idle
    worth = coupling.traits.solves and not coupling.traits.needs_network
    return prefetch(stream) if spare and worth else stream


def _check_parts(network: Any, data: Any, coupling: Any, loss: Any) -> None:
    validation.check_has(network, "network", "a torch.nn.Module", "parameters")
    wanted = "an object with sample(n, generator=g), as Dataset(x1, c)"
    validation.check_has(data, "data", wanted, "sample")
    validation.check_has(coupling, "coupling", "a coupling such as Independent()", "stream")
    validation.check_function(loss, "loss", "(network, pairs, generator) -> (B,)")
    if isinstance(loss, type):
        raise TypeError(f"loss must be a function or an object, got the class {loss.__name__}")
    if any(nn.parameter.is_lazy(weight) for weight in network.parameters()):
        raise ValueError("network has lazy layers, which have no weights yet: call it once before")
    if (weights := next(network.parameters(), None)) is None:
        raise ValueError("network has no parameters: there is nothing to train")
    if weights.dtype in (torch.float16, torch.bfloat16):
        warnings.warn(
            f"network has weights in {weights.dtype}, in which small steps and the average of "
            "weights are rounded away: keep them in float32, and train under torch.autocast",
            RuntimeWarning,
            stacklevel=3,
        )
