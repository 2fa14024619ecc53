"""cotlearn: flow matching with optimal-transport couplings under a condition."""

__version__ = "0.1.0"
