"""Couplings: which noise meets which data when a flow is trained. One file per coupling."""

from cotlearn.couplings.adaptive import AdaptiveConditionalOT
from cotlearn.couplings.aligned import ModelAligned
from cotlearn.couplings.base import Coupling, Pairs, Sampler, Source
from cotlearn.couplings.centred import Centred
from cotlearn.couplings.conditional import ConditionalOT
from cotlearn.couplings.conditions import (
    KMeansCondition,
    PCAKMeansCondition,
    Viewed,
    combine,
    standardise,
)
from cotlearn.couplings.framed import Framed
from cotlearn.couplings.independent import Independent
from cotlearn.couplings.optimal import MinibatchOT
from cotlearn.couplings.reflow import Reflow
from cotlearn.couplings.semidiscrete import SemidiscreteOT
from cotlearn.couplings.stratified import StratifiedOT

__all__ = [
    "AdaptiveConditionalOT",
    "Centred",
    "ConditionalOT",
    "Coupling",
    "Framed",
    "Independent",
    "KMeansCondition",
    "MinibatchOT",
    "ModelAligned",
    "PCAKMeansCondition",
    "Pairs",
    "Reflow",
    "Sampler",
    "SemidiscreteOT",
    "Source",
    "StratifiedOT",
    "Viewed",
    "combine",
    "standardise",
]
