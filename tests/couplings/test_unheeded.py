"""A column of c beside others must not lose its say, or a warning names it."""

import warnings

import pytest
import torch
from support import seeded

from cotlearn.couplings import (
    ConditionalOT,
    KMeansCondition,
    OwnUnits,
    SemidiscreteOT,
    StratifiedOT,
)
from cotlearn.couplings.unheeded import ruling_column
from cotlearn.diagnostics.recommendation import candidates


def signals(n, g, jitter):
    """Three binary signals."""
    return torch.randint(2, (n, 3), generator=g) + jitter * torch.randn(n, 3, generator=g).double()


def sentinels(n, g, share):
    """Three sensors with missing values."""
    s = torch.randn(n, 3, generator=g).double()
    return torch.where(torch.rand(n, 3, generator=g) < share, -9999.0, s)


BESIDE = {
    "jitter .01": lambda n, g: signals(n, g, 1e-2),
    "jitter .001": lambda n, g: signals(n, g, 1e-3),
    "jitter 1e-9": lambda n, g: signals(n, g, 1e-9),
    "5 % sentinels": lambda n, g: sentinels(n, g, 0.05),
    "20 % sentinels": lambda n, g: sentinels(n, g, 0.2),
    "60 % sentinels": lambda n, g: sentinels(n, g, 0.6),
    "log-normal": lambda n, g: (5 * torch.randn(n, 3, generator=g)).exp(),
    "powers of ten": lambda n, g: 10.0 ** torch.randint(-8, 8, (n, 3), generator=g),
    "normal": lambda n, g: torch.randn(n, 16, generator=g),
}


def copies(n, g, count=64):
    """One sensor, many times."""
    return torch.randn(n, 1, generator=g).expand(n, count)


def gap(coupling, beside, batches=8, n=256):
    """The distance of the mean noise of two labels, which are 3 apart in x1."""
    g, x0, label = seeded(), [], []
    for _ in range(batches):
        own = torch.eye(2)[torch.randint(2, (n,), generator=g)]
        x1 = 0.3 * torch.randn(n, 2, generator=g)
        x1[:, 0] += 3 * own[:, 0] - 1.5
        c = torch.cat([own, beside(n, g)], dim=1)
        pairs = coupling(torch.randn(n, 2, generator=g), x1, c, generator=g)
        x0.append(pairs.x0[:, 0])
        label.append(pairs.c[:, 0] == 1)
    noise, first = torch.cat(x0), torch.cat(label)
    return abs(float(noise[first].mean() - noise[~first].mean()))


@pytest.mark.parametrize("name", BESIDE)
def test_by_default_columns_of_several_scales_skew_no_label(name):
    """Naive OT has 1.57 here; the geometric mean alone had up to 1.48."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert gap(ConditionalOT(), BESIDE[name]) < 0.15


@pytest.mark.parametrize(
    ("coupling", "beside"),
    [
        (ConditionalOT(), copies),
        (ConditionalOT("balanced"), BESIDE["20 % sentinels"]),
        (ConditionalOT("balanced"), BESIDE["powers of ten"]),
    ],
)
def test_a_label_that_the_others_outweigh_is_named(coupling, beside):
    with pytest.warns(UserWarning, match="column [01] of c is hardly heeded"):
        assert gap(coupling, beside, batches=1) > 0.4


def test_a_sensor_with_many_sentinels_is_heeded_itself():
    """By the geometric mean, values other than the sentinel hardly differ."""
    g, n = seeded(), 512
    c = sentinels(n, g, 0.6)[:, :1].float()
    right, measured = c[:, 0] > 0, c[:, 0] > -100
    x1 = 0.3 * torch.randn(n, 1, generator=g) + 3 * right[:, None]
    pairs = ConditionalOT()(torch.randn(n, 1, generator=g), x1, c, generator=g)
    x0, right = pairs.x0[:, 0], pairs.c[:, 0] > 0
    measured = pairs.c[:, 0] > -100
    assert abs(float(x0[right].mean() - x0[measured & ~right].mean())) < 0.3  # naive OT: 1.9


def test_of_several_scales_the_middle_ranks_count():
    """Of 4 rows in 10 that are alike, 1 of 10,000 and 5 of 10,001 to 10,005."""
    c = torch.tensor([[0.0]] * 400 + [[1e8]] * 100 + [[1e8 + 8 * k] for k in range(1, 501)])
    units = OwnUnits.fit(c)
    assert units.ranked.tolist() == [0]
    found = units(c)[:, 0]
    assert found[:400].unique().item() == pytest.approx(0.4)
    assert found[400:500].unique().item() == pytest.approx(0.9)
    assert torch.allclose(found[500:], 1.001 + 0.002 * torch.arange(500).double())
    assert torch.equal(units.tamed(c)[:, 0], found.float())
    assert units(torch.tensor([[-7.0], [3e9]])).tolist() == [[0.0], [2.0]]


def test_a_glitch_hides_no_differences():
    """Beside 1e10 in float32, values counted as equal up to 10,000: a sensor as constant."""
    c = torch.randn(300, 1, generator=seeded())
    spoilt = c.index_fill(0, torch.tensor([3]), 1e10)
    assert float(OwnUnits.fit(spoilt).spread) < 2 * float(OwnUnits.fit(c).spread)


def test_many_rows_keep_ranks_at_few_knots():
    g = seeded()
    c = (9 * torch.randn(20_000, 1, generator=g)).exp()
    units = OwnUnits.fit(c)
    assert units.knots.shape == (1, 4096)
    place = 2 * c[:, 0].argsort().argsort() / len(c)
    assert (units(c)[:, 0] - place).abs().max() < 2e-3


CLUSTERED = {
    "strata": lambda x, c: StratifiedOT(4)(x, x, c),
    "whole data": lambda x, c: SemidiscreteOT(clusters=4, iterations=1).fit(x, c),
    "one's own": lambda x, c: KMeansCondition(4).fit(c),
}


@pytest.mark.filterwarnings("ignore:StratifiedOT was called", "ignore:the potential")
@pytest.mark.parametrize("name", CLUSTERED)
def test_clusters_say_which_column_they_do_not_tell_apart(name):
    g = seeded()
    label = torch.eye(2)[torch.randint(2, (256,), generator=g)]
    c = torch.cat([label, copies(256, g)], dim=1)
    with pytest.warns(UserWarning, match="column [01] of c is not told apart by the clusters"):
        CLUSTERED[name](torch.randn(256, 2, generator=g), c)


def test_strata_that_tell_all_columns_apart_say_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message="StratifiedOT was called")
        for beside in (BESIDE["20 % sentinels"], BESIDE["jitter .001"], BESIDE["normal"]):
            gap(StratifiedOT(8), beside, batches=2)


@pytest.mark.parametrize("scale", [1e2, 1e6, 1e8, 1e9, 1e30, 1e200])
def test_a_column_rules_however_much_it_does(scale):
    """From 1e9 on the others' variance is lost in the rounding of the total."""
    g = seeded()
    label = torch.eye(2, dtype=torch.float64)[torch.randint(2, (256,), generator=g)]
    c = torch.cat([label, scale * torch.rand(256, 1, generator=g, dtype=torch.float64)], dim=1)
    assert ruling_column(c) == 2
    assert candidates(torch.randn(256, 2, generator=g), c)["COT x 10"].condition is not None
    assert ruling_column(label) is None
    assert ruling_column(c[:, 2:]) is None
