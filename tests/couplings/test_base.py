"""What every coupling keeps to, and the stream of training batches."""

import itertools
import math
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from support import joined, refused, same, seeded, take
from torch.utils.data import DataLoader, IterableDataset

from cotlearn import couplings
from cotlearn.couplings import (
    ConditionalOT,
    Coupling,
    FixedPairs,
    Independent,
    MinibatchOT,
    StratifiedBatches,
    StratifiedOT,
    Transformed,
    base,
)
from cotlearn.couplings.base import Batches, Match, Pairs, draw_noise
from cotlearn.couplings.distances import mean_distance, squared_distances, to_numpy
from cotlearn.datasets import Dataset, unconditional
from cotlearn.flows import VelocityMLP, fit
from cotlearn.mixtures import petals
from cotlearn.randomness import generator_for


def zero_network(coupling):
    coupling.observe(torch.nn.Identity(), 10**6)
    coupling._velocity = lambda t, x, c: torch.zeros_like(x)
    return coupling


COUPLINGS = [
    Independent(),
    MinibatchOT(),
    MinibatchOT(plan="sinkhorn"),
    ConditionalOT(0.0),
    ConditionalOT(10.0),
    ConditionalOT(math.inf),
    ConditionalOT(),
    ConditionalOT("balanced"),
    ConditionalOT(3.0, label="source"),
    zero_network(couplings.ModelAligned("weighted")),
    zero_network(couplings.ModelAligned("full")),
    couplings.Transformed(ConditionalOT(10.0), lambda x, c: -x),
]
WITH_REPLACEMENT = [
    MinibatchOT(sampling="replacement"),
    MinibatchOT(plan="sinkhorn", sampling="replacement"),
]
WHOLE = [
    StratifiedOT(),
    StratifiedOT(residual=True),
    couplings.Transformed(StratifiedOT(), lambda x, c: x),
]
SEARCH = [couplings.SemidiscreteOT(1.0, iterations=5)]
# Not every batch will do for them: their own files try them.
ELSEWHERE = {couplings.AdaptiveConditionalOT, Coupling, couplings.FixedPairs, couplings.Reflow}


def new_couplings():
    """What the package exports and no list above names: a new coupling is tried here at once."""
    known = {type(coupling) for coupling in COUPLINGS + WHOLE + SEARCH} | ELSEWHERE
    exported = [getattr(couplings, name) for name in couplings.__all__]
    kinds = [kind for kind in exported if isinstance(kind, type) and issubclass(kind, Coupling)]
    return [kind() for kind in kinds if kind not in known]


for new in new_couplings():
    (WHOLE if new.traits.whole_data else COUPLINGS).append(new)
BATCHES = COUPLINGS + WITH_REPLACEMENT
# What the semidiscrete coupling keeps to does not need a converged potential.
pytestmark = pytest.mark.filterwarnings("ignore:the potential has not converged")
EVERY = BATCHES + WHOLE + SEARCH
every = pytest.mark.parametrize("coupling", EVERY, ids=repr)


def batch(n=24, d=2, k=3, dtype=torch.float32, seed=0):
    g = seeded(seed)
    x0, x1 = (torch.randn(n, d, generator=g, dtype=dtype) for _ in range(2))
    return x0, x1, torch.eye(k, dtype=dtype)[torch.randint(k, (n,), generator=g)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:StratifiedOT was called with 1 row")
@every
@settings(max_examples=10, deadline=None)
@given(
    n=st.integers(1, 20),
    d=st.integers(1, 5),
    k=st.integers(1, 4),
    dtype=st.sampled_from([torch.float32, torch.float64]),
    seed=st.integers(0, 2**31),
)
def test_what_every_coupling_keeps_to(coupling, n, d, k, dtype, seed):
    x0, x1, c = batch(n, d, k, dtype, seed)
    before = x0.clone(), x1.clone(), c.clone()
    pairs = coupling(x0, x1, c, generator=seeded(seed))
    assert all(map(torch.equal, (x0, x1, c), before))
    assert len(pairs) == n
    assert pairs.x0.shape == pairs.x1.shape == (n, d)
    assert pairs.c.shape == (n, k)
    assert pairs.x0.dtype == pairs.x1.dtype == pairs.c.dtype == dtype
    assert pairs.source_index.dtype == pairs.target_index.dtype == torch.int64
    assert torch.equal(pairs.x0, x0[pairs.source_index])
    assert torch.equal(pairs.x1, x1[pairs.target_index])
    if getattr(coupling, "label", "target") == "target":
        assert torch.equal(pairs.c, c[pairs.target_index])
    if coupling not in WITH_REPLACEMENT + SEARCH:
        for index in (pairs.source_index, pairs.target_index):
            assert torch.equal(index.sort().values, torch.arange(n))
    assert same(pairs, coupling(x0, x1, c, seeded(seed)))


@every
def test_global_randomness_is_the_default(coupling):
    x0, x1, c = batch()
    torch.manual_seed(3)
    first = coupling(x0, x1, c)
    torch.manual_seed(3)
    assert same(first, coupling(x0, x1, c))


@every
@pytest.mark.parametrize("value", [0.0, 2.5])
def test_identical_rows_are_no_problem(coupling, value):
    n = 130  # both solvers: see `assignment.py`
    x = torch.full((n, 2), value)
    pairs = coupling(x, x, torch.full((n, 1), value), generator=seeded())
    assert torch.equal(pairs.x0, x)
    assert torch.equal(pairs.x1, x)


@every
def test_no_gradient_is_needed_and_none_is_lost(coupling):
    x0, x1, c = batch()
    x1.requires_grad_()
    pairs = coupling(x0, x1, c, generator=seeded())
    pairs.x1.sum().backward()
    assert x1.grad is not None


def test_integer_conditions_are_labels_of_the_network_as_they_came():
    x0, x1, c = batch()
    whole = ConditionalOT(5.0)(x0, x1, c.long(), generator=seeded())
    real = ConditionalOT(5.0)(x0, x1, c, generator=seeded())
    assert torch.equal(whole.target_index, real.target_index)


@pytest.mark.parametrize("dtype", [torch.long, torch.uint8, torch.bool], ids=str)
@pytest.mark.parametrize("coupling", [*COUPLINGS, *WHOLE, *SEARCH], ids=repr)
@pytest.mark.filterwarnings("ignore")
def test_integer_conditions_pair_as_their_floats(coupling, dtype):
    """The units of `ConditionalOT()` are measured on floats."""
    g = seeded()
    x0, x1 = torch.randn(24, 2, generator=g), torch.randn(24, 2, generator=g)
    c = torch.eye(3)[torch.randint(3, (24,), generator=g)]
    pairs, as_floats = (coupling(x0, x1, seen, seeded(1)) for seen in (c.to(dtype), c))
    assert pairs.c.dtype == dtype
    assert torch.equal(pairs.c.float(), as_floats.c)
    assert torch.equal(pairs.x0, as_floats.x0)
    assert torch.equal(pairs.x1, as_floats.x1)
    assert coupling.candidates(x0, x1, c.to(dtype)) == coupling.candidates(x0, x1, c)


@pytest.mark.slow
def test_a_sampler_may_return_integer_labels():
    class Labels:
        dim, condition_dim, name = 2, 3, "labels"

        def sample(self, n, generator=None):
            own = torch.randint(3, (n,), generator=generator)
            return torch.randn(n, 2, generator=generator), torch.nn.functional.one_hot(own, 3)

    network = VelocityMLP(2, 3, width=8, depth=1)
    fit(network, Labels(), ConditionalOT(), steps=2, batch_size=16, seed=0, progress=False)


@pytest.mark.parametrize("scale", [1e-170, 1e-300, 1e160, 1e300])
def test_numbers_whose_squares_float64_does_not_hold_are_refused(scale):
    """Of 1e-170 all costs were 0, and pairs 24 times as dear as the best."""
    x0, x1, c = batch(dtype=torch.float64)
    with pytest.raises(ValueError, match=r"x0 and x1 must have columns of 0 or .*; x[01] has "):
        MinibatchOT()(scale * x0, scale * x1)
    with pytest.raises(ValueError, match=r"c must have columns of 0 or .*; c has values up"):
        ConditionalOT("balanced")(x0, x1, scale * c)
    assert torch.equal(Independent()(scale * x0, scale * x1).x0, scale * x0)


@pytest.mark.parametrize("scale", [1e-138, 1e-30, 1e30, 1e140])
def test_numbers_whose_squares_float64_holds_pair_as_others(scale):
    x0, x1, c = batch(dtype=torch.float64)
    for coupling in (MinibatchOT(), ConditionalOT()):
        small, plain = coupling(scale * x0, scale * x1, c, seeded()), coupling(x0, x1, c, seeded())
        assert torch.equal(small.target_index, plain.target_index)


def test_independent_pairs_are_row_and_row():
    x0, x1, c = batch()
    pairs = Independent()(x0, x1, c)
    assert all(map(torch.equal, (pairs.x0, pairs.x1, pairs.c), (x0, x1, c)))
    assert Independent()(x0, x1).c is None


def test_mixed_dtypes_are_kept():
    x0, x1, c = batch()
    pairs = MinibatchOT()(x0.double(), x1, c.half())
    assert (pairs.x0.dtype, pairs.x1.dtype) == (torch.float64, torch.float32)
    assert pairs.c.dtype == torch.float16


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@every
def test_device_is_kept(coupling):
    x0, x1, c = (value.cuda() for value in batch())
    pairs = coupling(x0, x1, c, generator=seeded())
    for value in (pairs.x0, pairs.x1, pairs.c, pairs.source_index, pairs.target_index):
        assert value.is_cuda


@pytest.mark.parametrize("coupling", [*EVERY, couplings.AdaptiveConditionalOT()], ids=repr)
@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"x0": None}, TypeError, "x0 must be a torch tensor, got NoneType"),
        ({"x0": np.zeros((4, 2))}, TypeError, "x0 must be a torch tensor"),
        ({"x1": torch.zeros(4, 2, dtype=torch.int64)}, TypeError, "x1 must be a floating-point"),
        ({"x0": torch.zeros(4)}, ValueError, r"x0 must have shape .* got \(4,\)"),
        ({"x1": torch.zeros(4, 3)}, ValueError, "x1 has 3 columns, expected 2"),
        ({"x1": torch.zeros(5, 2)}, ValueError, "x1 has 5 rows, x0 has 4"),
        ({"c": torch.zeros(3, 1)}, ValueError, "c has 3 rows, x0 has 4"),
        ({"c": torch.tensor([0, 1, 2, 3])}, ValueError, "c must have shape .*one_hot"),
        ({"c": torch.full((4, 1), math.nan)}, ValueError, "c has NaN"),
        ({"c": "left"}, TypeError, "c must be a torch tensor, got str"),
        ({"x0": torch.full((4, 2), math.nan)}, ValueError, "x0 has NaN or infinite .* 4 of 4"),
        ({"x1": torch.full((4, 2), math.inf)}, ValueError, "x1 has NaN or infinite"),
        ({"x0": torch.zeros(0, 2), "x1": torch.zeros(0, 2)}, ValueError, "x0 is empty"),
    ],
)
def test_bad_input(coupling, change, error, message):
    given = {"x0": torch.zeros(4, 2), "x1": torch.zeros(4, 2), "c": torch.zeros(4, 1)}
    with pytest.raises(error, match=message):
        coupling(**{**given, **change})


def test_pairs_map_leaves_out_what_is_not_there():
    pairs = couplings.Pairs(*batch(4)[:2], None, torch.arange(4), torch.arange(4))
    cut = pairs.map(lambda value: value[:3])
    assert len(cut) == 3
    assert cut.c is None
    assert cut.weight is None
    assert torch.equal(cut.source_index, torch.arange(3))


def test_a_new_coupling_overrides_match_alone():
    class Backwards(Coupling):
        name = "backwards"

        def match(self, x0, x1, c, rng):
            return Match(np.arange(len(x0)), np.arange(len(x0))[::-1].copy())

    x0, x1, c = batch(5)
    pairs = Backwards()(x0, x1, c)
    assert torch.equal(pairs.x1, x1.flip(0))
    assert torch.equal(pairs.c, c.flip(0))
    assert len(next(Backwards().stream(petals(), batch_size=5))) == 5
    with pytest.raises(NotImplementedError):
        Coupling()(x0, x1, c)


# --- the stream ---


@pytest.mark.parametrize("coupling", BATCHES, ids=repr)
@pytest.mark.parametrize("ot_batch_size", [None, 8, 32])
def test_a_stream_that_starts_later_gives_the_same_batches(coupling, ot_batch_size):
    options = {"batch_size": 8, "ot_batch_size": ot_batch_size}
    every_batch = take(coupling, petals(), 9, **options)
    for start in (1, 3, 4, 6):
        later = take(coupling, petals(), 3, start=start, **options)
        assert all(map(same, every_batch[start:], later))


def test_the_stream_depends_on_the_seed_and_not_on_what_was_drawn_before():
    first, second = take(MinibatchOT(), petals(), 2, batch_size=8, generator=seeded(7))
    used = seeded(7)
    torch.rand(5, generator=used)
    (again,) = take(MinibatchOT(), petals(), 1, batch_size=8, generator=used)
    assert torch.equal(first.x1, again.x1)
    (other,) = take(MinibatchOT(), petals(), 1, batch_size=8, generator=seeded(8))
    assert not torch.equal(first.x1, other.x1)
    assert not torch.equal(first.x1, second.x1)


@pytest.mark.parametrize("coupling", COUPLINGS, ids=repr)
def test_an_ot_batch_that_is_cut_up_covers_each_row_once(coupling):
    parts = take(coupling, petals(), 4, batch_size=8, ot_batch_size=32)
    for name in ("source_index", "target_index"):
        assert torch.equal(joined(parts, name).sort().values, torch.arange(32))


def test_a_cut_of_condition_exact_pairs_is_no_single_class():
    for part in take(ConditionalOT(math.inf), petals(), 8, batch_size=16, ot_batch_size=128):
        assert len(part.c.unique(dim=0)) >= 3


def test_the_batch_is_paired_as_a_whole():
    parts = take(MinibatchOT(), petals(), 4, batch_size=8, ot_batch_size=32)
    generator = generator_for(5, 0)
    x1, c = petals().sample(32, generator=generator)
    x0 = torch.randn(32, 2, generator=generator)
    whole = MinibatchOT()(x0, x1, c, generator=generator)
    assert torch.equal(joined(parts, "x0"), whole.x0)
    assert torch.equal(joined(parts, "x1"), whole.x1)


@pytest.mark.parametrize("coupling", [Independent(), StratifiedOT()])
def test_rows_of_a_source_in_an_order_do_not_meet_data_in_theirs(coupling):
    def source(n, generator=None):  # two modes, one after the other
        side = torch.arange(n)[:, None] * 2 // n
        return torch.randn(n, 2, generator=generator) + 6.0 * side

    class InOrder(Dataset):
        def sample(self, n, generator=None):
            return self.x1[:n], self.c[:n]

    c = torch.eye(2).repeat_interleave(500, dim=0)
    data = InOrder(torch.randn(1000, 2, generator=seeded(1)), c)
    pairs = take(coupling, data, 1, batch_size=1000, source=source)[0]
    means = [float(pairs.x0[pairs.c[:, k] == 1].mean()) for k in range(2)]
    assert means == pytest.approx([3.0, 3.0], abs=1.0)  # 0 and 6 in their order


def test_noise_comes_from_the_source():
    def source(n, generator=None):
        return 5 + torch.rand(n, 2, generator=generator)

    pairs = take(MinibatchOT(), petals(), 2, batch_size=8, source=source)
    assert all(((part.x0 >= 5) & (part.x0 < 6)).all() for part in pairs)
    assert not torch.equal(pairs[0].x0, pairs[1].x0)


@pytest.mark.parametrize("value", [1e300, float("nan")])
@pytest.mark.parametrize("coupling", [Independent(), StratifiedOT(2, n_samples=64)], ids=repr)
def test_noise_that_the_dtype_of_the_data_cannot_hold_is_refused(coupling, value):
    def source(n, generator=None):
        return torch.full((n, 2), value, dtype=torch.float64)

    with pytest.raises(ValueError, match=r"source\(n\) in torch.float32 has NaN or infinite"):
        take(coupling, petals(), 1, batch_size=8, source=source)


def test_noise_has_the_dtype_of_the_data():
    data = Dataset(torch.zeros(5, 2, dtype=torch.float64))
    assert next(Independent().stream(data, batch_size=3)).x0.dtype == torch.float64


def test_data_without_a_condition():
    bare = unconditional(petals())
    assert next(MinibatchOT().stream(bare, batch_size=4)).c is None
    with pytest.raises(TypeError, match="ConditionalOT needs the conditions c"):
        next(ConditionalOT(1.0).stream(bare, batch_size=4))


def stream(**options):
    next(Independent().stream(petals(), **({"batch_size": 8} | options)))


test_bad_stream_options = refused(
    (lambda: stream(batch_size=0), ValueError, "batch_size must be at least 1"),
    (lambda: stream(batch_size=2.0), TypeError, "batch_size must be an integer"),
    (lambda: stream(ot_batch_size=4), ValueError, "ot_batch_size must be at least 8"),
    (lambda: stream(ot_batch_size=20), ValueError, "ot_batch_size .* multiple .* 8"),
    (lambda: stream(start=-1), ValueError, "start must be at least 0"),
    (lambda: stream(source=lambda n, generator: torch.zeros(n, 3)), ValueError, "source"),
    (lambda: stream(source=lambda n, generator: None), TypeError, "source.* NoneType"),
)


@pytest.mark.parametrize("coupling", [Independent(), *COUPLINGS[1:5]], ids=repr)
def test_a_larger_ot_batch_gives_more_candidates_where_it_is_used(coupling):
    small, large = (coupling.candidates(*batch(n)) for n in (16, 64))
    assert coupling.traits.uses_ot_batch == (large > small)


def test_couplings_of_all_the_data_take_no_ot_batch():
    x1, c = petals().sample(40, generator=seeded())
    search = couplings.SemidiscreteOT(iterations=1)
    for coupling in (StratifiedOT(), search, couplings.FixedPairs(x1)):
        assert coupling.traits.whole_data
        assert not coupling.traits.uses_ot_batch
        for options, message in (
            ({"ot_batch_size": 16}, r"must be equal to batch_size 8 for .*, got 16"),
            ({"start": -1}, "start must be at least 0"),
            ({"batch_size": 0}, "batch_size must be at least 1"),
        ):
            with pytest.raises(ValueError, match=message):
                take(coupling, Dataset(x1, c), 1, **({"batch_size": 8} | options))


def test_data_that_turn_bad_are_named():
    class Broken:
        def sample(self, n, generator=None):
            return torch.full((n, 2), math.nan), None

    with pytest.raises(ValueError, match="x1 has NaN"):
        next(Independent().stream(Broken(), batch_size=4))


def test_distances_and_noise():
    x0, x1, _ = batch(4)
    expected = (x0[:, None].double() - x1[None].double()).square().sum(dim=2)
    assert np.allclose(squared_distances(x0, x1), expected)
    assert to_numpy(x0).dtype == np.float64
    assert torch.equal(draw_noise(x1, None, seeded(1)), torch.randn(4, 2, generator=seeded(1)))


@pytest.mark.parametrize("near", [0, 5, 60])
@pytest.mark.parametrize("dim", [2, 12, 40])
def test_rows_next_to_each_other_keep_their_digits(dim, near):
    x0, x1, _ = batch(60, dim, dtype=torch.float64)
    x0[:near] = x1[0] + 1e-7 * x0[:near]
    x1[:near] = x1[0]
    found = squared_distances(1e3 + x0, 1e3 + x1)
    expected = ((1e3 + x0)[:, None] - (1e3 + x1)[None]).square().sum(dim=2)
    assert np.allclose(found, expected, rtol=1e-9, atol=0)
    assert (squared_distances(x1, x1)[:near, :near] == 0).all()


def test_distances_of_few_columns_are_those_of_scipy_bit_by_bit():
    wide = torch.randn(9, 30, dtype=torch.float64, generator=seeded())
    for x0, x1 in ((wide[:, :3], wide[4:, ::10]), (wide.T[:, :1], wide.T[:1, 5:6]), (wide, wide)):
        x0, x1 = x0[:, :11], x1[:, :11]
        found = squared_distances(x0, x1)
        assert np.array_equal(found, cdist(x0, x1, "sqeuclidean"))
        assert mean_distance(found) == pytest.approx(np.sqrt(found).mean(), rel=1e-12)
    assert mean_distance(np.array([[1.0, np.inf]])) == np.inf


@pytest.mark.filterwarnings("ignore:condition_weight", "ignore:costs up to")
@pytest.mark.parametrize("scale", [1e-16, 1e-4, 1e4, 1e16])
@pytest.mark.parametrize("far", [0.0, 1e4, 1.7e9])
@pytest.mark.parametrize(
    "coupling",
    [MinibatchOT(), ConditionalOT(), ConditionalOT(math.inf), StratifiedOT()],
    ids=repr,
)
def test_a_plan_is_the_same_for_data_far_from_0_and_in_other_units(coupling, far, scale):
    x0, z = torch.randn(2, 96, 3, dtype=torch.float64, generator=seeded())
    c = torch.eye(3, dtype=torch.float64)[torch.arange(96) % 3]
    x1 = z.clone()
    x1[:, 0] = x1[:, 0] + (far if scale == 1e4 else 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # strata of a batch
        plain, moved = (coupling(x0, data, c, generator=seeded(1)) for data in (z, x1 * scale))
    gain = [float((p.x0 * z[p.target_index]).sum(dim=1).mean()) for p in (plain, moved)]
    assert gain[1] == pytest.approx(gain[0], rel=1e-5)


def test_options_that_were_set_later_are_checked():
    x0, x1, c = batch(16)
    for coupling, option, value in (
        (MinibatchOT(), "plan", "Sinkhorn"),
        (MinibatchOT(), "sampling", "all"),
        (ConditionalOT(), "condition_weight", "blanced"),
        (ConditionalOT(), "condition_weight", -1.0),
        (ConditionalOT(), "label", "sorce"),
    ):
        setattr(coupling, option, value)
        with pytest.raises(ValueError, match=f"{option} must be"):
            coupling(x0, x1, c)


def test_options_are_readable():
    assert repr(Independent()) == "Independent()"
    assert repr(MinibatchOT()) == (
        "MinibatchOT(plan='exact', sampling='permutation', regularization=0.05)"
    )
    assert "condition_weight=inf" in repr(ConditionalOT(math.inf))


def test_a_function_in_the_options_has_the_same_name_in_every_process():
    """A checkpoint knows its training by this text: no address may stand in it."""

    def half(c):
        return c / 2

    text = repr(ConditionalOT(1.0, condition=half))
    assert "half" in text
    assert " at 0x" not in text


# --- ties ---


@pytest.mark.parametrize(("rows", "columns"), [(40, 2), (256, 2), (129, 13)])
@pytest.mark.parametrize(
    "coupling",
    [
        MinibatchOT(),
        MinibatchOT(plan="sinkhorn"),
        ConditionalOT(0.0),
        ConditionalOT(math.inf, condition=torch.ones_like),
        Transformed(MinibatchOT(), lambda x, c: x),
    ],
)
def test_noise_does_not_depend_on_the_order_of_equal_data(coupling, rows, columns):
    g, c = seeded(1), torch.linspace(-1, 1, rows)[:, None]  # the batch is sorted by its condition
    sums = []
    for _ in range(8000 // rows):
        x1 = torch.randint(0, 2, (rows, 1), generator=g).float().expand(-1, columns)
        pairs = coupling(torch.randn(rows, columns, generator=g), x1, c, g)
        sums.append(torch.cat([pairs.x0, pairs.x0.norm(dim=1, keepdim=True), pairs.c], dim=1))
    slope = np.corrcoef(torch.cat(sums).T.numpy())[-1, :-1]
    assert abs(slope).max() < 0.05  # where solvers choose in order it is -.1 to -.2


# --- in the workers of a DataLoader ---


class Stream(IterableDataset):
    """A seeded stream, cut after some batches of each worker."""

    def __init__(self, coupling=None, data=None, batches=0, start=0):
        self.options = coupling, data, batches, start

    def __iter__(self):
        coupling, data, batches, start = self.options
        stream = coupling.stream(data, batch_size=8, generator=seeded(3), start=start)
        return itertools.islice(stream, batches)


def test_workers_share_the_batches_of_a_seeded_stream():
    """They gave 8 batches of which 4 were distinct."""
    data = petals()
    loader = DataLoader(Stream(MinibatchOT(), data, 3), batch_size=None, num_workers=2)
    alone = take(MinibatchOT(), data, 6, batch_size=8, generator=seeded(3))
    assert all(same(a, b) for a, b in zip(loader, alone, strict=True))


@pytest.mark.parametrize("start", [0, 3, 7])
@pytest.mark.parametrize("workers", [2, 3, 5])
@pytest.mark.parametrize("ot_batch_size", [8, 32])
def test_every_batch_has_one_worker_whatever_the_numbers(
    monkeypatch, start, workers, ot_batch_size
):
    options = {"batch_size": 8, "ot_batch_size": ot_batch_size, "start": start}
    alone = take(Independent(), petals(), 15, **options)
    shares = []
    for own in range(workers):
        worker = SimpleNamespace(num_workers=workers, id=own, seed=0, dataset=Stream())
        monkeypatch.setattr(base, "get_worker_info", lambda worker=worker: worker)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a stream's own generators are no copies
            shares.append(take(Independent(), petals(), 15 // workers, **options))
    turns = [share[k] for k in range(15 // workers) for share in shares]
    assert all(same(a, b) for a, b in zip(turns, alone, strict=False))


@pytest.mark.parametrize(
    ("coupling", "ot_batch_size"),
    [(MinibatchOT(), 8), (MinibatchOT(), 32), (Batches(iter(take(Independent(), petals(), 8))), 8)],
)
def test_a_stream_begun_before_the_workers_is_refused_in_them(monkeypatch, coupling, ot_batch_size):
    """Batches that are paired at once are not yielded by each worker, either."""
    options = {"batch_size": 8, "ot_batch_size": ot_batch_size}
    stream = coupling.stream(petals(), generator=seeded(), **options)
    next(stream)
    worker = SimpleNamespace(num_workers=2, id=1, seed=77)
    monkeypatch.setattr(base, "get_worker_info", lambda: worker)
    with pytest.raises(RuntimeError, match="begun before the DataLoader's workers"):
        next(stream)


@pytest.mark.parametrize("coupling", [MinibatchOT(), FixedPairs(torch.randn(64, 2))])
def test_nothing_is_drawn_where_tensors_hold_no_numbers(coupling):
    data = Dataset(torch.randn(64, 2), torch.randn(64, 1))
    stream = coupling.stream(data, batch_size=8, generator=seeded())
    with torch.device("meta"), pytest.raises(RuntimeError, match="default device is 'meta'"):
        next(stream)


def test_a_stream_in_a_map_style_data_set_says_that_it_yields_a_share(monkeypatch):
    data = Dataset(torch.randn(64, 2), torch.randn(64, 1))
    worker = SimpleNamespace(num_workers=2, id=1, seed=77, dataset=data)
    monkeypatch.setattr(base, "get_worker_info", lambda: worker)
    with pytest.warns(UserWarning, match="so that start=i does not begin with batch i"):
        next(Independent().stream(data, batch_size=8, generator=seeded(), start=3))


def test_a_generator_that_all_workers_have_is_said(monkeypatch):
    x0, x1, c = batch()
    worker = SimpleNamespace(num_workers=2, id=1, seed=77)
    monkeypatch.setattr(base, "get_worker_info", lambda: worker)
    with pytest.warns(UserWarning, match="draws the same in each of them"):
        Independent()(x0, x1, c, generator=seeded(0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Independent()(x0, x1, c)
        Independent()(x0, x1, c, generator=seeded(77))


# --- what a user's data, noise and couplings return ---


def answering(**answer):
    """Data, a source of noise, or a coupling, with a wrong answer."""
    if "rows" in answer:
        return SimpleNamespace(sample=lambda n, generator=None: answer["rows"](n))
    coupling = Coupling()
    coupling.match = lambda x0, x1, c, rng: answer["match"](len(x0))
    return coupling


def drawn(rows):
    return lambda: take(MinibatchOT(), answering(rows=rows), 1)


def matched(match):
    return lambda: answering(match=match)(*batch())


ROWS = torch.randn(100, 2)
test_wrong_answers_are_named = refused(
    (drawn(lambda n: (ROWS[:8], None)), ValueError, r"sample\(20\) must return 20 rows of x1"),
    (drawn(lambda n: (ROWS[:n], ROWS[:8])), ValueError, "must return 20 rows of c, got shape"),
    (drawn(lambda n: ROWS[:n]), TypeError, r"sample\(n\) must return \(x1, c\), got Tensor"),
    (drawn(lambda n: (ROWS[:n].numpy(), None)), TypeError, "x1 as a torch tensor, got ndarray"),
    (drawn(lambda n: (ROWS[:n].tolist(), None)), TypeError, "x1 as a torch tensor, got list"),
    (drawn(lambda n: (ROWS[:n], [1] * n)), TypeError, "c as a torch tensor, got list"),
    (matched(lambda n: Match(*[np.arange(n // 2)] * 2)), ValueError, "source_index as 24 rows"),
    (matched(lambda n: Match(np.arange(n), np.arange(n) + 1)), ValueError, "target.* from 1 to 24"),
    (matched(lambda n: Match(np.arange(n), -np.ones(n, int))), ValueError, "target.* from -1 to"),
    (matched(lambda n: Match(np.arange(n), np.ones(n))), ValueError, "target.* got float64"),
    (matched(lambda n: (np.arange(n), np.arange(n))), TypeError, "must be a Match, got"),
)


@pytest.mark.parametrize("coupling", [StratifiedOT(), MinibatchOT()])
def test_a_tuple_in_the_place_of_data_is_named_by_its_shapes(coupling):
    """Before, the error contained all numbers of both tensors."""
    got = r", got \(Tensor of shape \(100, 2\), Tensor of shape \(100, 1\)\)$"
    with pytest.raises(TypeError, match="data must be an object with sample.*" + got):
        next(coupling.stream((ROWS, ROWS[:, :1]), batch_size=8))


def with_x1(change):
    def match(x0, x1, c, rng):
        return Match(np.arange(24), np.arange(24), x1=change(x1))

    coupling = Coupling()
    coupling.match = match
    return lambda: coupling(*batch())


test_data_of_a_match_are_looked_at = refused(
    (with_x1(lambda x: x * math.nan), ValueError, "x1 of match has NaN"),
    (with_x1(lambda x: x[:3]), ValueError, r"x1 of match must have shape \(24, 2\)"),
    (with_x1(lambda x: x.long()), TypeError, "x1 of match must have a floating-point tensor"),
)


def test_data_of_a_match_get_the_type_of_the_data():
    assert with_x1(lambda x: x.double())().x1.dtype == torch.float32


def changed(**parts):
    return lambda: replace(Independent()(*batch()), **parts)


test_rows_of_pairs_are_looked_at = refused(
    (changed(source_index=torch.arange(3)), ValueError, r"source_index must have shape \(24,\)"),
    (changed(target_index=torch.ones(24)), TypeError, "target_index must be a tensor of integers"),
    (changed(target_index=None), TypeError, "target_index must be a tensor of integers, got None"),
    (changed(c=torch.zeros(3, 2)), ValueError, r"c must have .*, got Tensor of shape \(3, 2\)$"),
    (
        changed(group=torch.zeros(3).long()),
        ValueError,
        r"group must have shape \(24,\), got",
    ),
)


def of(**parts):
    given = {"x0": torch.zeros(4, 2), "x1": torch.zeros(4, 2), "c": torch.zeros(4, 1)}
    return lambda: MinibatchOT()(**given | parts)


EYE = torch.eye(4, 2)
test_tensors_without_numbers_are_named = refused(
    (of(x0=EYE.to("meta")), "x0 must hold numbers, got a tensor on the device 'meta'"),
    (of(x1=EYE.to_sparse()), "x1 must be a dense tensor, got torch.sparse_coo: pass x1.to_dense"),
    (of(c=EYE.to_sparse()), "c must be a dense tensor"),
    (of(c=EYE.long().to("meta")), "c must hold numbers"),
    (of(c=EYE.to(torch.float8_e4m3fn)), "c must have 16, 32 or 64 bits a number, got"),
    (lambda: Dataset(EYE.to(torch.float8_e5m2)), "x1 must have 16, 32 or 64 bits"),
    (lambda: Dataset(EYE, EYE.to("meta")), "c must hold numbers"),
    error=TypeError,
)


def test_a_match_of_tensors_and_noise_of_another_type_are_taken():
    pairs = answering(match=lambda n: Match(torch.arange(n), torch.arange(n).flip(0)))(*batch())
    assert pairs.target_index.tolist() == list(range(23, -1, -1))
    source = lambda n, generator=None: torch.randn(n, 2, dtype=torch.float64, generator=generator)  # noqa: E731
    assert take(MinibatchOT(), petals(), 1, source=source)[0].x0.dtype == torch.float32


def test_a_stream_ends_where_a_coupling_leaves_rows_out():
    """It yielded nothing, for ever."""
    coupling = Independent()
    coupling.solve = lambda data, n, source, rng: Coupling.solve(
        coupling, data, n // 2, source, rng
    )
    with pytest.raises(ValueError, match="solve of Independent must return 20 pairs, got 10"):
        take(coupling, petals(), 1)


def weighed(weight):
    return lambda: replace(Independent()(*batch()), weight=weight)


test_weights_that_would_broadcast_or_pull_apart_are_refused = refused(
    (weighed(torch.ones(24, 1)), r"weight must have shape \(24,\), got \(24, 1\)"),
    (weighed(torch.full((24,), -1.0)), "weight must be at least 0, got -1"),
    (weighed(torch.full((24,), math.nan)), "weight must be at least 0, got nan"),
    (weighed(torch.full((24,), math.inf)), "weight must be finite, got inf"),
    error=ValueError,
)


def test_a_loader_pins_every_tensor_of_the_pairs(monkeypatch):
    pinned = []
    monkeypatch.setattr(torch.Tensor, "pin_memory", lambda t: pinned.append(t) or t.clone())
    c = torch.eye(3)
    pairs = MinibatchOT()(torch.randn(3, 2), torch.randn(3, 2), c).pin_memory()
    assert isinstance(pairs, Pairs)
    assert len(pinned) == 5  # x0, x1, c and both indices; there is no weight


def test_pairs_are_printed_in_a_line():
    pairs = Independent()(torch.randn(9, 2), torch.randn(9, 2), torch.randn(9, 3))
    shown = "x0 (9, 2), x1 (9, 2), c (9, 3), source_index (9,), target_index (9,)"
    assert repr(pairs) == f"Pairs({shown})"


def test_pairs_of_different_kinds_are_not_joined():
    """Weights and conditions of the later parts were dropped."""
    rows, x = torch.arange(4), torch.randn(4, 2, generator=seeded())
    plain = Pairs(x, x, None, rows, rows)
    for other in (Pairs(x, x, x, rows, rows), Pairs(x, x, None, rows, rows, weight=torch.ones(4))):
        for parts in ([plain, other], [other, plain]):
            with pytest.raises(ValueError, match=r"parts must all have (c|weight), or none"):
                Pairs.cat(parts)
    with pytest.raises(ValueError, match="at least one Pairs, got none"):
        Pairs.cat([])


@pytest.mark.parametrize("largest", [2**25, 2**60])
def test_integers_that_would_merge_are_refused(largest):
    """Above 2^53 they had merged on both sides of the comparison."""
    c = largest + torch.arange(64)[:, None] % 4
    with pytest.raises(ValueError, match="would merge some"):
        Dataset(torch.randn(64, 2, generator=seeded()), c)


def numbered(count):
    for k in range(count):
        rows = torch.full((4, 2), float(k))
        yield Pairs(rows, rows, None, torch.arange(4), torch.arange(4))


class Numbered(IterableDataset):
    def __iter__(self):
        stream = Batches(numbered(6)).stream(petals(), batch_size=4)
        return iter([int(pairs.x0[0, 0]) for pairs in stream])


def test_existing_batches_start_where_they_should():
    stream = Batches(numbered(6)).stream(petals(), batch_size=4, start=4)
    assert int(next(stream).x0[0, 0]) == 4
    with pytest.raises(ValueError, match="start must be below the number of batches, 6"):
        next(Batches(numbered(6)).stream(petals(), batch_size=4, start=7))


def test_existing_batches_take_no_other_noise():
    """It was ignored, so that training had other noise than the sampler."""
    for rows in (4, 32):  # as many as a batch has, whatever is asked for
        assert len(next(Batches(numbered(6)).stream(petals(), batch_size=rows))) == 4
    with pytest.raises(ValueError, match="source must be None: Batches have noise of their own"):
        next(Batches(numbered(6)).stream(petals(), batch_size=4, source=torch.randn))


@pytest.mark.parametrize("name", ["x1", "c"])
@pytest.mark.parametrize(
    "coupling", [StratifiedBatches(4), FixedPairs(torch.randn(64, 2)), MinibatchOT()]
)
def test_a_stream_refuses_what_is_not_finite_in_data_refilled_since(coupling, name):
    data = Dataset(torch.randn(64, 2), torch.randn(64, 1))
    stream = coupling.stream(data, batch_size=32, generator=seeded())
    next(stream)
    getattr(data, name)[:] = math.nan
    with pytest.raises(ValueError, match="NaN or infinite"):
        next(stream)


def test_workers_share_existing_batches():
    loader = DataLoader(Numbered(), batch_size=None, num_workers=2)
    assert sorted(map(int, loader)) == list(range(6))
