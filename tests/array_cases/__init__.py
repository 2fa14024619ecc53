"""A right call of the doors that take arrays; `test_arrays.py` then spoils it."""

from array_cases import couplings, data, flows, policies, potentials, robots  # noqa: F401
from array_cases.base import CASES

__all__ = ["CASES"]
