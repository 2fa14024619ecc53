"""Semidiscrete OT against exact assignments, duality and its own definition."""

import math
from functools import partial

import numpy as np
import ot
import pytest
import support
import torch
from support import joined, refused, same, seeded

from cotlearn import mixtures
from cotlearn.couplings import SemidiscreteOT, semidiscrete
from cotlearn.couplings.conditions import KMeansCondition
from cotlearn.couplings.distances import squared_distances
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import prior_skew
from cotlearn.randomness import generator_for
from cotlearn.storage import load_tensors, save_tensors

# Many tests fit for a few steps only: what they ask does not need more.
pytestmark = pytest.mark.filterwarnings("ignore:the potential has not converged")


def points(n=24, seed=0):
    g = seeded(seed)
    c = torch.eye(2)[torch.arange(n) % 2]
    return Dataset(torch.randn(n, 2, generator=g) + 3 * c, c)


take = partial(support.take, batch_size=64)
DATA = points()
X1, C = DATA.x1, DATA.c


@pytest.fixture(scope="module")
def plain():
    return SemidiscreteOT(iterations=1500).fit(X1, progress=False)


@pytest.fixture(scope="module")
def conditional():
    return SemidiscreteOT(20.0, iterations=1500).fit(X1, C, progress=False)


@pytest.mark.slow
def test_rows_are_chosen_equally_often(plain, conditional):
    for coupling in (plain, conditional):
        assert coupling.marginal_error < coupling.marginal_floor + 0.03
        assert 0 < coupling.marginal_floor < 0.05


@pytest.mark.slow
def test_the_marginal_error_is_what_a_count_says(plain):
    """And without a fitted potential it is large."""
    drawn = joined(take(plain, Dataset(X1), 100, batch_size=240), "target_index")
    frequency = torch.bincount(drawn, minlength=24) / 24_000
    distance = float((frequency - 1 / 24).abs().sum() / 2)
    assert distance == pytest.approx(plain.marginal_error, abs=0.015)
    nearest = SemidiscreteOT(iterations=1).fit(X1, progress=False)
    assert nearest.marginal_error > 5 * plain.marginal_error


def test_the_search_is_its_definition(conditional):
    """argmin_j |x0 - x1_j|^2 + w |c0 - c_j|^2 - phi_j, row by row."""
    x0 = torch.randn(24, 2, generator=seeded(1))
    pairs = conditional(x0, X1, C)
    phi = conditional.state_dict()["phi"].double()
    for i in range(24):
        of_c = 20 * (C[i] - C).double().square().sum(dim=1)
        height = (x0[i].double() - X1.double()).square().sum(dim=1) + of_c - phi
        assert pairs.target_index[i] == height.argmin()
    assert torch.equal(pairs.x0, x0)
    assert torch.equal(pairs.c, C[pairs.target_index])


@pytest.mark.parametrize("weight", [0.0, 20.0])
def test_transport_cost_and_dual_are_those_of_the_discretised_problem(plain, conditional, weight):
    """Primal, dual and an exact plan from 4,800 noise rows to the 24 points agree."""
    coupling = conditional if weight else plain
    given = DATA if weight else Dataset(X1)
    batches = take(coupling, given, 10, batch_size=480)
    x0, chosen = joined(batches, "x0").double(), joined(batches, "target_index")
    # the noise's condition is that of a random row: draw it again as `stream` does
    own = torch.cat([torch.randint(24, (480,), generator=generator_for(5, s)) for s in range(10)])
    c = math.sqrt(weight) * C.double()
    source, target = torch.cat([x0, c[own]], dim=1), torch.cat([X1.double(), c], dim=1)
    cost = squared_distances(source, target)
    exact = ot.emd2(np.full(4800, 1 / 4800), np.full(24, 1 / 24), cost)
    primal = cost[np.arange(4800), chosen.numpy()].mean()
    phi = coupling.state_dict()["phi"].double().numpy()
    dual = (cost - phi).min(axis=1).mean() + phi.mean()
    assert dual <= exact + 1e-9  # weak duality holds for any potential
    assert dual == pytest.approx(exact, rel=0.01)
    assert primal == pytest.approx(exact, rel=0.03)


def test_each_noise_row_has_as_many_candidates_as_the_data(plain, conditional):
    x0 = torch.randn(24, 2, generator=seeded(1))
    assert plain.candidates(x0, X1) == 24
    assert conditional.candidates(x0, X1, C) == pytest.approx(12)  # those of its label
    assert SemidiscreteOT().candidates(x0, X1) == 1


def test_clusters_keep_to_themselves():
    g = seeded()
    c = torch.rand(200, 1, generator=g)
    data = Dataset(torch.randn(200, 2, generator=g), c)
    coupling = SemidiscreteOT(clusters=4, iterations=50)
    pairs = coupling(torch.randn(200, 2, generator=g), data.x1, data.c)
    label = KMeansCondition(4).fit(c).labels(c)
    assert torch.equal(label[pairs.target_index], label)
    assert len(pairs.target_index.unique()) > 4
    expected = float((torch.bincount(label).double() ** 2).sum() / 200)
    assert coupling.candidates(pairs.x0, pairs.x1, c) == pytest.approx(expected)


@pytest.mark.slow
def test_clusters_are_the_same_as_one_problem_for_each():
    """Two labels as clusters: each cluster's marginal is uniform, and so is the whole."""
    coupling = SemidiscreteOT(clusters=2, iterations=1500)
    coupling.fit(X1, C, progress=False)
    assert coupling.marginal_error < coupling.marginal_floor + 0.03
    apart = SemidiscreteOT(iterations=1500).fit(X1[::2], progress=False)
    x0 = torch.randn(12, 2, generator=seeded(3))
    both = torch.randn(24, 2)
    both[::2] = x0
    together = coupling(both, X1, C).target_index[::2] // 2
    alone = apart(x0, X1[::2]).target_index
    assert (together == alone).float().mean() > 0.7  # up to the noise of both fits


def test_splitting_the_search_changes_nothing(plain):
    x0 = torch.randn(500, 2, generator=seeded(1))
    rows = torch.arange(500) % 24
    whole = plain._points.search(x0, rows)
    one_by_one = [plain._points.search(x0[i : i + 1], rows[i : i + 1]) for i in range(500)]
    assert torch.equal(whole, torch.cat(one_by_one))


def test_many_rows_are_searched_in_parts():
    x1 = torch.randn(30_000, 2, generator=seeded())
    phi = torch.randn(30_000, generator=seeded(1))
    x0 = torch.randn(1500, 2, generator=seeded(2))  # 1,500 x 30,000: more than one part
    points = semidiscrete._Points(SemidiscreteOT(), x1, None)
    points.phi = phi
    found = points.search(x0, torch.zeros(1500, dtype=torch.long))
    for i in (0, 72, 73, 74, 665, 666, 1499):  # on both sides of cuts
        height = (x0[i] - x1).double().square().sum(dim=1) - phi
        assert found[i] == height.argmin()


def test_the_same_seed_gives_the_same_pairs_and_resumes():
    first, again = (take(SemidiscreteOT(5.0, iterations=20), DATA, 5) for _ in range(2))
    later = take(SemidiscreteOT(5.0, iterations=20), DATA, 2, start=3)
    assert all(map(same, first + first[3:], again + later))
    assert not torch.equal(first[0].x0, first[1].x0)


def test_the_potential_is_saved_with_the_training(conditional, tmp_path, monkeypatch):
    save_tensors(tmp_path / "phi.safetensors", conditional.state_dict(), {})
    again = SemidiscreteOT(20.0, iterations=1500)
    assert again.state_dict() == {}
    assert math.isnan(again.marginal_error)
    again.load_state_dict({})
    again.load_state_dict(load_tensors(tmp_path / "phi.safetensors")[0])
    assert again.marginal_error == conditional.marginal_error
    assert again.marginal_floor == conditional.marginal_floor
    monkeypatch.setattr(SemidiscreteOT, "fit", lambda *a, **k: pytest.fail("fitted again"))
    assert all(map(same, take(conditional, DATA, 3), take(again, DATA, 3)))


def test_other_data_are_fitted_anew():
    coupling = SemidiscreteOT(iterations=5)
    take(coupling, Dataset(X1), 1)
    other = Dataset(X1 + 1)
    used = take(coupling, other, 2)
    fresh = take(SemidiscreteOT(iterations=5), other, 2)
    assert torch.equal(used[1].target_index, fresh[1].target_index)
    assert torch.equal(used[0].x1, other.x1[used[0].target_index])


def test_another_noise_is_fitted_anew():
    def far(n, generator=None):
        return 5 + torch.rand(n, 2, generator=generator)

    given = Dataset(X1)
    coupling = SemidiscreteOT(iterations=300)
    take(coupling, given, 1)
    chosen = joined(take(coupling, given, 40, source=far), "target_index")
    frequency = torch.bincount(chosen, minlength=24) / len(chosen)
    assert float((frequency - 1 / 24).abs().sum() / 2) < 0.2  # without a new fit about 0.9


def test_a_large_weight_leaves_no_skew_and_none_much():
    data = mixtures.rotating_pair().sample(400, generator=seeded())
    skewed = []
    for weight in (0.0, 1e3):
        coupling = SemidiscreteOT(weight, iterations=300)
        batch = take(coupling, Dataset(*data), 1, batch_size=1000)[0]
        skewed.append(prior_skew(batch.x0, batch.c, generator=seeded()))
    assert skewed[0].flagged
    assert skewed[1].statistic < 0.2 * skewed[0].statistic


def test_a_data_set_smaller_than_the_batch_duplicates_and_one_row():
    coupling = SemidiscreteOT(iterations=20)
    assert take(coupling, Dataset(torch.randn(3, 2)), 1)[0].x1.shape == (64, 2)
    assert take(coupling, Dataset(torch.zeros(5, 2)), 1)[0].x1.eq(0).all()
    assert take(coupling, Dataset(torch.ones(1, 2)), 1)[0].x1.eq(1).all()
    assert coupling.marginal_error == 0


def test_constant_integer_and_bool_conditions():
    options = {"iterations": 20}
    reference = SemidiscreteOT(3.0, **options)
    x0 = torch.randn(24, 2)
    expected = reference(x0, X1, C)
    for dtype in (torch.int64, torch.bool):
        pairs = SemidiscreteOT(3.0, **options)(x0, X1, C.to(dtype))
        assert torch.equal(pairs.target_index, expected.target_index)
    constant = torch.full((24, 1), 0.1)
    weighed = SemidiscreteOT(3.0, clusters=4, **options)(x0, X1, constant)
    plain = SemidiscreteOT(**options)(x0, X1)
    assert torch.equal(weighed.target_index, plain.target_index)


def test_conditions_far_from_zero_cost_no_precision():
    x0 = torch.randn(24, 2)
    near, far = (SemidiscreteOT(1e6, iterations=20)(x0, X1, c) for c in (C, C + 1e4))
    assert torch.equal(near.target_index, far.target_index)


def test_a_weight_that_drowns_the_samples_is_told():
    with pytest.warns(RuntimeWarning, match="condition_weight"):
        SemidiscreteOT(1e20, iterations=2).fit(X1, C, progress=False)


test_bad_input = refused(
    (lambda: SemidiscreteOT(-1.0), ValueError, "condition_weight must be at least 0"),
    (lambda: SemidiscreteOT(math.inf), ValueError, "condition_weight must be .* finite"),
    (lambda: SemidiscreteOT("much"), TypeError, "condition_weight must be a number"),
    (lambda: SemidiscreteOT(clusters=0), ValueError, "clusters must be at least 1"),
    (lambda: SemidiscreteOT(iterations=0), ValueError, "iterations must be at least 1"),
    (lambda: SemidiscreteOT(1.0).fit(X1), TypeError, "needs the conditions c"),
    (lambda: SemidiscreteOT(clusters=2).fit(X1), TypeError, "needs the conditions c"),
    (lambda: take(SemidiscreteOT(1.0), Dataset(X1), 1), TypeError, "needs the conditions"),
    (lambda: SemidiscreteOT(1.0).fit(X1, C[:5]), ValueError, "c has 5 rows, x1 has 24"),
    (lambda: SemidiscreteOT(1.0).fit(X1, C / 0), ValueError, "c has NaN"),
    (lambda: SemidiscreteOT().fit(X1 / 0), ValueError, "x1 has NaN"),
    (lambda: SemidiscreteOT().fit(X1[:0]), ValueError, "x1 is empty"),
    (lambda: SemidiscreteOT(clusters=25).fit(X1, C), ValueError, "clusters must be at most"),
    (lambda: take(SemidiscreteOT(), mixtures.petals(), 1), TypeError, r"endless.*Dataset"),
)


def test_a_potential_that_has_not_converged_says_so():
    x1 = 3 * torch.randn(2000, 2, generator=seeded())
    with pytest.warns(RuntimeWarning, match="raise iterations above 3"):
        SemidiscreteOT(iterations=3).fit(x1, progress=False)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["petals", "petals given c", "moving modes", "32 dimensions"])
def test_the_default_fit_comes_near_the_floor(name):
    """With 200 draws a row even an exact fit to them would be some 0.03 away."""
    if name == "32 dimensions":
        g = seeded(1)
        centres = 1.5 * torch.randn(8, 32, generator=g)
        x1 = centres[torch.arange(500) % 8] + 0.5 * torch.randn(500, 32, generator=g)
        coupling = SemidiscreteOT().fit(x1, progress=False)
    else:
        data = mixtures.moving_modes() if name == "moving modes" else mixtures.petals()
        x1, c = data.sample(500, generator=seeded(1))
        weight = 0.0 if name == "petals" else 300.0
        coupling = SemidiscreteOT(weight).fit(x1, c, progress=False)
    above_floor = coupling.marginal_error**2 - coupling.marginal_floor**2
    assert math.sqrt(max(0.0, above_floor)) < 0.08


def test_the_default_effort_grows_with_the_rows_and_stays_within_bounds():
    for n in (2000, 8000, 20_000):
        iterations, batch_size = semidiscrete._effort([n])
        assert iterations * batch_size == pytest.approx(200 * n, rel=0.01)
    assert semidiscrete._effort([24]) == (500, 64)
    assert semidiscrete._effort([10**6])[1] == 4096
    iterations, batch_size = semidiscrete._effort([100_000])  # 200 draws would be 2e12 heights
    assert iterations * batch_size * 100_000 == pytest.approx(1e11, rel=0.01)
    iterations, batch_size = semidiscrete._effort([100_000 // 64] * 64)
    assert iterations * batch_size == pytest.approx(200 * 100_000, rel=0.01)


def test_the_last_step_follows_the_spacing_of_the_rows():
    """Rows ten times as dense: steps that are as much smaller. Duplicates do not count."""
    x1 = torch.randn(300, 2, generator=seeded())
    steps, coupling = {}, SemidiscreteOT()
    for name, rows in {"far": x1, "near": x1 / 10, "twice": x1.repeat(2, 1)}.items():
        steps[name] = coupling._steps(semidiscrete._Points(coupling, rows, None), None)
        assert 0 < steps[name][1] < steps[name][0]
    assert steps["near"][1] == pytest.approx(steps["far"][1] / 10, rel=0.3)
    assert steps["twice"][1] == pytest.approx(steps["far"][1], rel=0.5)


@pytest.mark.slow
def test_a_batch_larger_than_the_data_is_stable():
    x1 = torch.randn(3, 2, generator=seeded())
    coupling = SemidiscreteOT(iterations=3000).fit(x1, progress=False)
    assert coupling.marginal_error < coupling.marginal_floor + 0.02


def noise_at_50(n, generator=None):
    return 50 + torch.randn(n, 2, generator=generator)


@pytest.mark.slow
@pytest.mark.parametrize("source", [None, noise_at_50])
def test_a_shift_of_the_data_changes_no_pairing(source):
    """At a mean of 100 the fit kept 15 % of the pairs."""
    x1, z = torch.randn(128, 2, generator=seeded(2)), torch.randn(2048, 2, generator=seeded(1))
    z, found = z + 50 * (source is not None), []
    for shift in (0.0, 100.0, 1000.0):
        coupling = SemidiscreteOT().fit(x1 + shift, source=source, progress=False)
        found.append(coupling._points.search(z, torch.zeros(len(z), dtype=torch.long)))
        assert coupling.marginal_error < coupling.marginal_floor + 0.08
    for one in found[1:]:
        assert (one == found[0]).double().mean() > 0.9


@pytest.mark.parametrize(("data", "noise"), [(0, 1e9), (1e9, 1e9), (1e9, 0), (-1e9, 1e9)])
def test_float64_keeps_rows_far_from_zero_apart(data, noise):
    """In float32 noise at 1e9 of unit deviation had 1 distinct row of 512."""
    x1 = torch.randn(64, 2, generator=seeded(), dtype=torch.float64)

    def pairs(data, noise):
        coupling = SemidiscreteOT(iterations=300)

        def source(n, generator=None):
            return noise + torch.randn(n, 2, generator=generator, dtype=torch.float64)

        return take(coupling, Dataset(x1 + data), 1, batch_size=512, source=source)[0]

    far, plain = pairs(data, noise), pairs(0, 0)
    assert len(far.x0.unique(dim=0)) == 512
    assert (far.target_index == plain.target_index).float().mean() > 0.95


def test_float64_conditions_do_not_merge():
    """A minute costs 3,600, so that each row keeps its own; float32 kept 121 of 256 apart."""
    minutes = 1.76e9 + 60 * torch.arange(256, dtype=torch.float64)[:, None]
    x0, x1 = torch.randn(2, 256, 2, generator=seeded())
    pairs = SemidiscreteOT(1.0, iterations=10)(x0, x1, minutes)
    assert torch.equal(pairs.target_index, torch.arange(256))


def test_equal_data_rows_keep_all_their_conditions():
    """Half of them kept one condition of two."""
    x1 = torch.randn(64, 2, generator=seeded()).repeat(2, 1)
    c = torch.cat([torch.zeros(64, 1), torch.ones(64, 1)])
    pairs = next(SemidiscreteOT().stream(Dataset(x1, c), batch_size=8192, generator=seeded()))
    used = torch.bincount(pairs.target_index, minlength=128).reshape(2, 64)
    assert (used > 0).all()
    assert 0.45 < pairs.c.mean() < 0.55


def test_data_that_were_refilled_are_fitted_again():
    """The coupling compared the tensor with itself, and paired by the potential of other data."""
    x0, x1 = (torch.randn(128, 2, generator=seeded(k)) for k in (0, 1))
    coupling = SemidiscreteOT().fit(x1, progress=False)
    x1.mul_(5).add_(3)
    found = coupling(x0, x1, generator=seeded())
    fresh = SemidiscreteOT()(x0, x1, generator=seeded())
    assert torch.equal(found.target_index, fresh.target_index)
    assert not torch.equal(coupling.state_dict()["x1"], 0 * x1)


def test_an_option_that_changes_after_the_fit_counts():
    x0, x1 = (torch.randn(64, 2, generator=seeded(k)) for k in (0, 1))
    c = torch.randn(64, 1, generator=seeded(2))
    coupling = SemidiscreteOT()
    coupling(x0, x1, c, generator=seeded())
    coupling.condition_weight = 100.0
    found, fresh = (k(x0, x1, c, seeded()) for k in (coupling, SemidiscreteOT(100.0)))
    assert torch.equal(found.target_index, fresh.target_index)


def test_a_source_that_has_changed_is_fitted_again():
    class Noise:
        scale = 1.0

        def __call__(self, n, generator=None):
            return self.scale * torch.randn(n, 2, generator=generator)

    data, noise, coupling = Dataset(torch.randn(100, 2)), Noise(), SemidiscreteOT()
    for scale in (1.0, 5.0):
        noise.scale = scale
        rows = next(coupling.stream(data, batch_size=20_000, source=noise)).target_index
        assert (torch.bincount(rows, minlength=100) / 20_000 - 0.01).abs().sum() / 2 < 0.15
