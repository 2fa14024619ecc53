"""The closed-form regression: it finds polynomials, and takes off what skew looks for."""

import pytest
import torch

from cotlearn.couplings import Centred, MinibatchOT, PolynomialMean
from cotlearn.diagnostics import linear_skew


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def conditions(n=3000, seed=0):
    return 2 + 3 * torch.rand(n, 2, generator=seeded(seed))


def curved(c):
    return torch.stack([1 + c[:, 0] * c[:, 1], c[:, 0] ** 2 - c[:, 1], 4 - c[:, 1]], dim=1)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_it_finds_a_quadratic(dtype):
    c = conditions().to(dtype)
    mean = PolynomialMean().fit(curved(c) + 0.1 * torch.randn(3000, 3, generator=seeded(1)), c)
    new = conditions(seed=2).to(dtype)
    found = mean(new)
    assert found.dtype == dtype
    assert (found - curved(new)).abs().max() < 0.05


def test_a_line_cannot_bend():
    c = conditions()
    line, bent = (PolynomialMean(degree).fit(curved(c), c) for degree in (1, 2))
    left = [float((curved(c) - mean(c)).square().mean()) for mean in (line, bent)]
    assert left[0] > 0.1
    assert left[1] < 1e-4


@pytest.mark.parametrize("degree", [1, 2])
def test_naive_ot_about_it_passes_the_test_of_its_degree(degree):
    c = conditions(4000)
    x1 = curved(c) + torch.randn(4000, 3, generator=seeded(3))
    x0 = torch.randn(4000, 3, generator=seeded(4))

    def skew(coupling):
        pairs = coupling(x0, x1, c, seeded(5))
        return linear_skew(pairs.x0, pairs.c, degree=degree)

    assert skew(MinibatchOT()).explained > 0.2
    assert abs(skew(Centred(MinibatchOT(), PolynomialMean(degree).fit(x1, c))).explained) < 0.01


def test_one_hot_and_constant_columns():
    """Columns that foretell one another: any weights do, the mean is that of each class."""
    label = torch.randint(0, 3, (600,), generator=seeded())
    c = torch.cat([torch.nn.functional.one_hot(label, 3), torch.ones(600, 1)], dim=1)
    x1 = torch.randn(600, 2, generator=seeded(1)) + 5.0 * label[:, None]
    found = PolynomialMean().fit(x1, c)(c)
    for k in range(3):
        assert torch.allclose(found[label == k][0], x1[label == k].mean(dim=0), atol=0.1)


def test_of_a_constant_condition_it_is_the_mean():
    x1 = torch.randn(50, 2, generator=seeded())
    found = PolynomialMean().fit(x1, torch.full((50, 1), 7.0))(torch.full((4, 1), 7.0))
    assert torch.allclose(found, x1.mean(dim=0).expand(4, 2), atol=1e-6)


X, C = torch.randn(40, 2), torch.randn(40, 3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: PolynomialMean(3), "degree must be 1 or 2, got 3"),
        (lambda: PolynomialMean()(C), "must be fitted before"),
        (lambda: PolynomialMean().fit(X, C), "at least 50 rows for the 10 features .* got 40"),
        (lambda: PolynomialMean(1).fit(X, C[:9]), "c has 9 rows, x1 has 40"),
        (lambda: PolynomialMean(1).fit(X / 0, C), "x1"),
        (lambda: PolynomialMean(1).fit(X, C)(C[:, :2]), "c must have 3 columns, got 2"),
        (lambda: PolynomialMean(1).fit(X, C[:, 0]), "c must have shape"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()
