"""The comparison of policies: one file for each (method, seed), and a summary of all of them."""

from cotlearn.renamed import renamed

__getattr__ = renamed(
    __name__, {"held_out_score": "cotlearn.policies.comparison.scores:held_out_score"}
)
