"""What the coupling sees of a condition, against numpy and brute force."""

import copy
import math
import os
import subprocess
import sys
import warnings

import numpy as np
import pytest
import torch
from support import refused, seeded

from cotlearn.couplings import ConditionalOT, StratifiedOT, combine, conditions
from cotlearn.couplings.conditions import EmbeddedClusters, KMeansCondition, PCAKMeansCondition
from cotlearn.datasets import Standardiser
from cotlearn.storage import load_tensors, save_tensors


def rows(n=400, k=3, seed=0):
    scale = torch.tensor([1.0, 1e4, 1e-3])[:k]
    return scale * torch.randn(n, k, generator=seeded(seed)) + 5 * scale


def mean_squared_distance(c):
    return float((c[:, None] - c[None]).square().sum(dim=2).mean())


def nearest(points, centroids):
    """The definition, in float64."""
    distances = ((points.double()[:, None] - centroids.double()[None]) ** 2).sum(dim=2)
    return distances.argmin(dim=1)


@pytest.mark.parametrize("n", [1, 3, 10, 1000, 1797])
@pytest.mark.parametrize("value", [0.0, 0.1, 1 / 3, -2.3, 1e4 + 0.1])
def test_constant_columns_become_zero_in_spite_of_rounding(n, value):
    c = torch.full((n, 2), value)
    fitted = KMeansCondition(1).fit(c)
    assert (fitted(c) == 0).all()
    assert (fitted.project(c + 1) == 0).all()


def test_integers_and_bools_are_numbers():
    c = torch.tensor([[0, 1], [2, 1], [4, 1]])
    assert torch.allclose(combine({"c": c})[:, 0], torch.tensor([-1.0, 0.0, 1.0]) * math.sqrt(1.5))
    assert KMeansCondition(2).fit(c[:, :1] > 1).labels(c[:, :1] > 1).unique().tolist() == [0, 1]


def test_strata_keep_the_weights_of_combine_if_they_are_told_to():
    pose, goal = (torch.randn(4096, k, generator=seeded(k)) for k in (3, 1))

    def spread_of_goal(weight, **options):
        c = combine({"pose": pose, "goal": goal}, {"goal": weight})
        label = KMeansCondition(64, **options).fit(c).labels(c)
        means = torch.stack([goal[label == k].mean() for k in range(64)])
        return float((goal[:, 0] - means[label]).var())

    assert spread_of_goal(400.0) == pytest.approx(spread_of_goal(1.0), rel=1e-3)
    light, heavy = (spread_of_goal(w, standardise=False) for w in (1.0, 400.0))
    assert heavy < 0.02 < light


def test_combine_gives_each_condition_its_weight_whatever_its_scale():
    pose, goal = rows(k=3), rows(k=2, seed=1)
    together = combine({"pose": pose, "goal": goal}, {"goal": 9.0})
    assert together.shape == (400, 5)
    assert mean_squared_distance(together[:, :3]) == pytest.approx(2, rel=1e-3)
    assert mean_squared_distance(together[:, 3:]) == pytest.approx(18, rel=1e-3)
    assert (combine({"pose": pose, "goal": goal}, {"goal": 0})[:, 3:] == 0).all()


def test_constant_columns_take_nothing_from_the_weight_of_the_others():
    image = torch.cat([rows(k=2), torch.ones(400, 6)], dim=1)  # a dark border, for instance
    assert mean_squared_distance(combine({"image": image})) == pytest.approx(2, rel=1e-3)
    assert (combine({"nothing": torch.ones(4, 2)}) == 0).all()


def test_a_cluster_is_the_nearest_centroid():
    c = rows(600)
    fitted = KMeansCondition(12, seed=3).fit(c)
    assert fitted.centroids.shape == (12, 3)
    label = fitted.labels(c)
    assert torch.equal(label, nearest(Standardiser.fit(c)(c), fitted.centroids))
    assert torch.equal(fitted(c), fitted.centroids[label])
    new = rows(50, seed=9)  # in the units of the training set, not of the new rows
    assert torch.equal(fitted.labels(new), nearest(Standardiser.fit(c)(new), fitted.centroids))


def test_scale_of_a_column_does_not_matter():
    """The second column is 10^7 times the third; clusters split all alike."""
    c = rows(600)
    scaled = c * torch.tensor([1.0, 1e-4, 1e3])
    assert torch.equal(
        KMeansCondition(8).fit(c).labels(c), KMeansCondition(8).fit(scaled).labels(scaled)
    )


def test_few_distinct_conditions_get_a_cluster_each():
    """Also where they lie close together (float32 distances by matrix product mix them up)."""
    base = torch.randn(60, 8, generator=seeded())
    c = torch.cat([base, base[:4] + 1e-4]).repeat(4, 1)
    label = KMeansCondition(64).fit(c).labels(c)
    expected = torch.arange(64).repeat(4)
    assert len(set(zip(label.tolist(), expected.tolist(), strict=True))) == 64
    assert len(label.unique()) == 64


def test_k_means_is_as_good_as_it_should_be():
    centres = torch.tensor([[-9.0, 0.0], [0.0, 9.0], [9.0, 0.0], [0.0, -9.0]])
    truth = torch.arange(4).repeat(50)
    c = centres[truth] + torch.randn(200, 2, generator=seeded())
    label = KMeansCondition(4).fit(c).labels(c)
    assert len(set(zip(label.tolist(), truth.tolist(), strict=True))) == 4


def pixels(n=300, seed=0, brightness=0.0):
    """Images of 6 pixels that vary in two directions, and one column of proprioception."""
    g = seeded(seed)
    basis = torch.linalg.qr(torch.randn(6, 6, generator=seeded(99)))[0]
    scores = torch.randn(n, 6, generator=g) * torch.tensor([4.0, 2.0, 0.1, 0.1, 0.1, 0.1])
    return torch.cat([scores @ basis.T + 3 + brightness, torch.randn(n, 1, generator=g)], dim=1)


def test_pca_against_the_singular_value_decomposition():
    c = pixels()
    fitted = PCAKMeansCondition(pixels=6, components=2, clusters=10).fit(c)
    images = c[:, :6].double().numpy()
    _, _, axes = np.linalg.svd(images - images.mean(axis=0), full_matrices=False)
    expected = (images - images.mean(axis=0)) @ axes[:2].T
    projected = fitted.project(c).double().numpy()
    assert projected.shape == (300, 3)
    np.testing.assert_allclose(np.abs(projected[:, :2]), np.abs(expected), atol=1e-4)
    assert torch.equal(fitted.project(c)[:, 2], c[:, 6])  # proprioception, unscaled
    label = fitted.labels(c)
    centroids = fitted.state_dict()["centroids"]
    assert torch.equal(label, nearest(fitted.project(c), centroids))
    assert torch.equal(fitted(c), centroids[label])


def test_pca_is_centred_by_the_training_mean_and_not_by_the_batch():
    """The published code centres each batch by itself, so a row's condition hangs on the others."""
    c = pixels()
    fitted = PCAKMeansCondition(components=2, clusters=5).fit(c)
    assert torch.allclose(fitted.project(c[:7]), fitted.project(c)[:7], atol=1e-5)
    bright = fitted.project(pixels(brightness=2.0)).mean(dim=0)
    assert bright.norm() > 0.1  # a batch centred by itself would have mean 0
    assert torch.allclose(fitted.state_dict()["mean"], c.mean(dim=0), atol=1e-5)


@pytest.mark.parametrize(
    "make", [lambda: KMeansCondition(7), lambda: PCAKMeansCondition(components=2, clusters=7)]
)
def test_what_was_fitted_is_saved_with_the_weights(make, tmp_path):
    c = pixels()
    fitted = make().fit(c)
    save_tensors(tmp_path / "c.safetensors", fitted.state_dict(), {})
    again = make()
    with pytest.raises(ValueError, match="not fitted"):
        again(c)
    with pytest.raises(ValueError, match="not fitted"):
        again.labels(c)
    again.load_state_dict(load_tensors(tmp_path / "c.safetensors")[0])
    assert torch.equal(again(c), fitted(c))
    assert torch.equal(again.labels(c), fitted.labels(c))


def test_the_same_seed_gives_the_same_clusters():
    c = rows()
    assert torch.equal(KMeansCondition(9).fit(c)(c), KMeansCondition(9).fit(c)(c))


def pca(clusters=2, **options):
    return PCAKMeansCondition(clusters=clusters, **options).fit(C)


TINY = torch.stack([torch.arange(10) % 2, (torch.arange(10) % 5).double() * 1e-200], dim=1)
C, INNER = torch.randn(10, 3), KMeansCondition(2)


test_bad_input = refused(
    (lambda: KMeansCondition(4, standardise="no"), TypeError, "standardise must be True or False"),
    (lambda: combine({}), ValueError, "conditions is empty"),
    (lambda: combine({"a": C}, {"b": 1.0}), ValueError, r"weights has unknown names \['b'\]"),
    (lambda: combine({"a": C}, {"a": -1.0}), ValueError, r"weights\['a'\] must be at least 0"),
    (lambda: combine({"a": C}, {"a": math.inf}), ValueError, r"weights\['a'\].*finite"),
    (lambda: combine({"a": C.half()}, {"a": 1e12}), ValueError, r"weights\['a'\] is 1e\+12, too"),
    (lambda: KMeansCondition(4).fit(TINY), ValueError, "values up to 4e-200 in column 1"),
    (lambda: combine({"a": C, "b": C[:4]}), ValueError, "b has 4 rows, a has 10"),
    (lambda: combine({"pose": C / 0}), ValueError, "pose has NaN or infinite"),
    (lambda: KMeansCondition(0), ValueError, "clusters must be at least 1"),
    (lambda: KMeansCondition(2.0), TypeError, "clusters must be an integer"),
    (lambda: KMeansCondition(11).fit(C), ValueError, "clusters must be at most the 10 rows"),
    (lambda: KMeansCondition(2).fit(C).labels(C[:, :2]), ValueError, "c has 2 columns"),
    (lambda: KMeansCondition(2).centroids, ValueError, r"KMeansCondition\(clusters=2.*fit"),
    (lambda: pca(components=4), ValueError, "components must be at most 3 for this c"),
    (lambda: pca(11, components=2), ValueError, "clusters must"),
    (lambda: pca(pixels=4), ValueError, "pixels is 4, but c has only 3"),
    (lambda: pca(components=2)(C[:, :2]), ValueError, "pixels of c has 2 columns, expected 3"),
    (lambda: PCAKMeansCondition().labels(C), ValueError, "not fitted"),
    (lambda: EmbeddedClusters(3, INNER), TypeError, "embed must be a function"),
    (lambda: EmbeddedClusters(abs, INNER, rows=0), ValueError, "rows must be at least 1"),
    (lambda: EmbeddedClusters(abs, INNER).labels(C), ValueError, "not fitted"),
)


def test_components_far_from_0():
    c = torch.randn(300, 6, generator=seeded()).double() * torch.tensor([5.0, 3, 2, 1, 0.5, 0.2])
    near, far = (
        PCAKMeansCondition(components=3, clusters=5).fit(c + at).project(c + at) for at in (0, 1e9)
    )
    assert torch.allclose(near.var(dim=0), far.var(dim=0), rtol=1e-4)


def test_clusters_of_pixels_are_the_same_under_autocast():
    c = torch.randn(500, 64, generator=seeded())
    fitted = PCAKMeansCondition(components=8, clusters=40).fit(c)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(fitted.project(c), fitted.project(c.clone()))
        labels = fitted.labels(c)
    assert torch.equal(labels, fitted.labels(c))


# --- clusters of a view ------------------------------------------------------------------------


def test_clusters_of_a_view_are_clusters_of_what_it_shows():
    c = rows(k=2)
    both = EmbeddedClusters(torch.Tensor.square, KMeansCondition(5), rows=10_000).fit(c)
    direct = KMeansCondition(5).fit(c.square())
    assert torch.equal(both.labels(c), direct.labels(c.square()))
    assert torch.equal(both(c), direct(c.square()))
    copied = EmbeddedClusters(torch.Tensor.square, KMeansCondition(5))
    copied.load_state_dict(both.state_dict())
    assert torch.equal(copied.labels(c), both.labels(c))


def test_few_rows_are_viewed_to_fit_and_all_of_them_in_parts(monkeypatch):
    seen = []

    def view(c):
        seen.append(len(c))
        return c

    def fitted():
        inner = PCAKMeansCondition(components=2, clusters=4)
        return EmbeddedClusters(view, inner, rows=100).fit(rows())

    both = fitted()
    assert seen == [100]
    monkeypatch.setattr(conditions, "ROWS_AT_ONCE", 150)
    assert both.labels(rows()).shape == (400,)
    assert seen[1:] == [150, 150, 100]
    assert torch.equal(both(rows()), fitted()(rows()))


def test_a_view_in_the_couplings():
    c = rows(k=2)
    x0, x1 = torch.randn(400, 2, generator=seeded(1)), torch.randn(400, 2, generator=seeded(2))
    seen = EmbeddedClusters(torch.Tensor.square, KMeansCondition(4)).fit(c)
    label = seen.labels(c)
    pairs = ConditionalOT(math.inf, condition=seen)(x0, x1, c, generator=seeded())
    assert torch.equal(pairs.c, c[pairs.target_index])
    pairs = StratifiedOT(seen)(x0, x1, c, generator=seeded())
    assert torch.equal(label[pairs.source_index], label[pairs.target_index])
    assert "EmbeddedClusters(" in repr(StratifiedOT(seen))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_labels_of_many_rows_leave_no_holes_in_the_heap():
    code = """
import re, sklearn.cluster, torch
from cotlearn.couplings import KMeansCondition

def own_mb():
    return int(re.search(r"RssAnon:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024

KMeans = sklearn.cluster.KMeans  # a short fit, which still leaves its holes in the heap
sklearn.cluster.KMeans = lambda k, n_init, random_state: KMeans(k, max_iter=1, init="random")
c = torch.randn(150_000, 4)
clusters, before = KMeansCondition(1000).fit(c), own_mb()
labels = clusters.labels(c)
print(own_mb() - before)
"""
    command, env = [sys.executable, "-c", code], {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=env)
    assert float(done.stdout) < 200


def test_nothing_that_is_fitted_keeps_a_graph():
    """As conditions that a network computes; copies would then fail."""
    c = (torch.randn(60, 3, generator=seeded()).requires_grad_() * 2).sin()
    x0, x1 = torch.randn(2, 60, 2, generator=seeded(1))
    for clusters in (KMeansCondition(4), PCAKMeansCondition(components=2, clusters=4)):
        kept = copy.deepcopy(clusters.fit(c))
        assert not any(value.requires_grad for value in kept.state_dict().values())
        assert torch.equal(kept.labels(c), clusters.labels(c))
    scale = Standardiser.fit(c)
    assert not any(value.requires_grad for value in (scale.mean, scale.std))
    for coupling in (StratifiedOT(4), StratifiedOT(KMeansCondition(4)), ConditionalOT()):
        pairs = coupling(x0, x1, c, generator=seeded())
        assert pairs.c.requires_grad  # the data's own graph stays
        again = copy.deepcopy(coupling)(x0, x1, c, generator=seeded())
        assert torch.equal(again.target_index, pairs.target_index)


def test_long_groupings_say_what_they_do(capsys, monkeypatch):
    monkeypatch.setenv("COTLEARN_PROGRESS", "1")
    monkeypatch.setattr(conditions, "LONG", 1000)
    KMeansCondition(20).fit(torch.randn(49, 2))
    assert capsys.readouterr().err == ""
    KMeansCondition(20).fit(torch.randn(51, 2))
    assert "grouping 51 conditions into 20 clusters, once" in capsys.readouterr().err


def test_an_encoder_that_somebody_trains_is_refused_later_too():
    """A policy that shares it had been set to train: 72 % of the labels changed at each call."""
    encoder = torch.nn.Sequential(torch.nn.Linear(8, 64), torch.nn.Dropout(0.5)).eval()
    c = torch.randn(300, 8, generator=seeded())
    clusters = EmbeddedClusters(encoder, KMeansCondition(8)).fit(c)
    torch.nn.ModuleDict({"encoder": encoder}).train()
    with pytest.raises(ValueError, match="embed must be in eval mode"):
        clusters.labels(c)


def test_the_nearest_centroid_far_from_zero():
    place = torch.randint(4, (400,), generator=seeded())
    joint = 1e8 + place + 0.05 * torch.randn(400, dtype=torch.float64, generator=seeded())
    pixels = 0.01 * torch.randn(400, 16, dtype=torch.float64, generator=seeded())
    c = torch.cat([pixels, joint[:, None]], dim=1)
    seen = PCAKMeansCondition(pixels=16, components=4, clusters=4).fit(c)
    right = (seen.project(c)[:, None] - seen.centroids).square().sum(dim=2).argmin(dim=1)
    assert torch.equal(seen.labels(c), right)


def test_a_view_of_negated_numbers():
    x = torch.fft.fft(torch.randn(40, 2, dtype=torch.float64, generator=seeded())).conj().imag
    assert x.is_neg()
    assert torch.equal(KMeansCondition(4).fit(x).labels(x), KMeansCondition(4).fit(+x).labels(+x))


@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_conditions_in_other_units_than_those_of_the_fit_are_noticed(factor):
    """All rows fell into one cluster: pairs as of naive OT, without a word."""
    c = 3 + torch.randn(400, 3, generator=seeded())
    clusters = KMeansCondition(8).fit(c)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clusters.labels(3 + torch.randn(50, 3, generator=seeded(1)))
    with pytest.warns(UserWarning, match="was fitted to other conditions"):
        clusters.labels(factor * c)


@pytest.mark.parametrize("other", [KMeansCondition(64), PCAKMeansCondition(components=2)])
def test_a_state_of_other_clusters_is_refused(other):
    c = torch.randn(1000, 2, generator=seeded())
    with pytest.raises(ValueError, match="state must be of KMeansCondition"):
        KMeansCondition(8).load_state_dict(other.fit(c).state_dict())


OTHERS = {
    "millimetres and metres": (1000 * torch.randn(400, 2, generator=seeded()), 0.001),
    "one column in radians": (
        torch.randn(400, 3, generator=seeded()) * torch.tensor([1.0, 1.0, 60.0]),
        torch.tensor([1.0, 1.0, math.pi / 180]),
    ),
}


@pytest.mark.parametrize("name", OTHERS)
def test_conditions_in_smaller_units_are_noticed(name):
    """All rows fell onto one point near a centroid, which is not far from it."""
    c, factor = OTHERS[name]
    clusters = KMeansCondition(16).fit(c)
    with pytest.warns(UserWarning, match="varies much less than it did"):
        clusters.labels(c * factor)


def test_labels_that_are_new_are_noticed():
    label = torch.arange(600) % 6
    clusters = KMeansCondition(4).fit(torch.eye(6)[label[label < 4]])
    with pytest.warns(UserWarning, match="33% of the rows of c lie far"):
        clusters.labels(torch.eye(6)[label])


def test_pictures_that_are_scaled_otherwise_are_noticed():
    scene = 255 * torch.rand(8, 48, generator=seeded())
    pictures = scene[torch.arange(256) % 8] + 8 * torch.randn(256, 48, generator=seeded(1))
    clusters = PCAKMeansCondition(components=8, clusters=8).fit(pictures)
    with pytest.warns(UserWarning, match="was fitted to other conditions"):
        clusters.labels(pictures / 255)


@pytest.mark.parametrize("rows", [1, 40, 400])
def test_conditions_like_those_of_the_fit_are_not(rows):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for c in (torch.randn(900, 3), torch.eye(9)[torch.arange(900) % 9], torch.rand(900, 64)):
            KMeansCondition(8).fit(c[:500]).labels(c[500 : 500 + rows])
        tailed = torch.cat([0.01 * torch.randn(800, 9), 5 * torch.randn(100, 9)])
        tailed = tailed[torch.randperm(900, generator=seeded())]  # a photograph's brightness
        KMeansCondition(16).fit(tailed[:500]).labels(tailed[500:])
