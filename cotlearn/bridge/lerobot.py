"""Paired noise in LeRobot's policies. LeRobot is not imported: a policy is known by its parts."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from types import MethodType, TracebackType
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from cotlearn import validation
from cotlearn.bridge.noise import Condition, PairedNoise, as_pairing
from cotlearn.couplings.base import Coupling

Batch = Mapping[str, Any]
Draw = Callable[[Tensor, Batch], Tensor]  #: paired noise for the actions of a batch

ACTION, IS_PAD = "action", "action_is_pad"
STATES = ("observation.state", "observation.environment_state")


class Change:
    """Methods of a policy that were replaced; `remove()` or the end of `with` restores them.

    A deep copy of the policy, as for an average of its weights, is changed like the policy.
    """

    def __init__(self) -> None:
        self._were: list[tuple[Any, str, Any]] = []

    def replace(self, owner: Any, name: str, make: Callable[[Any], Any]) -> None:
        """Let `make(was)` take the place of the owner's method, where was(owner, ...) calls it."""
        own = vars(owner).get(name)  # a compiled method, say
        if getattr(own, "__module__", "") == __name__:
            raise ValueError(
                "policy is paired already: call remove() of what the first pair_lerobot returned, "
                "or load it anew"
            )
        self._were.append((owner, name, own))
        was = getattr(type(owner), name) if own is None else lambda _, *args, **kw: own(*args, **kw)
        setattr(owner, name, MethodType(make(was), owner))

    def remove(self) -> None:
        """Restore the methods, the last first."""
        while self._were:
            owner, name, own = self._were.pop()
            delattr(owner, name) if own is None else setattr(owner, name, own)

    def __enter__(self) -> Change:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, e: BaseException | None, tb: TracebackType | None
    ) -> None:
        self.remove()


def pair_lerobot(
    policy: Any,
    pairing: Coupling | PairedNoise,
    *,
    condition: Callable[[Batch], Condition] | None = None,
    nfe: int = 10,
) -> Change:
    """Let a policy of LeRobot train on paired noise; its `forward(batch)` is called as before.

    - `DiffusionPolicy` becomes a flow: the loss is |network - (actions - noise)|^2 on straight
      paths, and sampling takes `nfe` Euler steps from plain noise, then clips as `clip_sample` and
      `clip_sample_range` of its configuration say. A checkpoint does not know of this: call this
      function again for a policy that was loaded, or it trains and samples as a diffusion.
    - `MultiTaskDiTPolicy` with objective="flow_matching", and SmolVLA, pi0 and pi0.5 are flows
      already; only the noise of their loss changes. They sample as before.

    Steps that "action_is_pad" marks do not count in the pairing.

    Args:
        policy: changed in place, until `remove()` of what is returned.
        pairing: a coupling, or `PairedNoise` of one.
        condition: reads the condition in a batch, see `paired_noise`; the states if None. A policy
            that sees pictures needs it, as pictures make the actions differ for equal states.
        nfe: evaluations per chunk of a `DiffusionPolicy`.

    Raises:
        TypeError: the policy is none of these.
        ValueError: the policy is paired already, it sees pictures and there is no `condition`, or
            it is trained as a diffusion; in `forward`: actions have another horizon than the
            policy.
    """
    validation.check_count(nfe, "nfe")
    if condition is None and getattr(policy.config, "image_features", None):
        raise ValueError(
            "condition is missing: the policy sees pictures, so give a function of a batch that "
            "returns a dictionary of its state and of the pictures' clusters"
        )
    read, noise = condition or _states, as_pairing(pairing)

    def draw(actions: Tensor, batch: Batch) -> Tensor:
        return noise(actions, read(batch), is_pad=batch.get(IS_PAD))

    if hasattr(policy, "diffusion"):
        return _diffusion(policy.diffusion, draw, nfe)
    if hasattr(policy, "objective"):
        return _transformer(policy.objective, draw)
    if hasattr(getattr(policy, "model", None), "sample_noise"):
        return _language_model(policy, draw)
    name = type(policy).__name__
    raise TypeError(f"policy must be Diffusion, MultiTaskDiT, SmolVLA, pi0 or pi0.5, got {name}")


def _states(batch: Batch) -> Condition:
    return {name: batch[name] for name in STATES if name in batch}


def _diffusion(model: Any, draw: Draw, nfe: int) -> Change:
    """`DiffusionModel` as a flow; its network is given t in units of the diffusion's steps."""
    steps, horizon = model.noise_scheduler.config.num_train_timesteps, model.config.horizon

    def make_loss(_: Any) -> Any:
        def compute_loss(self: Any, batch: Batch) -> Tensor:
            actions = batch[ACTION]
            if actions.shape[1] != horizon:
                raise ValueError(f"action has {actions.shape[1]} steps, but horizon is {horizon}")
            seen = self._prepare_global_conditioning(batch)
            noise = draw(actions, batch)
            t = torch.rand(len(actions), dtype=actions.dtype, device=actions.device)
            x_t = torch.lerp(noise, actions, t[:, None, None])
            velocity = self.unet(x_t, steps * t, global_cond=seen)
            error = (velocity - (actions - noise)).square()
            if self.config.do_mask_loss_for_padding:
                inside = ~batch[IS_PAD]
                return error.mean(dim=2)[inside].sum() / inside.sum().clamp_min(1)
            return error.mean()

        return compute_loss

    def make_sampler(_: Any) -> Any:
        def conditional_sample(
            self: Any,
            batch_size: int,
            global_cond: Tensor | None = None,
            generator: torch.Generator | None = None,
            noise: Tensor | None = None,
        ) -> Tensor:
            weights = next(self.parameters())
            shape = (batch_size, horizon, self.config.action_feature.shape[0])
            kind = {"dtype": weights.dtype, "device": weights.device}
            x = torch.randn(shape, generator=generator, **kind) if noise is None else noise
            for step in range(nfe):
                t = torch.full((batch_size,), steps * step / nfe, **kind)
                x = x + self.unet(x, t, global_cond=global_cond) / nfe
            reach = self.config.clip_sample_range if self.config.clip_sample else math.inf
            return x.clamp(-reach, reach)

        return conditional_sample

    change = Change()
    change.replace(model, "compute_loss", make_loss)
    change.replace(model, "conditional_sample", make_sampler)
    return change


class _Given(TorchFunctionMode):
    """The first `torch.randn_like` of this shape is the noise that is given."""

    def __init__(self, noise: Tensor) -> None:
        super().__init__()
        self.noise, self.taken = noise, False

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func is torch.randn_like and not self.taken and args[0].shape == self.noise.shape:
            self.taken = True
            return self.noise
        return func(*args, **(kwargs or {}))


def _transformer(objective: Any, draw: Draw) -> Change:
    """The objective of `MultiTaskDiTPolicy`, whose loss draws noise by `torch.randn_like`."""
    if not objective.config.is_flow_matching:
        raise ValueError("policy is trained as a diffusion: set objective='flow_matching'")

    def make(was: Any) -> Any:
        def compute_loss(self: Any, model: nn.Module, batch: Batch, *seen: Any, **more: Any) -> Any:
            with _Given(draw(batch[ACTION], batch)) as given:
                loss = was(self, model, batch, *seen, **more)
            if not given.taken:
                raise RuntimeError("this version of LeRobot draws its noise in another way")
            return loss

        return compute_loss

    change = Change()
    change.replace(objective, "compute_loss", make)
    return change


def _language_model(policy: Any, draw: Draw) -> Change:
    """SmolVLA, pi0, pi0.5: `model.forward(..., actions, noise, time)` takes the noise.

    Depending on the version, its caller draws the noise or leaves that to it. Here it is replaced
    in any case, for the actions that the model sees. Sampling does not call `forward`.
    """
    names = inspect.signature(type(policy.model).forward)
    batches: list[Batch] = []

    def make_outer(was: Any) -> Any:
        def forward(self: Any, batch: Batch, *args: Any, **options: Any) -> Any:
            batches.append(batch)
            try:
                return was(self, batch, *args, **options)
            finally:
                batches.pop()

        return forward

    def make_inner(was: Any) -> Any:
        def forward(self: Any, *args: Any, **options: Any) -> Any:
            given = names.bind(self, *args, **options)
            if batches:
                given.arguments["noise"] = draw(given.arguments["actions"], batches[-1])
            return was(*given.args, **given.kwargs)

        return forward

    change = Change()
    change.replace(policy, "forward", make_outer)
    change.replace(policy.model, "forward", make_inner)
    return change
