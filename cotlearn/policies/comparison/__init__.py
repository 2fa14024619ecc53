"""The comparison of policies: one file for each (method, seed), and a summary of all of them."""

from cotlearn.policies.comparison.cells import bench, measure_latency
from cotlearn.policies.comparison.choice import choose, with_choice
from cotlearn.policies.comparison.protocol import Protocol
from cotlearn.policies.comparison.scores import evaluate, held_out_score, mode_draws, samplers
from cotlearn.policies.comparison.summary import summarise

__all__ = [
    "Protocol",
    "bench",
    "choose",
    "evaluate",
    "held_out_score",
    "measure_latency",
    "mode_draws",
    "samplers",
    "summarise",
    "with_choice",
]
