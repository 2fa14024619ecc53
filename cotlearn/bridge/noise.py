"""Paired noise for a batch whose rows stay where they are: the permutation goes to the noise."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Generator, Tensor
from torch.utils.data import get_worker_info

from cotlearn import validation
from cotlearn.couplings.base import Coupling, Pairs
from cotlearn.couplings.conditions import combine
from cotlearn.diagnostics.skew import ROWS_FOR_EACH, LinearSkew, linear_skew

Condition = Tensor | Mapping[str, Tensor] | None

CHECK_AFTER = 100  #: batches, after which `PairedNoise` tests its noise
IN_A_WORKER = 20  #: the same in a worker of a DataLoader, which may end with its epoch
KEPT_ROWS = 20_000  #: of noise and condition, for this test
CELLS = 64  #: of the condition, in this test
COLUMNS = 256  #: of the noise, in this test: of more, evenly spaced ones
TOO_SKEWED = 0.05  #: share of the noise's variance that the condition explains, for a warning


def paired_noise(
    coupling: Coupling,
    actions: Tensor,
    condition: Condition = None,
    *,
    is_pad: Tensor | None = None,
    generator: Generator | None = None,
    noise: Tensor | None = None,
) -> Tensor:
    """Noise like `actions`: row i is what the coupling pairs with actions[i].

    Padding does not count. A column with one value for all rows, as in actions that are padded to a
    model's width, changes no plan, but weighs in a "balanced" condition weight, so it is left out.
    A padded step counts as the mean of the batch's steps that are there, around a mean of c
    (`centred`) as that. Without `centred`, noise of the last steps can depend on the condition
    where their mean does; where half of them are padded, its deviation is too large by some 4 %
    in chunks of 16 steps and 2 columns, 17 % in those of 4 and 2, and not in those of 16 and 7.

    Args:
        coupling: pairs rows of a batch and uses each once, as `ConditionalOT`.
        actions: (B, ...), as chunks (B, T, D) or images (B, C, H, W); any device and
            floating-point type.
        condition: of each row: numbers (B,), (B, k) or (B, T, k); integer labels (B,); or a
            dictionary of these, which count equally (see `combine`). For pictures (B, C, H, W) give
            `clusters(pictures.flatten(1))` of fitted `EmbeddedClusters`, or the pictures if the
            coupling has these as its `condition`. A coupling with a function of c, or with fitted
            clusters, takes numbers only: of labels and dictionaries each batch makes its own.
        is_pad: (B, T), true for steps after an episode's end, as LeRobot's "action_is_pad".
        generator: source of randomness; torch's global generator if None. In a worker of a
            `DataLoader` it starts at the worker's own seed, so that no two draw the same.
        noise: (B, ...), to be paired; standard normal if None.

    Returns:
        Noise with the shape, device and type of `actions`, without a gradient.

    Raises:
        TypeError: an argument is of another kind.
        ValueError: shapes do not match, the coupling does more than move rows, steps are padded and
            it pairs in a frame, or it has a function of c that is given labels or a dictionary.
    """
    return _untraced(_paired)(coupling, actions, condition, is_pad, generator, noise)[0]


class PairedNoise:
    """`paired_noise` of many batches, with a warning if the noise depends on the condition.

    Such noise is not what a network samples from later. After 100 batches (more if they are small)
    `skew` is computed, of at most 256 columns; a share above 0.05 gives a warning. A worker of a
    `DataLoader` tests its own noise, after 20 of its batches. Labels of more than 64 values are
    taken for numbers, of which near ones are put together: make them one-hot.

    Args:
        coupling: as in `paired_noise`.
        generator: as in `paired_noise`.
    """

    def __init__(self, coupling: Coupling, *, generator: Generator | None = None) -> None:
        self.coupling = _check_coupling(coupling)
        validation.check_generator(generator)
        self.generator = generator
        self._kept: list[tuple[Tensor, Tensor, Condition]] = []
        self._checked = False

    def __call__(
        self,
        actions: Tensor,
        condition: Condition = None,
        *,
        is_pad: Tensor | None = None,
        noise: Tensor | None = None,
    ) -> Tensor:
        """Noise like `actions`, as `paired_noise` returns it."""
        return _untraced(self._pair)(actions, condition, is_pad, noise)

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled: torch's generator loses its state on the way to a spawned worker."""
        state = dict(vars(self))
        if self.generator is not None:
            state["generator"] = self.generator.device, self.generator.get_state().tolist()
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if state["generator"] is not None:
            device, numbers = state["generator"]
            self.generator = Generator(device)
            self.generator.set_state(torch.tensor(numbers, dtype=torch.uint8, device="cpu"))

    def skew(self) -> LinearSkew:
        """The share of the noise's variance between 64 cells of the condition, and its p-value.

        It is of the batches that were kept for the test, the first 100 or some more.

        Raises:
            ValueError: too few rows with a condition were paired until now.
        """
        if not self._kept:
            raise ValueError("skew needs noise that was paired with a condition: pair a batch")
        if not (varied := self._varied()).any():
            raise ValueError("skew needs batches in which some column of the actions varies")
        x0, _, conditions = zip(*self._kept, strict=True)
        noise, c = torch.cat(x0)[:KEPT_ROWS], _together(conditions)[:KEPT_ROWS]
        return linear_skew(noise[:, varied], c, cells=CELLS)

    def _pair(
        self, actions: Tensor, condition: Condition, is_pad: Tensor | None, noise: Tensor | None
    ) -> Tensor:
        """Pair, and keep what was paired until it is enough for the test."""
        options = is_pad, self.generator, noise
        paired, moved, varies = _paired(self.coupling, actions, condition, *options)
        if condition is not None and not self._checked:
            if clusters := getattr(self.coupling, "condition", None):
                condition = clusters(_matrix(condition, "condition", True))
            evenly = np.linspace(0, len(varies) - 1, min(len(varies), COLUMNS))
            some = torch.from_numpy(evenly.astype(np.int64))
            part = moved[:, some.to(moved.device)].float()
            kept = _copied(part), varies.cpu()[some], _copied(condition)
            if self._kept and (form := _form(kept[2])) != (first := _form(self._kept[0][2])):
                raise ValueError(
                    f"condition must have one form in all batches, {first}; got {form}"
                )
            self._kept.append(kept)
            self._check()
        return paired

    def _varied(self) -> Tensor:
        """Which columns of the actions varied in some batch."""
        return torch.stack([varies for _, varies, _ in self._kept]).any(dim=0)

    def _check(self) -> None:
        """After enough batches and rows, warn once if the noise is skewed."""
        if len(self._kept) < (IN_A_WORKER if get_worker_info() else CHECK_AFTER):
            return
        rows, columns = sum(len(x0) for x0, *_ in self._kept), int(self._varied().sum())
        if rows < ROWS_FOR_EACH * max(columns, CELLS):
            return
        self._checked = True
        if not columns:
            return  # batches of one row, or of equal ones: nothing was chosen
        found = self.skew()
        _warn_if_constant([condition for *_, condition in self._kept])
        if found.flagged and found.explained > TOO_SKEWED:
            heeds = self.coupling.traits.needs_condition
            advice = "a larger condition_weight, or clusters" if heeds else "ConditionalOT()"
            warnings.warn(
                f"the condition explains {found.explained:.0%} of the variance of the noise that "
                f"{self.coupling!r} paired in {len(self._kept)} batches, so sampling will start "
                f"from other noise than training; take {advice}",
                RuntimeWarning,
                stacklevel=5,
            )


def _warn_if_constant(conditions: Sequence[Any], name: str = "the condition") -> None:
    """Warn if a condition, or a part of it, was the same in all rows of all batches."""
    if isinstance(conditions[0], Mapping):
        for part in conditions[0]:
            _warn_if_constant([c[part] for c in conditions], f"{part!r} of the condition")
        return
    whole = torch.cat(tuple(conditions))
    if (whole == whole[0]).all():
        warnings.warn(
            f"{name} was the same in all {len(whole)} rows, so that nothing is paired by it; "
            "clusters must be fitted to pictures that are scaled as those of the batches",
            RuntimeWarning,
            stacklevel=6,
        )


def _check_coupling(coupling: Coupling) -> Coupling:
    """Return a coupling; not its class, its name or a function."""
    wanted = "a coupling such as ConditionalOT()"
    found: Coupling = validation.check_has(coupling, "coupling", wanted, "match", "traits")
    return found


def as_pairing(pairing: Coupling | PairedNoise) -> PairedNoise:
    """`PairedNoise` of a coupling, or the one that is given."""
    return pairing if isinstance(pairing, PairedNoise) else PairedNoise(pairing)


def _untraced(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which a compiled step calls as it is: numba's loops cannot be traced."""
    return torch.compiler.disable(function) if torch.compiler.is_compiling() else function


def _paired(
    coupling: Coupling,
    actions: Tensor,
    condition: Condition,
    is_pad: Tensor | None,
    generator: Generator | None,
    noise: Tensor | None,
) -> tuple[Tensor, Tensor, Tensor]:
    """The noise like `actions`, and as a matrix; which of its columns were paired."""
    _check_coupling(coupling)
    x1 = _rows(actions, "actions")
    clustered = getattr(coupling, "condition", None) is not None
    _check_numbers(coupling, condition)
    c = None if condition is None else _matrix(condition, "condition", clustered)
    if isinstance(condition, Mapping):
        coupling = _as_combined(coupling)
    if is_pad is not None:
        wanted = tuple(actions.shape[:2])
        if not isinstance(is_pad, Tensor) or actions.ndim < 3 or is_pad.shape != wanted:
            got = validation.short(is_pad)
            raise ValueError(f"is_pad must be (B, T) for actions (B, T, D), got {got}")
        left_out = is_pad.bool()[:, :, None].expand(*wanted, x1.shape[1] // wanted[1]).flatten(1)
        if left_out.any():
            x1 = torch.where(left_out, _neutral(coupling, x1, left_out, c), x1)
    validation.check_matrix(x1, "actions")
    validation.check_generator(generator)
    if (worker := get_worker_info()) and generator and generator.initial_seed() != worker.seed:
        generator.manual_seed(worker.seed)  # this process has a copy of it
    if noise is None:
        device = generator.device if generator else x1.device
        x0 = torch.randn(x1.shape, dtype=x1.dtype, device=device, generator=generator)
    else:
        x0 = _rows(validation.check_shape(noise, "noise", tuple(actions.shape)), "noise")
    x0 = x0.to(x1)
    varies = (x1 != x1[0]).any(dim=0)
    if getattr(coupling, "inverse", None) is not None:
        varies = torch.ones_like(varies)  # a frame may mix the columns
    with torch.autocast(x1.device.type, enabled=False):
        pairs = coupling(x0 * varies, x1 * varies, c, generator=generator)
    _check_moved(coupling, pairs, x1 * varies, c)
    moved = torch.empty_like(x0)
    moved[pairs.target_index] = torch.where(varies, pairs.x0, x0[pairs.source_index])
    return moved.view(actions.shape).to(actions.dtype), moved, varies


def _as_combined(coupling: Coupling) -> Coupling:
    """The coupling, which takes the columns of `combine` as they are: they count equally."""
    if getattr(coupling, "condition_weight", None) != "scaled":
        return coupling
    own = copy.copy(coupling)
    own.condition_weight = "balanced"  # type: ignore[attr-defined]
    return own


def _check_numbers(coupling: Coupling, condition: Any) -> None:
    """Raise ValueError if numbers that a batch makes up would reach a function that knows others.

    A dictionary is standardised by its batch, and labels are numbered by those that are in it.
    """
    if isinstance(condition, Mapping):
        got = "a dictionary, which is standardised batch by batch"
    elif (
        isinstance(condition, Tensor) and condition.ndim == 1 and not condition.is_floating_point()
    ):
        got = "labels, which are numbered batch by batch"
    else:
        return
    for name in ("forward", "condition", "clusters"):
        own = getattr(coupling, name, None)
        if own is not None and not getattr(own, "own", False):
            raise ValueError(
                f"condition must be a tensor (B, k) as {name} of {coupling!r} takes it, got {got}"
            )


def _neutral(coupling: Coupling, x1: Tensor, left_out: Tensor, c: Tensor | None) -> Tensor:
    """What a padded step is taken for, so that pairing heeds it in no row: a mean, (d,) or (B, d).

    Taken for 0, the steps that are there would get noise on the side of their mean, and the padded
    ones the rest.
    """
    forward = getattr(coupling, "forward", None)
    if forward is None:
        there = (~left_out).sum(dim=0).clamp(min=1)
        return x1.masked_fill(left_out, 0.0).sum(dim=0) / there
    if c is None or not hasattr(forward, "mean"):
        raise ValueError(
            f"is_pad must mark no step for a coupling in a frame, where a step is not zero; got "
            f"{coupling!r}"
        )
    mean: Tensor = forward.mean(c).to(x1)
    return mean


def _rows(value: Any, name: str) -> Tensor:
    """Floating-point values (B, ...) as a matrix (B, d) in at least single precision."""
    if not isinstance(value, Tensor) or not value.is_floating_point() or value.ndim < 2:
        known = isinstance(value, Tensor)
        got = f"{tuple(value.shape)}, {value.dtype}" if known else validation.short(value)
        raise TypeError(f"{name} must be a floating-point tensor (B, ...), got {got}")
    value = value.detach().flatten(1)
    return value if value.dtype == torch.float64 else value.float()


def _matrix(value: Any, name: str, clustered: bool) -> Tensor:
    """A condition as a matrix (B, k); see `paired_noise`."""
    if isinstance(value, Mapping):
        return combine(
            {key: _matrix(part, f"{name}[{key!r}]", False) for key, part in value.items()}
        )
    if not isinstance(value, Tensor):
        got = validation.short(value)
        raise TypeError(f"{name} must be a tensor or a dictionary of tensors, got {got}")
    if value.is_complex():
        raise TypeError(f"{name} must hold real numbers, got {value.dtype}")
    value = value.detach()
    if value.ndim == 1 and not value.is_floating_point():  # labels: which rows have the same one
        classes = torch.unique(value, return_inverse=True)[1]
        return torch.nn.functional.one_hot(classes).float()
    if value.ndim > 3 and not clustered:
        raise ValueError(
            f"{name} has the shape of pictures, {tuple(value.shape)}: give clusters("
            "pictures.flatten(1)) of fitted EmbeddedClusters, or these as the coupling's condition"
        )
    value = value[:, None] if value.ndim == 1 else value.flatten(1)
    if not value.is_floating_point():
        value = validation.check_condition(value, name)  # refuses integers that would merge
    return value if value.dtype == torch.float64 else value.float()


def _form(value: Any) -> Any:
    """What the condition of every batch must share: names, and the shape of a row."""
    if isinstance(value, Mapping):
        return {name: _form(part) for name, part in value.items()}
    labels = value.ndim == 1 and not value.is_floating_point()
    return "labels (B,)" if labels else f"({', '.join(['B', *map(str, value.shape[1:])])})"


def _copied(value: Any) -> Any:
    """A tensor, or a dictionary of some, on the CPU; who called may change his own in place."""
    if isinstance(value, Mapping):
        return {name: _copied(part) for name, part in value.items()}
    return value.detach().to("cpu", copy=True)


def _together(conditions: Sequence[Any]) -> Tensor:
    """The conditions of many batches as one matrix; labels mean the same in each.

    If there are more labels than cells, neighbours count as one.
    """
    if isinstance(conditions[0], Mapping):
        names = conditions[0]
        return combine({name: _together([c[name] for c in conditions]) for name in names})
    whole = torch.cat(tuple(conditions))
    if whole.ndim == 1 and not whole.is_floating_point():
        labels, whole = torch.unique(whole, return_inverse=True)
        whole = whole * min(CELLS, len(labels)) // len(labels)
    return _matrix(whole, "condition", False)


def _check_moved(coupling: Coupling, pairs: Pairs, x1: Tensor, c: Tensor | None) -> None:
    """Raise ValueError unless the pairs use each row once, with its own data and condition."""
    target, every = pairs.target_index, torch.arange(len(x1), device=x1.device)
    once = all(torch.equal(rows.sort()[0], every) for rows in (target, pairs.source_index))
    own = torch.equal(pairs.x1, x1[target]) and (
        c is None or (pairs.c is not None and torch.equal(pairs.c, c[target]))
    )
    if not once or not own or pairs.weight is not None:
        what = "gives pairs other data, conditions or weights" if once else "draws rows repeatedly"
        raise ValueError(f"coupling must only move rows of noise, but {coupling!r} {what}")
