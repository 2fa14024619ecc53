"""Inversion: the root, its residual, and what it says when it is not found."""

import math
import re
import warnings

import pytest
import torch
from support import refused, seeded

from cotlearn.potentials import ICNN, PICNN, ConvexPotential, LogSumExp, inversion, transport
from cotlearn.potentials.inversion import EXPLICIT, InversionWarning, invert, solve, solve_curvature


def sharp(dim=2, seed=0):
    """A map that nearly jumps."""
    net = LogSumExp(dim, seed=seed).double()
    net.temperature, net.alpha = 0.05, 0.05
    return net


@pytest.fixture(params=["newton", "conjugate gradients"])
def method(request, monkeypatch):
    """Each of the two solvers of a step, in any dimension."""
    monkeypatch.setattr(inversion, "EXPLICIT", 10**6 if request.param == "newton" else 0)


class Broken(ConvexPotential):
    """A potential of any formula."""

    def __init__(self, formula):
        super().__init__(2)
        self.formula = formula

    def value(self, x, c):
        return self.formula(x)


@pytest.mark.parametrize("dim", [1, 2, 8])
def test_solves_the_equation(dim, method):
    net = sharp(dim)
    generator = seeded(1)
    y = 3 * torch.randn(50, dim, generator=generator).double()
    t = torch.rand(50, generator=generator).double()
    t[:2] = torch.tensor([0.0, 1.0])
    found = invert(net, y, t)
    assert found.converged.all()
    left = (1 - t[:, None]) * found.z + t[:, None] * net.gradient(found.z)
    assert torch.allclose(left, y, atol=1e-8)
    assert torch.allclose((left - y).norm(dim=1), found.residual, atol=1e-12)
    assert torch.equal(found.z[0], y[0]) or torch.allclose(found.z[0], y[0])


def test_inverse_of_transport():
    generator = seeded()
    x0, c = torch.randn(60, 3, generator=generator).double(), torch.rand(60, 2).double()
    net = PICNN(3, 2, seed=0).double()
    assert torch.allclose(invert(net, transport(net, x0, c), 1.0, c).z, x0, atol=1e-6)


def test_float32(method):
    net = ICNN(4, seed=0)
    y = 5 * torch.randn(100, 4, generator=seeded())
    found = invert(net, y)
    assert found.z.dtype == torch.float32
    assert found.converged.all()
    assert (found.z - invert(ICNN(4, seed=0).double(), y.double()).z).abs().max() < 1e-2


def test_many_dimensions_take_conjugate_gradients(monkeypatch):
    dim = EXPLICIT + 1
    net = ICNN(dim, width=8, seed=0)
    net.given = _no_hessian(net.given)
    y = torch.randn(5, dim)
    assert invert(net, y).converged.all()
    monkeypatch.setattr(inversion, "EXPLICIT", dim)
    with pytest.raises(AssertionError, match="no Hessian"):
        invert(net, y)


def _no_hessian(given):
    class Wrapped:
        def __init__(self, inner):
            self.value, self.gradient, self.inner = inner.value, inner.gradient, inner

        def hessian(self, x):
            raise AssertionError("no Hessian")

        def rows(self, index):
            return Wrapped(self.inner.rows(index))

    return lambda c: Wrapped(given(c))


def test_both_solvers_find_the_same_step(monkeypatch):
    net = sharp(6)
    z, right = torch.randn(2, 20, 6).double()
    t = torch.linspace(0, 1, 20).double()
    given = net.given(None)
    first = solve_curvature(given, z, right, t)
    monkeypatch.setattr(inversion, "EXPLICIT", 0)
    second = solve_curvature(given, z, right, t, accuracy=1e-12)
    assert torch.allclose(first, second, rtol=1e-6, atol=1e-8)


def test_a_start_at_the_answer_needs_one_evaluation():
    net, z = sharp(), torch.randn(20, 2).double()
    y, one = net.gradient(z).detach(), torch.ones(20).double()
    assert solve(net.given(None), y, one, start=z).evaluations == 1


def test_nothing_flows_back():
    net, y = ICNN(2, seed=0), torch.randn(5, 2, requires_grad=True)
    assert not invert(net, y.detach() * 1.0).z.requires_grad
    assert not invert(net, y).z.requires_grad


def test_the_same_call_gives_the_same_numbers():
    net, y = ICNN(2, seed=0), torch.randn(30, 2)
    assert torch.equal(invert(net, y, 0.5).z, invert(net, y, 0.5).z)


def test_rows_do_not_depend_on_each_other():
    net, y = sharp(), torch.randn(10, 2).double()
    together = invert(net, y).z
    alone = torch.cat([invert(net, y[i : i + 1]).z for i in range(10)])
    assert torch.allclose(together, alone, atol=1e-6)


def test_warns_when_it_did_not_converge(monkeypatch):
    monkeypatch.setattr(inversion, "MOST", 4)
    net, y = sharp(), 5 * torch.randn(40, 2, generator=seeded()).double()
    with pytest.warns(InversionWarning) as caught:
        found = invert(net, y)
    failed = ~found.converged
    assert 0 < failed.sum() <= 40
    text = str(caught[0].message)
    assert re.match(rf"{int(failed.sum())} of 40 rows did not converge in 4 evaluations", text)
    assert f"largest residual {float(found.residual.max()):.2g}" in text
    assert "use float64" in text
    assert caught[0].filename == __file__


def test_silent_when_it_did():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        invert(sharp(), torch.randn(40, 2).double())


def test_no_root_is_a_warning_not_a_loop():
    bounded = Broken(lambda x: torch.nn.functional.softplus(x).sum(dim=1))  # gradient below 1
    with pytest.warns(InversionWarning, match="1 of 2 rows"):
        found = invert(bounded, torch.tensor([[0.5, 0.5], [2.0, 2.0]]))
    assert found.converged.tolist() == [True, False]


def test_potentials_that_are_not_finite():
    y = torch.ones(3, 2)
    with pytest.raises(RuntimeError, match="gradient is not finite in 3 of 3 rows: its parameters"):
        invert(Broken(lambda x: x.sum(dim=1).sqrt()), y)
    net = ICNN(2)
    with torch.no_grad():
        net.b.fill_(math.inf)
    with pytest.raises(RuntimeError, match="gradient is not finite"):
        invert(net, y)
    kink = Broken(lambda x: x.abs().pow(1.5).sum(dim=1))
    with pytest.raises(RuntimeError, match="Hessian is not finite"):
        invert(kink, y)


test_bad_options = refused(
    ({"t": -0.1}, r"t must lie in \[0, 1\]"),
    ({"t": 1.1}, r"t must lie in \[0, 1\]"),
    ({"t": math.nan}, r"t must lie in \[0, 1\]"),
    ({"t": torch.zeros(3)}, r"t must be a number or have shape \(4,\), got \(3,\)"),
    ({"c": torch.zeros(4, 1)}, "condition_dim=0, but got c"),
    ({"y": torch.zeros(4, 3)}, "y has 3 columns, expected 2"),
    error=ValueError,
    of=lambda **options: invert(ICNN(2), **({"y": torch.zeros(4, 2)} | options)),
)
