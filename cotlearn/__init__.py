"""cotlearn: flow matching with couplings that know the condition."""

from cotlearn import renamed as renamed  # old names of modules keep working

__version__ = "0.1.0"
