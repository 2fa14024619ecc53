"""A right call of every public function that takes arrays; `test_arrays.py` then spoils it.

One file for each part of the reference, and `reference.py`, which finds what the reference lists:
a function that takes arrays has a case here, or a reason in `WITHOUT`.
"""

from array_cases import couplings, data, flows, policies, potentials, robots  # noqa: F401
from array_cases.base import CASES
from array_cases.reference import WITHOUT, public, that_take_arrays

__all__ = ["CASES", "WITHOUT", "public", "that_take_arrays"]
