"""Two streams of one coupling, calls beside a stream, and threads: each keeps what is its own."""

import sys
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from support import same, seeded, take

from cotlearn.couplings import (
    ConditionalOT,
    EmbeddedClusters,
    FixedPairs,
    Independent,
    KMeansCondition,
    SemidiscreteOT,
    StratifiedBatches,
    StratifiedOT,
    Transformed,
    centred,
)
from cotlearn.couplings.base import Last
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import linear_skew

C = torch.randn(512, 2, generator=seeded(1))
DATA = Dataset(torch.cat([2 * C, torch.randn(512, 1, generator=seeded(2))], dim=1), C)
OTHER = Dataset(DATA.x1[:64], C[:64] * 0.01 + 50)
FRESH = {
    "k-means": lambda: StratifiedOT(8),
    "k-means of one's own": lambda: StratifiedOT(KMeansCondition(8)),
    "embedded": lambda: StratifiedOT(EmbeddedClusters(lambda c: 2 * c, KMeansCondition(8))),
    "labels": lambda: StratifiedOT(),
    "search": lambda: SemidiscreteOT(iterations=20, clusters=2),
    "batches of strata": lambda: StratifiedBatches(16),
    "around another": lambda: Transformed(StratifiedOT(8), lambda x, c: x - 2),
    "residuals": lambda: centred(StratifiedOT(8), lambda c: torch.cat([2 * c, c[:, :1]], dim=1)),
}
quiet = pytest.mark.filterwarnings("ignore:StratifiedOT was called", "ignore:the potential has not")


def opened(coupling, data=DATA):
    stream = coupling.stream(data, batch_size=256, generator=seeded(5))
    next(stream)
    return stream


@quiet
@pytest.mark.filterwarnings("ignore:clusters is None")
@pytest.mark.parametrize("name", FRESH)
def test_a_stream_goes_on_as_if_no_other_had_begun(name):
    """It went on with the clusters of the other's data: a linear skew of .95 instead of .25."""
    alone, coupling = take(FRESH[name](), DATA, 6, batch_size=256), FRESH[name]()
    stream = opened(coupling)
    second = take(coupling, OTHER, 2, batch_size=32)
    later = [next(stream) for _ in range(5)]
    assert all(map(same, alone[1:], later))
    assert all(map(same, second, take(FRESH[name](), OTHER, 2, batch_size=32)))


@quiet
@pytest.mark.parametrize("name", ["k-means", "k-means of one's own", "search", "around another"])
def test_a_call_beside_a_stream_changes_neither(name):
    alone, coupling = take(FRESH[name](), DATA, 4, batch_size=256), FRESH[name]()
    stream = opened(coupling)
    z = torch.randn(64, 3, generator=seeded(3))
    called = coupling(z, OTHER.x1, OTHER.c, generator=seeded(4))
    assert same(called, FRESH[name]()(z, OTHER.x1, OTHER.c, generator=seeded(4)))
    assert all(same(batch, next(stream)) for batch in alone[1:])


def test_a_call_after_a_stream_has_clusters_of_its_own_and_says_so():
    """All rows were one cluster: naive OT."""
    coupling = StratifiedOT(8)
    opened(coupling)
    z, c = torch.randn(512, 3, generator=seeded(3)), 100 + 10 * C
    with pytest.warns(UserWarning, match="of which it makes its clusters"):
        pairs = coupling(z, DATA.x1, c)
    assert linear_skew(pairs.x0, pairs.c).explained < 0.6
    assert len(coupling.clusters.labels(c).unique()) == 8


def test_clusters_that_were_given_are_not_fitted_for_others():
    """The second coupling took them for clusters that came fitted."""
    mine = KMeansCondition(4)
    first, second = StratifiedOT(mine), StratifiedOT(mine)
    take(first, DATA, 1)
    take(second, OTHER, 1)
    assert not mine.state_dict()
    assert len(second.clusters.labels(OTHER.c).unique()) == 4


class Table(Independent):
    """A user's coupling that keeps something of its data."""

    def prepare(self, data, source, generator):
        self.mean = data.x1.mean()


@pytest.mark.parametrize("around", [lambda k: k, lambda k: Transformed(k, lambda x, c: x)])
def test_a_user_s_coupling_says_that_another_stream_has_prepared_it(around):
    coupling = around(Table())
    first, second = opened(coupling), opened(coupling, OTHER)
    next(second)
    with pytest.raises(RuntimeError, match="another stream has prepared this"):
        next(first)


def test_what_keeps_nothing_of_its_data_serves_many_streams():
    for coupling in (FixedPairs(DATA.x1), ConditionalOT()):
        first = opened(coupling)
        opened(coupling)
        next(first)


# --- threads ---


def in_threads(work, count=2):
    start = threading.Barrier(count)

    def one(k):
        start.wait()
        return work(k)

    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(one, range(count)))


@pytest.mark.parametrize("make", [lambda: StratifiedOT(8), lambda: StratifiedOT()])
def test_threads_can_share_a_coupling(make):
    """One met clusters that were half fitted, or was given the other's labels."""
    coupling, x1 = make(), DATA.x1[:64]
    conditions = [torch.eye(8)[torch.randperm(64, generator=seeded(k)) % 8] for k in (0, 1)]
    z = torch.randn(64, 3, generator=seeded(3))

    def work(k):
        c = conditions[k]
        return [torch.equal(c[coupling(z, x1, c).target_index], c) for _ in range(20)]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert all(map(all, in_threads(work)))


@quiet
def test_threads_that_share_a_potential_have_that_of_their_own_data():
    """A fit of the other thread came between a fit and the copy that was to keep it."""
    shifted = Dataset(DATA.x1 + 5, C)
    alone = [
        take(SemidiscreteOT(iterations=20), data, 2, batch_size=64) for data in (DATA, shifted)
    ]
    coupling = SemidiscreteOT(iterations=20)
    shared = in_threads(lambda k: take(coupling, (DATA, shifted)[k], 2, batch_size=64))
    for mine, ours in zip(alone, shared, strict=True):
        assert all(map(same, mine, ours))


def slowly(frame, event, arg):
    """Lets the other thread run between any two lines of the cache."""
    if frame.f_code is Last.__call__.__code__:
        time.sleep(1e-5)
        return slowly
    return None


def test_a_cache_gives_each_thread_the_value_that_it_asked_for():
    """Content and value were two attributes, and another thread could come between."""
    last, values = Last(), (torch.zeros(1), torch.ones(1))

    def work(k):
        before = sys.gettrace()
        sys.settrace(slowly)
        try:
            return {last(float, values[k]) for _ in range(100)}
        finally:
            sys.settrace(before)

    assert in_threads(work) == [{0.0}, {1.0}]


def test_clusters_are_never_half_fitted(monkeypatch):
    clusters, met = KMeansCondition(4), []
    project = KMeansCondition.project

    def watched(self, c):
        met.append(set(clusters.state_dict()))
        return project(self, c)

    monkeypatch.setattr(KMeansCondition, "project", watched)
    clusters.fit(C)
    whole = set(clusters.state_dict())
    assert "centroids" in whole
    assert met[0] == set()
    assert all(state in (set(), whole) for state in met)  # the warning looks at them afterwards


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (lambda: SemidiscreteOT(iterations=20), lambda: SemidiscreteOT(50.0, iterations=20)),
        (lambda: StratifiedOT(4), lambda: StratifiedOT(16)),
    ],
)
def test_a_state_of_other_options_is_refused(one, other):
    """It paired by the other one's potential or clusters, and printed its own options."""
    first, same_options = one(), one()
    take(first, DATA, 1, batch_size=64)
    same_options.load_state_dict(first.state_dict())
    with pytest.raises(ValueError, match=r"state is of .*, and this is"):
        other().load_state_dict(first.state_dict())
