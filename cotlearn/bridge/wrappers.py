"""Paired noise where torchcfm and flow_matching draw locations; neither is imported here."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from cotlearn.bridge.noise import Condition, PairedNoise, as_pairing
from cotlearn.couplings.base import Coupling


class PairedMatcher:
    """torchcfm's `ConditionalFlowMatcher` (or a variant that does not pair) with paired noise.

    Args:
        matcher: draws times and locations, as `ConditionalFlowMatcher(sigma=0.0)`.
        pairing: a coupling, or `PairedNoise` of one.

    Raises:
        ValueError: the matcher would pair the rows again.
    """

    def __init__(self, matcher: Any, pairing: Coupling | PairedNoise) -> None:
        if hasattr(matcher, "ot_sampler"):
            name = type(matcher).__name__
            raise ValueError(f"matcher pairs by itself: give ConditionalFlowMatcher, not {name}")
        self.matcher, self.pairing = matcher, as_pairing(pairing)

    def guided_sample_location_and_conditional_flow(
        self,
        x0: Tensor,
        x1: Tensor,
        y0: None = None,
        y1: Condition = None,
        t: Tensor | None = None,
        return_noise: bool = False,
    ) -> tuple[Any, ...]:
        """As torchcfm's method: (t, x_t, u_t, y0, y1), where y1 keeps its order; y0 must be None.

        Args:
            x0: (B, ...) noise.
            x1: (B, ...) data.
            y0: None.
            y1: the condition of x1, as in `paired_noise`.
            t: (B,) times, drawn if None.
            return_noise: return the matcher's noise as well, at the end.
        """
        if y0 is not None:
            raise ValueError("y0 must be None: noise has no label, and x1 keeps its own")
        x0 = self.pairing(x1, y1, noise=x0)
        flow = self.matcher.sample_location_and_conditional_flow(x0, x1, t, return_noise)
        return *flow[:3], y0, y1, *flow[3:]


class PairedPath:
    """A path of flow_matching, as `CondOTProbPath()`, with paired noise.

    Args:
        path: has `sample(x_0, x_1, t)`.
        pairing: a coupling, or `PairedNoise` of one.
    """

    def __init__(self, path: Any, pairing: Coupling | PairedNoise) -> None:
        self.path, self.pairing = path, as_pairing(pairing)

    def sample(self, x_0: Tensor, x_1: Tensor, t: Tensor, condition: Condition = None) -> Any:
        """The path's sample; x_0 is paired with x_1, and row i keeps x_1[i] and condition[i]."""
        return self.path.sample(x_0=self.pairing(x_1, condition, noise=x_0), x_1=x_1, t=t)
