"""The comparison of policies: one file for each (method, seed), and a summary of all of them."""

from cotlearn.robots.benchmark.cells import bench, measure_latency
from cotlearn.robots.benchmark.choice import choose, with_choice
from cotlearn.robots.benchmark.protocol import Protocol
from cotlearn.robots.benchmark.scores import evaluate, held_out_score, mode_draws, samplers
from cotlearn.robots.benchmark.summary import summarise

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
