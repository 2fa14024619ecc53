"""Couplings: which noise meets which data when a flow is trained. One file per coupling."""

from cotlearn.couplings.base import Coupling, Pairs, Sampler, Source
from cotlearn.couplings.conditional import ConditionalOT
from cotlearn.couplings.independent import Independent
from cotlearn.couplings.optimal import MinibatchOT

__all__ = [
    "ConditionalOT",
    "Coupling",
    "Independent",
    "MinibatchOT",
    "Pairs",
    "Sampler",
    "Source",
]
