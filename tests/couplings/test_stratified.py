"""One exact assignment per cluster and epoch."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import linear_sum_assignment
from support import joined, refused, same, seeded, take

from cotlearn import mixtures
from cotlearn.couplings import (
    EmbeddedClusters,
    KMeansCondition,
    PCAKMeansCondition,
    StratifiedOT,
    stratified,
)
from cotlearn.couplings.assignment import exact_permutation
from cotlearn.couplings.base import draw_noise
from cotlearn.couplings.distances import squared_distances
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import prior_skew
from cotlearn.randomness import generator_for


def numbered(n=60, classes=3, seed=0):
    """Rows that can be told apart by x1[:, 0] = row number (divided by n)."""
    g = seeded(seed)
    x1 = torch.cat([torch.arange(n)[:, None] / n, torch.randn(n, 1, generator=g)], dim=1)
    label = torch.randint(classes, (n,), generator=g)
    return Dataset(x1, torch.eye(classes)[label])


def continuous(n=120, seed=0):
    g = seeded(seed)
    c = torch.rand(n, 1, generator=g)
    return Dataset(torch.cat([c, torch.randn(n, 1, generator=g)], dim=1), c)


def cost(x0, x1):
    return float((x0.double() - x1.double()).square().sum())


def test_each_epoch_uses_each_row_once():
    data = numbered()
    batches = take(StratifiedOT(), data, 6)
    for epoch in (batches[:3], batches[3:]):
        used = (joined(epoch, "x1")[:, 0] * 60).round().long()
        assert torch.equal(used.sort().values, torch.arange(60))
        assert torch.equal(data.c[used], joined(epoch, "c"))
    assert not torch.equal(joined(batches[:3], "x1"), joined(batches[3:], "x1"))
    assert len(joined(batches, "x0").unique(dim=0)) == 120  # fresh noise each epoch


def test_noise_in_a_cluster_is_a_permutation_of_fresh_noise():
    """Drawn without looking at the data: so p(x0 | cluster) is the prior, exactly."""
    data = numbered()
    epoch = take(StratifiedOT(), data, 3)
    fresh = draw_noise(data.x1, None, generator_for(seeded(5).initial_seed(), 0))
    x0, c = joined(epoch, "x0"), joined(epoch, "c")
    for condition in torch.eye(3):
        own = (data.c == condition).all(dim=1)
        paired = (c == condition).all(dim=1)
        expected, found = fresh[own], x0[paired]
        assert torch.equal(expected[expected[:, 0].argsort()], found[found[:, 0].argsort()])


@pytest.mark.parametrize("clusters", [None, 2, KMeansCondition(3)])
def test_the_plan_of_each_cluster_is_optimal(clusters):
    data = numbered() if clusters is None else continuous()
    coupling = StratifiedOT(clusters)
    x0 = torch.randn(len(data), 2, generator=seeded(1))
    pairs = coupling(x0, data.x1, data.c, generator=seeded())
    label = data.c.argmax(dim=1) if clusters is None else coupling.clusters.labels(data.c)
    assert len(label.unique()) > 1
    assert torch.equal(label[pairs.source_index], label[pairs.target_index])
    assert torch.equal(pairs.target_index.sort().values, torch.arange(len(data)))
    for k in label.unique():
        rows = label == k
        matrix = squared_distances(x0[rows], data.x1[rows])
        best = matrix[linear_sum_assignment(matrix)].sum()
        mine = rows[pairs.source_index]
        assert cost(pairs.x0[mine], pairs.x1[mine]) == pytest.approx(best, rel=1e-9)


CONSTANT = Dataset(torch.randn(40, 2, generator=seeded()), torch.full((40, 1), 0.1))


@pytest.mark.parametrize(("clusters", "data"), [(1, continuous()), (None, CONSTANT), (4, CONSTANT)])
def test_one_cluster_is_plain_ot(clusters, data):
    x0 = torch.randn(len(data), 2, generator=seeded(1))
    pairs = StratifiedOT(clusters)(x0, data.x1, data.c, generator=seeded())
    matrix = squared_distances(x0, data.x1)
    assert cost(pairs.x0, pairs.x1) == pytest.approx(matrix[linear_sum_assignment(matrix)].sum())


def test_large_clusters_are_cut_into_even_parts_of_at_most_rows_per_solve():
    data = numbered(200, classes=2)
    coupling = StratifiedOT(rows_per_solve=32)
    label, _ = coupling._clustered(data.x1, data.c)
    parts = list(coupling._solves(label, np.random.default_rng(0)))
    assert sorted(np.concatenate(parts)) == list(range(200))
    sizes = np.bincount(label)
    for k in (0, 1):
        mine = [len(part) for part in parts if label[part[0]] == k]
        assert len(mine) == math.ceil(sizes[k] / 32)
        assert max(mine) - min(mine) <= 1
        assert max(mine) <= 32
    assert all(len(set(label[part])) == 1 for part in parts)
    x0 = torch.randn(200, 2, generator=seeded(1))
    cut = coupling(x0, data.x1, data.c, generator=seeded())
    whole = StratifiedOT()(x0, data.x1, data.c, generator=seeded())
    assert cost(whole.x0, whole.x1) < cost(cut.x0, cut.x1) < cost(x0, data.x1)
    average = sum(len(part) ** 2 for part in parts) / 200
    assert coupling.candidates(x0, data.x1, data.c) == pytest.approx(average, rel=0.02)


def test_clusters_of_one_member_pair_with_themselves():
    data = continuous(30)
    x0 = torch.randn(30, 2)
    pairs = StratifiedOT()(x0, data.x1, data.c)  # None: every condition differs
    assert torch.equal(pairs.target_index, pairs.source_index)
    one = Dataset(torch.randn(8, 2), torch.tensor([[0.0]] * 7 + [[100.0]]))
    assert StratifiedOT(2)(torch.randn(8, 2), one.x1, one.c).target_index[7] == 7
    assert take(StratifiedOT(2), one, 2, batch_size=4)[0].x1.shape == (4, 2)


def test_duplicate_rows_are_all_used():
    twice = numbered(20)
    data = Dataset(twice.x1.repeat(2, 1), twice.c.repeat(2, 1))
    used = (joined(take(StratifiedOT(), data, 2), "x1")[:, 0] * 20).round().long()
    assert torch.bincount(used).tolist() == [2] * 20


@pytest.mark.parametrize("dtype", [torch.int64, torch.bool])
def test_integer_and_bool_conditions(dtype):
    data = numbered()
    x0 = torch.randn(60, 2)
    expected = StratifiedOT()(x0, data.x1, data.c)
    for clusters in (None, 3):
        pairs = StratifiedOT(clusters)(x0, data.x1, data.c.to(dtype))
        assert torch.equal(pairs.target_index, expected.target_index)
        assert pairs.c.dtype == dtype
    assert len(take(StratifiedOT(3), Dataset(data.x1, data.c.to(dtype)), 2)) == 2


def test_a_condition_of_another_scale_makes_the_same_clusters():
    g = seeded()
    c = torch.randn(200, 2, generator=g)
    x1, x0 = torch.randn(200, 2, generator=g), torch.randn(200, 2, generator=g)
    plain = StratifiedOT(6)(x0, x1, c, generator=seeded())
    scaled = StratifiedOT(6)(x0, x1, c * torch.tensor([1.0, 1e4]), generator=seeded())
    assert torch.equal(plain.target_index, scaled.target_index)


def test_the_prior_is_not_skewed_on_labels():
    flagged = []
    for seed in range(5):
        coupling = StratifiedOT(n_samples=1000)
        batch = take(coupling, mixtures.petals(), 1, batch_size=1000, generator=seeded(seed))[0]
        flagged.append(prior_skew(batch.x0, batch.c, generator=seeded(seed)).flagged)
    assert sum(flagged) == 0


def test_coarse_clusters_on_a_moving_condition_are_skewed_inside():
    """What the docstring says: inside a cluster x0 still depends on c."""
    coupling = StratifiedOT(2, n_samples=1000)
    batch = take(coupling, mixtures.moving_modes(), 1, batch_size=1000)[0]
    assert prior_skew(batch.x0, batch.c, generator=seeded()).flagged


def test_endless_data_need_an_epoch():
    with pytest.raises(TypeError, match=r"endless.*n_samples"):
        take(StratifiedOT(), mixtures.petals(), 1)
    coupling = StratifiedOT(n_samples=60)
    x1 = joined(take(coupling, mixtures.petals(), 6), "x1")
    assert len(x1.unique(dim=0)) == 120  # drawn afresh
    epoch = mixtures.petals().sample(60, generator=generator_for(5, 0))[0]
    assert torch.equal(x1[:60][x1[:60, 0].argsort()], epoch[epoch[:, 0].argsort()])


def test_data_smaller_than_the_batch_put_epochs_together():
    data = numbered(12)
    batches = take(StratifiedOT(), data, 3, batch_size=30)
    for batch in batches:
        assert len(batch) == 30
        used = torch.bincount((batch.x1[:, 0] * 12).round().long(), minlength=12)
        assert used.sum() == 30
        assert used.max() <= 3  # three epochs
        assert used.min() >= 0
    assert len(joined(batches, "x0").unique(dim=0)) == 90


@pytest.mark.parametrize("clusters", [None, 4])
@pytest.mark.parametrize("batch_size", [20, 25, 60, 130])
def test_a_stream_resumes_where_it_stopped(clusters, batch_size):
    data = numbered()
    whole = take(StratifiedOT(clusters), data, 8, batch_size=batch_size)
    for start in (1, 2, 3, 5):
        part = take(StratifiedOT(clusters), data, 3, batch_size=batch_size, start=start)
        assert all(map(same, part, whole[start:]))
    assert not same(whole[0], whole[1])


def test_a_coupling_that_was_used_before_gives_the_same_numbers():
    """Clusters of one's own are fitted to the data of the stream, not to those of the last one."""
    fresh = take(StratifiedOT(4), continuous(), 3)
    used = StratifiedOT(4)
    take(used, continuous(seed=8), 2)
    assert all(map(same, fresh, take(used, continuous(), 3)))


def test_clusters_that_were_fitted_stay_as_they_are():
    fitted = KMeansCondition(3).fit(continuous(seed=8).c)
    centroids = fitted.centroids.clone()
    take(StratifiedOT(fitted), continuous(), 2)
    assert torch.equal(fitted.centroids, centroids)


def test_clusters_are_saved_with_a_training():
    coupling = StratifiedOT(4)
    before = take(coupling, continuous(), 3)
    again = StratifiedOT(4)
    again.load_state_dict(coupling.state_dict())
    assert torch.equal(again.clusters.centroids, coupling.clusters.centroids)
    assert all(map(same, before, take(again, continuous(), 3)))
    assert StratifiedOT().state_dict() == {}


def test_pictures_as_conditions():
    g = seeded()
    c = torch.randn(100, 16, generator=g)
    data = Dataset(torch.randn(100, 2, generator=g), c)
    batches = take(StratifiedOT(PCAKMeansCondition(components=3, clusters=5)), data, 5)
    assert len(joined(batches, "x1").unique(dim=0)) == 100


def test_a_source_of_ones_own():
    def uniform(n, generator=None):
        return torch.rand(n, 2, generator=generator)

    x0 = joined(take(StratifiedOT(), numbered(), 3, source=uniform), "x0")
    assert (x0.min() >= 0) & (x0.max() <= 1)
    with pytest.raises(ValueError, match=r"source.* must have shape \(60, 2\)"):
        take(StratifiedOT(), numbered(), 1, source=lambda n, generator=None: torch.rand(n, 3))


X1 = numbered().x1
test_bad_input = refused(
    (lambda: take(StratifiedOT(61), numbered(), 1), ValueError, "clusters must be at most the 60"),
    (lambda: StratifiedOT(0), ValueError, "clusters must be at least 1"),
    (lambda: StratifiedOT(2.5), TypeError, "clusters must be an integer"),
    (lambda: StratifiedOT(rows_per_solve=1), ValueError, "rows_per_solve must be at least"),
    (lambda: StratifiedOT(rows_per_solve=5000), ValueError, "rows_per_solve must be at most"),
    (lambda: StratifiedOT(n_samples=0), ValueError, "n_samples must be at least 1"),
    (lambda: take(StratifiedOT(), Dataset(X1), 1), TypeError, "needs the conditions c"),
    (lambda: take(StratifiedOT(2), Dataset(X1), 1), TypeError, "needs the conditions c"),
    (lambda: StratifiedOT()(X1, X1), TypeError, "needs the conditions c"),
)


# --- residuals ------------------------------------------------------------------------------------


def following(n=4000, seed=0):
    """x1 follows c steeply, with a spread of its own."""
    g = seeded(seed)
    c = torch.rand(n, 2, generator=g)
    x1 = 8 * c + torch.randn(n, 2, generator=g)
    return Dataset(x1, c)


def dependence(pairs):
    """R^2 of a quadratic regression of x0 on c, and the correlation of x0 with x1 - E[x1 | c]."""
    c = pairs.c.double()
    design = torch.stack([c[:, 0] ** a * c[:, 1] ** b for a in range(5) for b in range(5)], dim=1)
    weights = torch.linalg.lstsq(design, pairs.x0.double()).solution
    explained = float((design @ weights).var() / pairs.x0.var())
    own = pairs.x1.double() - 8 * c
    return explained, float((pairs.x0.double() * own).mean() / own.std() / pairs.x0.std())


def test_residuals_leave_less_dependence_and_straighten_as_much():
    data = following()
    x0 = torch.randn(4000, 2, generator=seeded(1))
    plain = dependence(StratifiedOT(16)(x0, data.x1, data.c, generator=seeded(2)))
    left = dependence(StratifiedOT(16, residual=True)(x0, data.x1, data.c, generator=seeded(2)))
    assert left[0] < 0.2 * plain[0]
    assert left[1] > plain[1]


@pytest.mark.parametrize("copied", [1, 2])
@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3])
def test_residuals_of_data_that_are_all_but_linear_do_not_tell_the_condition(noise, copied):
    c = torch.randn(512, 2, generator=seeded(1))
    slopes = torch.tensor([[1.0, 0.3], [-0.2, 2.0]])
    x1 = c @ slopes + noise * torch.randn(512, 2, generator=seeded(2))
    x1[:, copied:] = torch.randn(512, 2 - copied, generator=seeded(3))
    data = Dataset(x1, c)
    batches = take(StratifiedOT(1, residual=True), data, 40, batch_size=256)
    x0, c = joined(batches, "x0"), joined(batches, "c")
    assert np.abs(np.corrcoef(x0.T, c.T)[:2, 2:]).max() < 0.06  # a penalty leaves above .5


def switch(rows=2048, width=0.0):
    """Two modes at -1 and 1, and a condition that tells nothing of them."""
    mode = 2.0 * torch.randint(2, (rows, 1), generator=seeded(1)) - 1
    values = mode + width * torch.randn(rows, 1, generator=seeded(2))
    return Dataset(values, torch.randn(rows, 1, generator=seeded(3)))


def explained_of(coupling, data):
    """The share of the noise's variance that lines in c explain inside the clusters."""
    pairs = next(coupling.stream(data, batch_size=len(data), generator=seeded(4)))
    label = KMeansCondition(coupling.clusters.clusters).fit(data.c).labels(pairs.c).numpy()
    x0, c = (value.numpy().astype(float)[:, 0] for value in (pairs.x0, pairs.c))
    left = total = 0.0
    for cluster in np.flatnonzero(np.bincount(label) > 8):
        noise, z = x0[label == cluster], c[label == cluster]
        left += np.square(noise - np.polyval(np.polyfit(z, noise, 1), z)).sum()
        total += len(noise) * noise.var()
    return 1 - left / total


def test_a_switch_is_not_sorted_by_the_condition():
    """The errors of slopes, about 0, sorted equal values: c explained a quarter of the noise."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert explained_of(StratifiedOT(16, residual=True), switch()) < 0.03


def test_values_repeated_with_their_condition_keep_their_residuals():
    data = following(1000)
    twice = Dataset(data.x1.repeat(3, 1), data.c.repeat(3, 1))
    found = stratified._take_few_values(twice.x1.numpy(), twice.c.numpy())
    assert not found.any()
    levels = Dataset(twice.x1.round(), twice.c)
    assert stratified._take_few_values(levels.x1.numpy(), levels.c.numpy()).all()


def test_narrow_modes_that_are_sorted_by_the_condition_are_said():
    coupling = StratifiedOT(32, residual=True)
    with pytest.warns(UserWarning, match=r"c explains 1\d% of column 0 .* although residual=True"):
        assert explained_of(coupling, switch(width=0.05)) > 0.08
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert explained_of(coupling, switch(width=1.0)) < 0.04


def test_a_constant_column_of_the_noise_hides_no_other():
    """As of padded actions: 0 / 0 was the largest share, and nothing was said."""
    data = switch(1024, width=0.05)
    x0 = torch.randn(1024, 2, generator=seeded()) * torch.tensor([1.0, 0.0])
    wide = torch.cat([data.x1, torch.zeros(1024, 1)], dim=1)
    with pytest.warns(UserWarning, match="of column 0 of the noise"):
        StratifiedOT(16, residual=True)(x0, wide, data.c, generator=seeded())


def test_a_class_in_the_place_of_clusters_is_no_number():
    with pytest.raises(TypeError, match="clusters must be"):
        StratifiedOT(KMeansCondition)


def test_an_embedding_that_collapsed_is_said():
    clusters = EmbeddedClusters(torch.zeros_like, KMeansCondition(1))
    with pytest.warns(UserWarning, match="the same for all conditions"):
        clusters.fit(torch.randn(40, 2))


def test_residuals_do_not_depend_on_the_units_of_the_condition():
    """Below a deviation of 1e-12 they were those of no regression."""
    data = following(400)
    tiny = Dataset(data.x1, 1e-14 * data.c)
    one, other = (take(StratifiedOT(5, residual=True), each, 3) for each in (data, tiny))
    assert all(torch.equal(a.x1, b.x1) for a, b in zip(one, other, strict=True))


def test_residuals_change_nothing_where_each_condition_is_a_cluster():
    data = numbered()
    batches = take(StratifiedOT(), data, 3)
    assert all(map(same, batches, take(StratifiedOT(residual=True), data, 3)))


def test_residuals_keep_the_data_as_they_are():
    data = following(200)
    batches = take(StratifiedOT(5, residual=True), data, 20)
    for first in (0, 10):
        epoch = batches[first : first + 10]
        assert torch.equal(joined(epoch, "x1").sort(dim=0).values, data.x1.sort(dim=0).values)


@pytest.mark.parametrize("clusters", [60, 119, 120])
def test_residuals_of_clusters_with_few_rows(clusters):
    data = continuous()
    batch = take(StratifiedOT(clusters, residual=True), data, 1)[0]
    assert torch.isfinite(batch.x1).all()


# --- nothing stale ---


def strata(c, coupling):
    return len(coupling.clusters.labels(c).unique())


@pytest.mark.filterwarnings("ignore:StratifiedOT was called")
def test_buffers_that_are_refilled_in_place_are_paired_anew():
    """A cache by identity left 27 % of the pairs within their condition."""
    x0, x1, c = torch.randn(64, 2), torch.randn(64, 2), torch.eye(4)[torch.arange(64) % 4]
    coupling = StratifiedOT()
    coupling(x0, x1, c)
    c.numpy()[:] = c.flip(0).roll(3, 0).numpy()[torch.randperm(64, generator=seeded())]
    assert torch.equal(c[coupling(x0, x1, c).target_index], c)
    k_means = StratifiedOT(8)
    k_means(x0, x1, torch.randn(64, 3))
    new = 10 * torch.randn(64, 3) + 100
    k_means(x0, x1, new)
    assert strata(new, k_means) == 8  # all in one stratum would be naive OT


def test_a_data_set_that_changes_during_a_stream_is_clustered_anew():
    data = Dataset(torch.randn(64, 2), torch.eye(4)[torch.arange(64) % 4])
    stream = StratifiedOT().stream(data, batch_size=64)
    next(stream)
    data.c.copy_(data.c.roll(1, 0).flip(0))
    pairs = next(stream)
    assert torch.equal(pairs.c[pairs.source_index.argsort()], data.c)


def test_clusters_follow_the_data_after_a_resume_and_after_replace():
    """They stayed, and put new data into one stratum: naive OT, unannounced."""
    old, new = continuous(), continuous(seed=8)
    new = Dataset(new.x1, 10 * new.c + 100)
    trained = StratifiedOT(8)
    take(trained, old, 1)
    resumed = StratifiedOT(8)
    resumed.load_state_dict(trained.state_dict())
    for coupling in (resumed, replace(trained, rows_per_solve=64)):
        take(coupling, new, 1)
        assert strata(new.c, coupling) == 8
        assert strata(old.c, trained) == 8  # of its own
    loaded = StratifiedOT(8)
    loaded.load_state_dict(trained.state_dict())
    loaded.clusters.fit = None  # the same data need no fit
    take(loaded, old, 1)
    given = StratifiedOT(KMeansCondition(4))
    take(given, old, 1)
    take(given, new, 1)
    assert strata(new.c, given) == 4


def test_a_condition_for_each_row_is_said_and_takes_no_time():
    """Each was a plan of its own: a million rows took minutes an epoch."""
    data = Dataset(torch.randn(1200, 2), torch.arange(1200.0)[:, None])
    coupling = StratifiedOT()
    words = "clusters is None, and 1200 of 1200 conditions differ.*StratifiedOT.18. has about 64"
    with pytest.warns(UserWarning, match=words):
        pairs = take(coupling, data, 2)[1]
    assert not list(coupling._solves(np.arange(1200), np.random.default_rng(0)))
    assert torch.equal(pairs.source_index, pairs.target_index)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("offset", [0.0, 100.0])
def test_tiny_clusters_are_paired_optimally(dtype, offset):
    """All permutations of at most four rows are tried, of thousands of clusters at once."""
    g = seeded()
    c = torch.randint(300, (900, 1), generator=g).to(dtype)
    x0, x1 = (torch.randn(900, 3, generator=g, dtype=dtype) for _ in range(2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pairs = StratifiedOT()(x0, x1 + offset, c, generator=g)
    assert torch.equal(pairs.c[pairs.target_index.argsort()], c)
    cost = (pairs.x0 - (pairs.x1 - offset)).square().sum(dim=1)
    for label in c.unique():
        rows = (c == label)[:, 0]
        costs = torch.cdist(x0[rows], x1[rows]).square().numpy()
        least = costs[linear_sum_assignment(costs)].sum()
        found = cost[(pairs.c == label)[:, 0]].sum()
        assert found == pytest.approx(least, rel=1e-3 if dtype == torch.float32 else 1e-9)


@pytest.mark.slow
def test_very_many_tiny_clusters_are_said_and_take_seconds(monkeypatch):
    """Each cluster was an assignment of its own: 30,000 of them took fifteen seconds."""
    solved, g = [], seeded()
    c = torch.randint(50_000, (100_000, 1), generator=g).double()
    data = Dataset(torch.randn(100_000, 2, generator=g), c)

    def counted(cost):
        solved.append(len(cost))
        return exact_permutation(cost)

    monkeypatch.setattr(stratified, "exact_permutation", counted)
    with pytest.warns(UserWarning, match=r"43\d+ of 100000 conditions differ.* number of clusters"):
        next(StratifiedOT().stream(data, batch_size=256, generator=g))
    assert 1000 < len(solved) < 4000
    assert min(solved) == 5


def test_one_row_is_one_row():
    """Before, the warning said 1 rows."""
    with pytest.warns(UserWarning, match="called with 1 row, of which it makes its clusters"):
        StratifiedOT()(*torch.zeros(3, 1, 2))


@pytest.mark.parametrize("rows", [128, 500])
def test_few_rows_of_numbers_are_said_to_be_paired_at_random(rows):
    """Below 1,000 rows nothing was said, and the pairs were independent."""
    x1, c = (torch.randn(rows, 2, generator=seeded(k)) for k in (0, 1))
    with pytest.warns(UserWarning, match=rf"paired at random; .* StratifiedOT\({rows // 64}\)"):
        next(StratifiedOT().stream(Dataset(x1, c), batch_size=64, generator=seeded()))


@pytest.mark.filterwarnings("ignore:StratifiedOT was called")
def test_a_refilled_buffer_does_not_change_what_was_kept():
    """x1 was kept beside the digest of its former content."""
    x0, x1 = (torch.randn(256, 2, generator=seeded(k)) for k in (0, 1))
    c, same, coupling = torch.eye(2)[torch.arange(256) % 2], x1.clone(), StratifiedOT()
    before = coupling(x0, x1, c, generator=seeded())
    x1.normal_()
    after = coupling(x0, same, c, generator=seeded())
    assert torch.equal(before.target_index, after.target_index)


@pytest.mark.filterwarnings("ignore:StratifiedOT was called")
def test_an_option_that_changes_after_a_call_counts():
    x0, x1 = (torch.randn(256, 2, generator=seeded(k)) for k in (0, 1))
    c = torch.randn(256, 1, generator=seeded(2))
    x1[:, :1] += 3 * c
    coupling = StratifiedOT(4)
    coupling(x0, x1, c, generator=seeded())
    coupling.residual = True
    found, fresh = (k(x0, x1, c, seeded()) for k in (coupling, StratifiedOT(4, residual=True)))
    assert torch.equal(found.target_index, fresh.target_index)


def test_rows_per_solve_that_are_set_later_are_checked():
    coupling = StratifiedOT(2)
    coupling.rows_per_solve = 1
    with pytest.raises(ValueError, match="rows_per_solve must be at least 2"):
        coupling(torch.zeros(4, 2), torch.zeros(4, 2), torch.eye(4))


def test_data_that_draw_their_own_rows_are_named():
    class Jittered(Dataset):
        def sample(self, n, generator=None):
            return super().sample(n, generator)

    data = Jittered(torch.randn(40, 2), torch.eye(2)[torch.arange(40) % 2])
    with pytest.warns(UserWarning, match="does not call Jittered.sample"):
        next(StratifiedOT().stream(data, batch_size=8))


def test_an_encoder_that_was_trained_is_fitted_again():
    c = torch.randn(1000, 2)
    encoder = torch.nn.Linear(2, 2)
    coupling = StratifiedOT(EmbeddedClusters(encoder, KMeansCondition(16)))
    data, found = Dataset(c.clone(), c), []
    for factor in (1.0, 0.02):
        encoder.weight.data = factor * torch.eye(2)
        pairs = next(coupling.stream(data, batch_size=1000))
        found.append(float(torch.stack([pairs.x0[:, 0], pairs.c[:, 0]]).corrcoef()[0, 1] ** 2))
    assert max(found) < 0.3  # 0.9 where the clusters were kept
