"""Other ways to few evaluations: losses for `fit`, on the pairs of any coupling, and samplers."""

from cotlearn.flows.one_step.drifting import Drifting
from cotlearn.flows.one_step.mean_velocity import MeanFlow, MeanVelocity, Shortcut, jump
from cotlearn.flows.one_step.two_passes import TwoPasses

__all__ = [
    "Drifting",
    "MeanFlow",
    "MeanVelocity",
    "Shortcut",
    "TwoPasses",
    "jump",
]
