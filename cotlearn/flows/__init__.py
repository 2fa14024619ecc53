"""Flows: learn a velocity field from pairs, and integrate it."""

from cotlearn.flows.guidance import Guided, LabelDropout
from cotlearn.flows.matching import (
    EarlyFlowMatching,
    conditional_flow_matching_loss,
    interpolate,
)
from cotlearn.flows.networks import VelocityMLP
from cotlearn.flows.solvers import Solution, integrate, sampler
from cotlearn.flows.training import FitResult, fit

__all__ = [
    "EarlyFlowMatching",
    "FitResult",
    "Guided",
    "LabelDropout",
    "Solution",
    "VelocityMLP",
    "conditional_flow_matching_loss",
    "fit",
    "integrate",
    "interpolate",
    "sampler",
]
