"""Diagnostics: how a coupling will affect a conditional flow, mostly before any training."""

from cotlearn.diagnostics.after_training import deployment_gap, error_budget
from cotlearn.diagnostics.frontier import Frontier, FrontierPoint, frontier
from cotlearn.diagnostics.recommendation import Recommendation, recommend
from cotlearn.diagnostics.skew import linear_skew, prior_skew
from cotlearn.diagnostics.spread import between_within

__all__ = [
    "Frontier",
    "FrontierPoint",
    "Recommendation",
    "between_within",
    "deployment_gap",
    "error_budget",
    "frontier",
    "linear_skew",
    "prior_skew",
    "recommend",
]
