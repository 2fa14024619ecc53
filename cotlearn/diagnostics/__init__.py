"""Diagnostics: what a coupling will do to a conditional flow, mostly before any training."""

from cotlearn.diagnostics.after_training import (
    DeploymentGap,
    ErrorBudget,
    deployment_gap,
    error_budget,
)
from cotlearn.diagnostics.frontier import Frontier, FrontierPoint, frontier
from cotlearn.diagnostics.recommendation import Recommendation, recommend
from cotlearn.diagnostics.skew import LinearSkew, PriorSkew, linear_skew, prior_skew
from cotlearn.diagnostics.spread import BetweenWithin, between_within

__all__ = [
    "BetweenWithin",
    "DeploymentGap",
    "ErrorBudget",
    "Frontier",
    "FrontierPoint",
    "LinearSkew",
    "PriorSkew",
    "Recommendation",
    "between_within",
    "deployment_gap",
    "error_budget",
    "frontier",
    "linear_skew",
    "prior_skew",
    "recommend",
]
