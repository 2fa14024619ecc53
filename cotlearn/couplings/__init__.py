"""Couplings: how noise is paired with data when a flow is trained. One file per coupling."""

from cotlearn.couplings.adaptive import AdaptiveConditionalOT
from cotlearn.couplings.aligned import ModelAligned
from cotlearn.couplings.base import Coupling, Pairs, Sampler, Source
from cotlearn.couplings.conditional import ConditionalOT
from cotlearn.couplings.conditions import (
    EmbeddedClusters,
    KMeansCondition,
    PCAKMeansCondition,
    combine,
)
from cotlearn.couplings.independent import Independent
from cotlearn.couplings.optimal import MinibatchOT
from cotlearn.couplings.reflow import FixedPairs, Reflow
from cotlearn.couplings.semidiscrete import SemidiscreteOT
from cotlearn.couplings.stratified import StratifiedOT
from cotlearn.couplings.stratified_batches import StratifiedBatches
from cotlearn.couplings.transformed import Transformed, centred
from cotlearn.couplings.units import OwnUnits

__all__ = [
    "AdaptiveConditionalOT",
    "ConditionalOT",
    "Coupling",
    "EmbeddedClusters",
    "FixedPairs",
    "Independent",
    "KMeansCondition",
    "MinibatchOT",
    "ModelAligned",
    "OwnUnits",
    "PCAKMeansCondition",
    "Pairs",
    "Reflow",
    "Sampler",
    "SemidiscreteOT",
    "Source",
    "StratifiedBatches",
    "StratifiedOT",
    "Transformed",
    "centred",
    "combine",
]
