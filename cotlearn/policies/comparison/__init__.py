"""The comparison of policies: one file for each (method, seed), and a summary of all of them."""

from cotlearn.policies.comparison.cells import Protocol, bench, measure_latency
from cotlearn.policies.comparison.choice import choose, seen_by, with_choice
from cotlearn.policies.comparison.scores import evaluate, held_out_score, mode_draws
from cotlearn.policies.comparison.summary import summarise

__all__ = [
    "Protocol",
    "bench",
    "choose",
    "evaluate",
    "held_out_score",
    "measure_latency",
    "mode_draws",
    "seen_by",
    "summarise",
    "with_choice",
]
