"""Flows: learn a velocity field from pairs, and integrate it."""

from cotlearn.flows.guidance import Guided, LabelDropout
from cotlearn.flows.matching import (
    FlowMatching,
    conditional_flow_matching_loss,
    flow_matching_step,
    interpolate,
    velocity_of,
)
from cotlearn.flows.networks import VelocityMLP
from cotlearn.flows.solvers import Solution, integrate, sampler
from cotlearn.flows.training import FitResult, fit

__all__ = [
    "FitResult",
    "FlowMatching",
    "Guided",
    "LabelDropout",
    "Solution",
    "VelocityMLP",
    "conditional_flow_matching_loss",
    "fit",
    "flow_matching_step",
    "integrate",
    "interpolate",
    "sampler",
    "velocity_of",
]
