import numpy as np
import pytest
import torch

from cotlearn.course.claims import claim, count_claims


def test_a_claim_that_holds_is_printed(capsys):
    claim("one is below two", 1 < 2)
    claim("over two\nlines", np.bool_(True))
    claim("a tensor", torch.tensor([True]))
    printed = capsys.readouterr().out
    expected = ["✓ claim: one is below two", "✓ claim: over two lines", "✓ claim: a tensor"]
    assert printed.splitlines() == expected
    assert count_claims("before\n" + printed) == 3


def test_a_claim_that_does_not_hold_stops(capsys):
    with pytest.raises(AssertionError, match="claim does not hold: one is above two"):
        claim("one is above two", 1 > 2)
    assert capsys.readouterr().out == ""


def test_a_comparison_with_nan_does_not_hold():
    with pytest.raises(AssertionError):
        claim("error is small", float("nan") < 1)


def test_bad_input():
    with pytest.raises(TypeError, match="sentence must be a string"):
        claim(True, "swapped")
    with pytest.raises(ValueError, match="sentence is empty"):
        claim("  ", True)
    for many in (np.array([True, False]), torch.tensor([True, False])):
        with pytest.raises(ValueError, match="one truth value"):
            claim("many", many)
