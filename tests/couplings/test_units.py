"""Conditions in different units: no column of c may decide alone, and none without a word."""

import itertools
import math
import warnings

import numpy as np
import pytest
import torch
from support import refused, seeded

from cotlearn import couplings
from cotlearn.couplings import ConditionalOT, KMeansCondition, OwnUnits, StratifiedOT, combine
from cotlearn.couplings.base import Pairs
from cotlearn.couplings.units import TamedStandardiser, in_own_units
from cotlearn.datasets import Dataset, Standardiser
from cotlearn.diagnostics import prior_skew
from cotlearn.diagnostics.recommendation import candidates
from cotlearn.mixtures import petals

EXTRA = {
    "standard": lambda n, g: torch.randn(n, 1, generator=g),
    "a force": lambda n, g: 300 * torch.randn(n, 1, generator=g),
    "a time": lambda n, g: 1.76e9 + 1e5 * torch.rand(n, 1, generator=g),
    "a sentinel": lambda n, g: lost(torch.randn(n, 1, generator=g), 0.02, g),
    "many sentinels": lambda n, g: lost(torch.randn(n, 1, generator=g), 0.2, g),
    "a glitch": lambda n, g: torch.randn(n, 1, generator=g).index_fill(0, torch.tensor([3]), 1e10),
    "tiny": lambda n, g: 1e-9 * torch.randn(n, 1, generator=g),
}


def lost(values, share, g):
    return torch.where(torch.rand(values.shape, generator=g) < share, -9999.0, values)


def batches(extra, seed, n=256, count=8):
    g = seeded(seed)
    for _ in range(count):
        x1, label = petals().sample(n, generator=g)
        yield torch.randn(n, 2, generator=g), x1, torch.cat([label, extra(n, g)], dim=1)


def skew_by_label(coupling, extra, seed=0):
    pairs = [coupling(*batch, generator=seeded(1)) for batch in batches(extra, seed)]
    x0, c = (torch.cat([getattr(p, name) for p in pairs]) for name in ("x0", "c"))
    return prior_skew(x0, c[:, :4], generator=seeded()).statistic


@pytest.mark.parametrize("name", EXTRA)
def test_by_default_a_column_in_other_units_skews_no_label(name):
    """Naive OT has .5 here; a force, a time and a sentinel had .22, .28 and .49."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert max(skew_by_label(ConditionalOT(), EXTRA[name], seed) for seed in range(2)) < 0.08


@pytest.mark.parametrize("name", ["a force", "a time", "a sentinel"])
@pytest.mark.parametrize(
    "coupling", [ConditionalOT("balanced"), ConditionalOT(1.0)], ids=["balanced", "1"]
)
def test_a_weight_on_the_columns_as_they_are_says_that_one_decides(coupling, name):
    with pytest.warns(UserWarning, match="column 4 of c carries nearly all of the condition cost"):
        coupling(*next(batches(EXTRA[name], 0)), generator=seeded())


def test_other_couplings_with_a_weight_say_it_too():
    x0, x1, c = next(batches(EXTRA["a force"], 0, n=48))
    full = couplings.ModelAligned("full", condition_weight=1.0)
    full.observe(torch.nn.Identity(), 0)
    full._velocity = lambda t, x, c: torch.zeros_like(x)
    for coupling in (full, couplings.SemidiscreteOT(1.0, iterations=2)):
        with pytest.warns(UserWarning, match="column 4 of c carries nearly all"):
            coupling(x0, x1, c)


def test_of_one_hot_labels_nothing_changes():
    """Equal shares or not: the units of a column with two values are their difference."""
    g = seeded()
    for shares in ([1.0] * 4, [0.7, 0.25, 0.04, 0.01]):
        c = torch.eye(4)[torch.multinomial(torch.tensor(shares), 256, True, generator=g)]
        assert torch.equal(
            torch.cdist(OwnUnits.fit(c)(c), OwnUnits.fit(c)(c)), torch.cdist(*[c.double()] * 2)
        )
        x0, x1 = (torch.randn(256, 2, generator=g) for _ in range(2))
        own, published = (
            ConditionalOT(rule)(x0, x1, c, generator=seeded(2)) for rule in ("scaled", "balanced")
        )
        assert torch.equal(own.target_index, published.target_index)


def test_one_column_pairs_as_by_the_published_rule():
    g = seeded()
    x0, x1, c = (
        torch.randn(256, 2, generator=g),
        torch.randn(256, 2, generator=g),
        torch.rand(256, 1),
    )
    rules = [ConditionalOT(rule)(x0, x1, c, generator=seeded(1)) for rule in ("scaled", "balanced")]
    assert torch.equal(rules[0].target_index, rules[1].target_index)


def test_a_spread_is_robust_and_a_constant_column_stays_one():
    x = torch.randn(4000, 1, generator=seeded(), dtype=torch.float64)
    plain, spoilt = (float(OwnUnits.fit(lost(x, share, seeded(1))).spread) for share in (0, 0.02))
    assert plain == pytest.approx(math.sqrt(2) * math.exp(-(0.5772 + math.log(2)) / 2), rel=0.1)
    assert 1.2 < spoilt / plain < 1.7
    for value in (0.0, 0.1, 1 / 3, 1e30):
        c = torch.full((50, 1), value)
        assert (OwnUnits.fit(c)(c) == 0).all()
    jitter = torch.tensor([[0.3], [0.3 + 3e-8]]).repeat(20, 1)  # of rounding
    assert (OwnUnits.fit(jitter)(jitter) == 0).all()
    rare = torch.zeros(5000, 1).index_fill(0, torch.tensor([7]), 5.0)
    assert OwnUnits.fit(rare).spread.item() == 5


NARROW = {
    "a gripper in bfloat16": (torch.bfloat16, 0.95, 1.0),
    "labels in bfloat16": (torch.bfloat16, 20, 21),
    "labels in float16": (torch.float16, 1000, 1001),
    "large labels in float16": (torch.float16, 2046, 2047),
    "half a unit in a million": (torch.float32, 1e6, 1e6 + 0.5),
    "unix times": (torch.float32, 1_700_000_000, 1_700_000_000 + 1500),
}


@pytest.mark.parametrize(("dtype", "low", "high"), NARROW.values(), ids=NARROW)
def test_a_column_is_heeded_in_few_digits_too(dtype, low, high):
    up = torch.arange(512) % 2 == 1
    x0, x1 = torch.randn(2, 512, 2, generator=seeded())
    x1 = 0.3 * x1 + 3 * torch.where(up, 1.0, -1.0)[:, None]
    value = torch.where(up, torch.tensor(high), torch.tensor(low)).to(dtype)
    c = torch.stack([torch.randn(512, generator=seeded(1)).to(dtype), value], dim=1)
    pairs = ConditionalOT()(x0, x1, c, generator=seeded(2))
    above = pairs.c[:, 1] == value.max()
    assert 200 < above.sum() < 300
    assert abs(float(pairs.x0[above].mean() - pairs.x0[~above].mean())) < 0.3  # 1.4 if unheeded


def test_units_are_those_of_their_columns():
    units = OwnUnits.fit(torch.randn(50, 3, generator=seeded()))
    for k in (1, 2, 4):
        with pytest.raises(ValueError, match=f"c has {k} columns, expected 3"):
            units(torch.zeros(5, k))


def test_far_values_come_near_and_none_merge():
    c = torch.cat([torch.randn(300, 1, generator=seeded()), torch.tensor([[1e4], [1e6], [-1e6]])])
    units = OwnUnits.fit(c)
    assert torch.equal(units.tamed(c)[:300], c[:300])

    a, b, d = units(c)[300:, 0].tolist()
    assert 16 < a < b < 32
    assert -32 < d < -16


def test_clusters_do_not_spend_themselves_on_a_sentinel():
    """By standard deviations the other rows would differ by a thousandth, and share a cluster."""
    g = seeded()
    c = lost(torch.randn(2000, 1, generator=g), 0.02, g)
    fitted = KMeansCondition(8).fit(c)
    inside = c[:, 0] > -100
    assert len(fitted.labels(c)[inside].unique()) >= 5
    ordinary = c[inside]
    plain = KMeansCondition(8).fit(ordinary)
    assert set(plain.state_dict()) == {"mean", "std", "centroids", "limit", "scale"}
    assert torch.equal(plain.project(ordinary), Standardiser.fit(ordinary)(ordinary))
    again = KMeansCondition(8)
    again.load_state_dict(fitted.state_dict())
    assert torch.equal(again.labels(c), fitted.labels(c))


def test_strata_and_combined_conditions_keep_the_others_too():
    pairs, sensor = (
        [],
        combine({"c": lost(torch.randn(900, 1, generator=seeded()), 0.02, seeded(1))}),
    )
    assert sensor[sensor > -2].std() > 0.2  # by its deviation: .001
    for x0, x1, c in batches(EXTRA["a sentinel"], 0):
        pairs.append(StratifiedOT(8)(x0, x1, c, generator=seeded()))
    x0, c = (torch.cat([getattr(p, name) for p in pairs]) for name in ("x0", "c"))
    assert prior_skew(x0, c[:, :4], generator=seeded()).statistic < 0.1


def test_the_test_of_skew_sees_a_sensor_beside_its_sentinels():
    g = seeded()
    x0 = torch.randn(2000, 1, generator=g)
    c = lost(x0 + 0.1 * torch.randn(2000, 1, generator=g), 0.02, g)
    assert prior_skew(x0, c, generator=seeded()).statistic > 0.3


@pytest.mark.parametrize("name", ["a force", "a sentinel"])
def test_advice_measures_conditions_in_units_of_their_own(name):
    x1, label = petals().sample(600, generator=seeded())
    c = torch.cat([label, EXTRA[name](600, seeded(1))], dim=1)
    offered = candidates(x1, c)["COT x 10"]
    assert isinstance(offered.condition, OwnUnits)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        offered(torch.randn(600, 2, generator=seeded(2)), x1, c)
    plain = candidates(x1, torch.cat([label, EXTRA["standard"](600, seeded(1))], dim=1))
    assert plain["COT x 10"].condition is None  # as measured in the tables


test_it_refuses = refused(
    (lambda: ConditionalOT("robust"), ValueError, "one of scaled, balanced; got 'robust'"),
)


@pytest.mark.parametrize("name", EXTRA)
def test_a_network_sees_every_column(name):
    """What is near has a deviation of at least a tenth: beside a sentinel it had a 1,400th.

    With a fifth of the rows at -9999 it has 0.7 % of the column's deviation, before 0.02 %.
    """
    c = torch.cat([EXTRA[name](2000, seeded(seed)) for seed in range(2)], dim=1).double()
    scale = TamedStandardiser.fit(c)
    seen = scale(c)
    assert torch.allclose(seen.mean(dim=0), torch.zeros(2).to(seen), atol=1e-3)
    assert torch.allclose(seen.std(dim=0, unbiased=False), torch.ones(2).to(seen), atol=1e-3)
    for column, values in zip(seen.T, c.T, strict=True):
        near = (values - values.median()).abs() < 1e6
        near &= values != -9999
        assert column[near].std() > (0.005 if name == "many sentinels" else 0.1)
        assert len(column.unique()) == len(values.unique())  # none merge
    assert np.array_equal(scale(c.numpy()), seen.numpy())
    assert torch.equal(scale(c[:7]), seen[:7])


def test_without_far_values_it_is_a_standardiser():
    c = torch.cat([torch.randn(500, 2, generator=seeded(0)), torch.eye(5).repeat(100, 1)], dim=1)
    assert torch.equal(TamedStandardiser.fit(c)(c), Standardiser.fit(c)(c))


def test_one_glitch_does_not_make_the_others_equal():
    """In float32 the values beside 1e10 counted as one value, rounded."""
    c = EXTRA["a glitch"](2000, seeded(0))
    assert 0.5 < float(OwnUnits.fit(c).spread) < 1.5
    quarter = torch.arange(400)[:, None] % 4 * math.pi / 2
    turns = torch.cat([quarter.cos(), quarter.sin()], dim=1)  # 0, up to rounding, and 1 and -1
    assert torch.allclose(OwnUnits.fit(turns).spread, torch.tensor(1.15).double(), atol=0.1)


CODES = {  # the two that matter come first
    "a flag, a fifth missing at 99": ((0, 1, 99), (0.4, 0.4, 0.2)),
    "a flag, two fifths missing at 99": ((0, 1, 99), (0.3, 0.3, 0.4)),
    "a flag, most missing at -30": ((0, 1, -30), (0.15, 0.15, 0.7)),
    "1, 2, 20": ((1, 2, 20), (0.3, 0.3, 0.4)),
    "10, 20, 1000": ((10, 20, 1000), (0.4, 0.3, 0.3)),
}


@pytest.mark.parametrize("coupling", [ConditionalOT(), StratifiedOT(64)], ids=lambda k: k.name)
@pytest.mark.parametrize("name", CODES)
def test_codes_of_unlike_size_are_told_apart(name, coupling):
    """The code of a missing value made 0 and 1 equal, and the tests of skew saw nothing."""
    values, shares = CODES[name]
    kind = torch.multinomial(torch.tensor(shares), 4096, True, generator=seeded())
    x1 = 0.5 * torch.randn(4096, 2, generator=seeded(1))
    x1[:, 0] += torch.tensor([-1.0, 1.0, 0.0])[kind]
    data = Dataset(x1, torch.tensor(values).float()[kind][:, None])
    stream = coupling.stream(data, batch_size=256, generator=seeded())
    pairs = Pairs.cat([next(stream) for _ in range(16)])
    for value in values:
        some = pairs.x0[pairs.c[:, 0] == value, 0]
        assert abs(float(some.mean())) < 0.25  # 0.7 and more before


def test_numbers_of_which_half_are_missing_are_told_apart():
    known, missing = torch.randn(4096, generator=seeded()), torch.arange(4096) % 2 > 0
    c = torch.where(missing, -99.0, known)[:, None]
    x1 = torch.stack([torch.where(missing, 0.0, known), torch.zeros(4096)], dim=1)
    x1 += 0.3 * torch.randn(4096, 2, generator=seeded(1))
    stream = ConditionalOT().stream(Dataset(x1, c), batch_size=256, generator=seeded())
    pairs = Pairs.cat([next(stream) for _ in range(16)])
    some = pairs.c[:, 0] > -50
    both = torch.stack([pairs.x0[some, 0], pairs.c[some, 0]])
    assert abs(float(both.corrcoef()[0, 1])) < 0.15


def test_no_column_without_codes_is_ranked():
    draw = torch.randn(2000, 3, generator=seeded())
    far = draw + 20 * torch.randint(2, (2000, 3), generator=seeded(1))
    for c in (draw, draw.exp(), far, torch.randint(10, (2000, 3), generator=seeded()).float()):
        assert not len(OwnUnits.fit(c).ranked)


@pytest.mark.parametrize("kind", [torch.float32, torch.float64, torch.bfloat16])
def test_a_batch_is_brought_to_its_units_in_one_call(kind):
    """Faster than `OwnUnits.fit(c)(c)`, and the same."""
    c = torch.randn(200, 5, generator=seeded())
    c[:, 1], c[:4, 2], c[:, 3] = 7.0, -9999.0, (1000 * c[:, 3]).exp2().clamp(1e-9, 1e9)
    c[:, 4] = (c[:, 4] > 0).float()
    for some in (c, c[:, [0, 1, 4]]):
        found = in_own_units(some.to(kind))
        assert np.array_equal(found, OwnUnits.fit(some.to(kind))(some.to(kind)).numpy())


@pytest.mark.parametrize("rows", [8, 12, 16, 64, 128])
def test_few_rows_of_an_ordinary_column_are_no_codes(rows):
    """Every column of at most 64 rows has at most 64 values."""
    laws = (torch.Tensor.normal_, torch.Tensor.uniform_, torch.Tensor.exponential_)
    for law, seed in itertools.product(laws, range(40)):
        c = law(torch.empty(rows, 1), generator=seeded(seed))
        assert not len(OwnUnits.fit(c).ranked)


def test_knots_hold_numbers_whatever_the_default_device():
    c = (3 * torch.randn(512, 1, generator=seeded())).exp()
    with torch.device("meta"):
        units = OwnUnits.fit(c)
    assert torch.equal(units(c), OwnUnits.fit(c)(c))
