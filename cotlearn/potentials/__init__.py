"""Optimal vector fields: convex potentials whose gradient is the transport map."""

from cotlearn.potentials.action import ActionMLP, OptimalAction, action_matching_loss
from cotlearn.potentials.convex import ICNN, PICNN, ConvexPotential
from cotlearn.potentials.inversion import Inversion, InversionWarning, invert
from cotlearn.potentials.optimal_flow import (
    OptimalField,
    dual_loss,
    dual_objective,
    optimal_flow_matching_loss,
    optimal_flow_matching_loss_at,
    transport,
)
from cotlearn.potentials.truth import ConditionalGaussian, KnownMap, LogSumExp, eight_gaussians_map

__all__ = [
    "ICNN",
    "PICNN",
    "ActionMLP",
    "ConditionalGaussian",
    "ConvexPotential",
    "Inversion",
    "InversionWarning",
    "KnownMap",
    "LogSumExp",
    "OptimalAction",
    "OptimalField",
    "action_matching_loss",
    "dual_loss",
    "dual_objective",
    "eight_gaussians_map",
    "invert",
    "optimal_flow_matching_loss",
    "optimal_flow_matching_loss_at",
    "transport",
]
