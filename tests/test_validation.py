import math

import numpy as np
import pytest
import torch

from cotlearn import validation
from cotlearn.validation import (
    check_array,
    check_choice,
    check_condition,
    check_count,
    check_function,
    check_generator,
    check_matrix,
    check_number,
    check_positive,
    check_same_rows,
    check_share,
    check_times,
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
    for bad in (True, 3.0, "3", None, torch.tensor(3), torch.ones(2), np.ones(2), np.bool_(True)):
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
        (np.eye(2) * 1j, TypeError, "A must hold real numbers, got complex128"),
        (np.eye(3), ValueError, r"A must have shape \(any, 2\), got \(3, 3\)"),
        (np.ones(2), ValueError, r"A must have shape \(any, 2\), got \(2,\)"),
        (np.ones((0, 2)), ValueError, r"A must have shape \(any, 2\), got \(0, 2\)"),
        ([[1, math.nan]], ValueError, "A has NaN or infinite values"),
        (np.ma.masked_equal([[1, -9999]], -9999), ValueError, "A has masked values: drop"),
        (torch.ones(1, 2, requires_grad=True), TypeError, r"A must be data, .* A.detach\(\)"),
        ([[1, 2], [3]], TypeError, r"A must hold real numbers, got \[\[1, 2\], \[3\]\]"),
    ],
)
def test_bad_arrays(value, error, message):
    assert check_array([[1, 2]], "A", (None, 2)).dtype == np.float64
    with pytest.raises(error, match=message):
        check_array(value, "A", (None, 2))


def test_choices():
    assert check_choice("a", "letter", ("a", "b")) == "a"
    for bad in ("c", None, 3, np.array(["a", "b"]), torch.ones(2)):
        with pytest.raises(ValueError, match="letter must be one of a, b; got"):
            check_choice(bad, "letter", ("a", "b"))


def test_a_share_lies_between_0_and_1():
    assert (check_share(0, "early"), check_share(1.0, "early")) == (0.0, 1.0)
    for wrong in (-0.1, 1.1, float("nan")):
        with pytest.raises(ValueError, match="early must"):
            check_share(wrong, "early")


def test_an_array_may_have_any_axes_in_front():
    for shape in ((3,), (4, 3), (0, 3), (2, 4, 3)):
        assert check_array(np.ones(shape), "pose", (..., 3)).shape == shape
    for shape in ((), (4,), (3, 4)):
        with pytest.raises(ValueError, match=r"pose must have shape \(\.\.\., 3\), got"):
            check_array(np.ones(shape), "pose", (..., 3))


WRONG_TIMES = [(t, TypeError) for t in (1j, torch.tensor(1j), "a")]


@pytest.mark.parametrize(("t", "error"), [*WRONG_TIMES, ([0.5, math.nan], ValueError)])
def test_times_are_real(t, error):
    with pytest.raises(error, match="t must"):
        check_times(t, torch.ones(2, 2))


def test_functions_and_generators():
    check_function(math.sin, "embed", "of c")
    with pytest.raises(TypeError, match="embed must be a function of c, got 5"):
        check_function(5, "embed", "of c")
    check_generator(None)
    check_generator(torch.Generator())
    for bad in (0, np.random.default_rng(0)):
        with pytest.raises(TypeError, match=r"generator must be a torch\.Generator or None, got"):
            check_generator(bad)


@pytest.mark.parametrize("dtype", [torch.int32, torch.int64])
def test_integers_that_floats_would_merge_are_refused(dtype):
    """Of 256 times in seconds 3 were left."""
    times = (1_700_000_000 + torch.arange(256, dtype=dtype))[:, None]
    with pytest.raises(ValueError, match=r"c has integers up to 17000\d+, .* merge some"):
        validation.check_condition(times)
    assert validation.check_condition(times - times[0]).unique().numel() == 256
    assert validation.check_condition(times.double()).unique().numel() == 256


def test_numbers_that_float32_would_merge_are_refused():
    minutes = 1.7e9 + 60 * np.arange(400.0)[:, None]
    with pytest.raises(ValueError, match=r"c has values .* column 1, .* would merge"):
        validation.check_single(np.hstack([minutes - 1.7e9, minutes]), "c")
    with pytest.raises(ValueError, match="x1 has values up to 1e"):
        validation.check_single(np.random.default_rng(0).normal(1e9, 1, size=(50, 1)), "x1")
    for kept in (minutes - minutes.mean(), np.full((9, 1), 1.7e9), np.full((9, 1), 0.1) * 3):
        assert len(np.unique(validation.check_single(kept, "c"))) == len(np.unique(kept))


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (torch.zeros(900, 2), r"Tensor of shape \(900, 2\)"),
        (np.zeros((900, 2)), r"ndarray of shape \(900, 2\)"),
        ({"c": torch.zeros(9, 1)}, r"{'c': Tensor of shape \(9, 1\)}"),
        (torch.tensor(3.5), r"tensor\(3\.5000\)"),
        (torch.nn.Sequential(*[torch.nn.ReLU()] * 40), r"Sequential\(.*\.\.\..*\)"),
        ([0.5] * 900, r"\[0\.5, .*, \.\.\.\]"),
        ("a" * 900, r"'a+\.\.\.a+'"),
    ],
)
def test_a_value_of_any_size_is_one_short_line(value, words):
    """Before, errors contained all of its numbers, over many lines."""
    with pytest.raises(TypeError, match=f"^n must be an integer, got {words}$") as caught:
        check_count(value, "n")
    assert len(str(caught.value)) < 160


def test_an_array_without_numbers_is_named_by_its_shape():
    for held, kind in (("a", "text"), (None, "objects")):
        with pytest.raises(TypeError, match=rf"got {kind} of shape \(400, 2\)$"):
            validation.check_real(np.array([[held, held]] * 400), "x1")
