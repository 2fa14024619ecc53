"""Other ways to few evaluations: losses for `fit`, on the pairs of any coupling, and samplers."""

from cotlearn.flows.one_step.drifting import Drifting
from cotlearn.flows.one_step.learned_source import LearnedSource, learned_source_loss
from cotlearn.flows.one_step.mean_velocity import AlphaFlow, MeanFlow, MeanVelocity, Shortcut, jump
from cotlearn.flows.one_step.two_passes import TwoPasses

__all__ = [
    "AlphaFlow",
    "Drifting",
    "LearnedSource",
    "MeanFlow",
    "MeanVelocity",
    "Shortcut",
    "TwoPasses",
    "jump",
    "learned_source_loss",
]
