import math

import numpy as np
import pytest
import torch

from cotlearn.validation import (
    check_array,
    check_choice,
    check_condition,
    check_count,
    check_matrix,
    check_number,
    check_positive,
    check_same_rows,
    check_share,
)


def test_a_good_matrix_is_returned_as_it_is():
    for dtype in (torch.float16, torch.float32, torch.float64):
        value = torch.zeros(3, 2, dtype=dtype)
        assert check_matrix(value, "x0", columns=2) is value


@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        ([[1.0]], TypeError, "x0 must be a torch tensor, got list"),
        (np.zeros((2, 2)), TypeError, "x0 must be a torch tensor, got ndarray"),
        (None, TypeError, "x0 must be a torch tensor, got NoneType"),
        (torch.zeros(2, 2, dtype=torch.int64), TypeError, "x0 must be .* got torch.int64"),
        (torch.zeros(2, 2, dtype=torch.complex64), TypeError, "x0 must be .* got torch.complex64"),
        (torch.zeros(3), ValueError, r"x0 must have shape .* got \(3,\)"),
        (torch.zeros(3, 2, 1), ValueError, r"x0 must have shape .* got \(3, 2, 1\)"),
        (torch.zeros(0, 2), ValueError, "x0 is empty"),
        (torch.zeros(3, 4), ValueError, "x0 has 4 columns, expected 2"),
        (torch.tensor([[0.0, math.nan], [1.0, 1.0]]), ValueError, "x0 has NaN .* 1 of 2 rows"),
        (torch.tensor([[math.inf, -math.inf]]), ValueError, "x0 has NaN .* 1 of 1 rows"),
    ],
)
def test_bad_matrices(value, error, message):
    with pytest.raises(error, match=message):
        check_matrix(value, "x0", columns=2)


def test_large_finite_values_whose_sum_is_infinite_are_fine():
    assert check_matrix(large := torch.full((3, 2), 3e38), "x0") is large
    assert check_matrix(half := torch.full((3, 2), 6e4, dtype=torch.float16), "x0") is half


def test_integer_and_bool_conditions_are_numbers():
    one_hot = torch.eye(3, dtype=torch.int64)
    assert torch.equal(check_condition(one_hot), torch.eye(3))
    assert torch.equal(check_condition(one_hot.bool()), torch.eye(3))


def test_a_vector_of_labels_is_refused_with_advice():
    with pytest.raises(ValueError, match=r"c must have shape .* got \(4,\).*one_hot"):
        check_condition(torch.tensor([0, 1, 2, 3]))
    with pytest.raises(TypeError, match="goal must be a torch tensor"):
        check_condition([[1.0]], "goal")


def test_rows_must_agree():
    check_same_rows(torch.zeros(3, 1), "x1", torch.zeros(3, 2), "x0")
    with pytest.raises(ValueError, match="x1 has 3 rows, x0 has 4"):
        check_same_rows(torch.zeros(3, 1), "x1", torch.zeros(4, 1), "x0")


def test_counts():
    assert check_count(np.int64(3), "n") == 3
    assert check_count(torch.tensor(3), "n") == 3
    for bad in (True, 3.0, "3", None):
        with pytest.raises(TypeError, match="n must be an integer"):
            check_count(bad, "n")
    for bad in (0, -1):
        with pytest.raises(ValueError, match=f"n must be at least 1, got {bad}"):
            check_count(bad, "n")


def test_numbers():
    assert check_number(np.float32(0.5), "w") == 0.5
    assert check_number(torch.tensor(2), "w") == 2.0
    assert check_number(math.inf, "w", infinite=True) == math.inf
    for bad in (True, "1", None, torch.zeros(2), np.zeros(2), 1j):
        with pytest.raises(TypeError, match="w must be a number"):
            check_number(bad, "w")
    for bad in (-1, math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match="w must be at least 0 and finite"):
            check_number(bad, "w")
    with pytest.raises(ValueError, match="infinity is allowed"):
        check_number(math.nan, "w", infinite=True)


def test_positive_numbers():
    assert check_positive(np.float32(0.5), "w") == 0.5
    for bad, message in ((0, "w must be above 0, got 0"), (-1, "w must be at least 0")):
        with pytest.raises(ValueError, match=message):
            check_positive(bad, "w")


@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        ([["a"]], TypeError, "A must hold real numbers, got .*a"),
        (np.eye(2) * 1j, TypeError, "A must hold real numbers, got array.*j"),
        (np.eye(3), ValueError, r"A must have shape \(any, 2\), got \(3, 3\)"),
        (np.ones(2), ValueError, r"A must have shape \(any, 2\), got \(2,\)"),
        (np.ones((0, 2)), ValueError, r"A must have shape \(any, 2\), got \(0, 2\)"),
        ([[1, math.nan]], ValueError, "A has NaN or infinite values"),
    ],
)
def test_bad_arrays(value, error, message):
    assert check_array([[1, 2]], "A", (None, 2)).dtype == np.float64
    with pytest.raises(error, match=message):
        check_array(value, "A", (None, 2))


def test_choices():
    assert check_choice("a", "letter", ("a", "b")) == "a"
    for bad in ("c", None, 3):
        with pytest.raises(ValueError, match="letter must be one of a, b; got"):
            check_choice(bad, "letter", ("a", "b"))


def test_a_share_lies_between_0_and_1():
    assert (check_share(0, "early"), check_share(1.0, "early")) == (0.0, 1.0)
    for wrong in (-0.1, 1.1, float("nan")):
        with pytest.raises(ValueError, match="early must"):
            check_share(wrong, "early")
