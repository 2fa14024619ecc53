"""Couplings in other people's training loops: LeRobot, torchcfm, flow_matching.

There a row of a batch is an observation with its actions, and the rows stay where they are. So the
permutation goes to the noise: `paired_noise` draws noise and gives each row what the coupling pairs
with its actions. `PairedNoise` does so for many batches and watches whether its noise depends on
the condition. `pair_lerobot`, `PairedMatcher` and `PairedPath` put it where a package draws its
noise. None of these packages is imported here.
"""

from cotlearn.bridge.lerobot import Change, pair_lerobot
from cotlearn.bridge.noise import PairedNoise, paired_noise
from cotlearn.bridge.wrappers import PairedMatcher, PairedPath

__all__ = ["Change", "PairedMatcher", "PairedNoise", "PairedPath", "pair_lerobot", "paired_noise"]
