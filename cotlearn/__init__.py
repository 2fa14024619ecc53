"""cotlearn: flow matching with couplings that know the condition."""

__version__ = "0.1.0"
