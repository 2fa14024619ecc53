"""Flows: learn a velocity field from pairs, and integrate it."""

from cotlearn.flows.guidance import Guided, LabelDropout
from cotlearn.flows.matching import (
    OversampleT0,
    conditional_flow_matching_loss,
    flow_matching_step,
    interpolate,
)
from cotlearn.flows.networks import VelocityMLP
from cotlearn.flows.solvers import Solution, integrate, sampler
from cotlearn.flows.training import FitResult, fit
from cotlearn.renamed import renamed

__all__ = [
    "FitResult",
    "Guided",
    "LabelDropout",
    "OversampleT0",
    "Solution",
    "VelocityMLP",
    "conditional_flow_matching_loss",
    "fit",
    "flow_matching_step",
    "integrate",
    "interpolate",
    "sampler",
]
__getattr__ = renamed(__name__, {"EarlyFlowMatching": "OversampleT0"})
