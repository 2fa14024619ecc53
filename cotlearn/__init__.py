"""cotlearn: flow matching with optimal-transport couplings under a condition."""

from cotlearn import renamed as renamed  # old names of modules keep working

__version__ = "0.1.0"
