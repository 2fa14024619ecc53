"""Batches of few strata."""

import pytest
import torch
from support import joined, refused, same, seeded, take

from cotlearn.couplings import Independent, KMeansCondition, Pairs, StratifiedBatches
from cotlearn.datasets import Dataset
from cotlearn.mixtures import moving_modes


def line(n=200):
    """Conditions on a line, and the rows' numbers as data."""
    c = torch.linspace(0, 1, n)[:, None]
    return Dataset(torch.arange(float(n))[:, None], c)


def test_a_group_is_of_one_stratum_of_near_conditions():
    for batch in take(StratifiedBatches(10), line(), 5):
        assert batch.group.unique().tolist() == [0, 1]
        for group in range(2):
            own = batch.c[batch.group == group]
            assert len(own) == 10
            assert own.max() - own.min() < 0.3  # a tenth on average


def test_strata_may_be_given():
    data = line()
    halves = KMeansCondition(2).fit(data.c)
    for batch in take(StratifiedBatches(10, halves), data, 5):
        label = halves.labels(batch.c)
        assert all(len(label[batch.group == group].unique()) == 1 for group in range(2))


@pytest.mark.slow
def test_every_row_is_equally_likely():
    x1 = torch.arange(90.0)[:, None]
    c = (x1 > 9).float()  # strata of 10 and of 80 rows
    coupling = StratifiedBatches(20, KMeansCondition(2).fit(c))
    drawn = joined(take(coupling, Dataset(x1, c), 1500), "x1")[:, 0].long()
    often = drawn.bincount(minlength=90) / len(drawn) * 90
    assert 0.85 < often[:10].mean() < 1.15
    assert often.min() > 0.7
    assert often.max() < 1.3


def test_a_row_comes_again_only_after_all_of_its_stratum():
    for rows, most in ((10, 1), (25, 3)):
        coupling = StratifiedBatches(rows, KMeansCondition(1).fit(line(10).c))
        batch = take(coupling, line(10), 1, batch_size=rows)[0]
        often = batch.target_index.bincount(minlength=10)
        assert often.max() == most
        assert often.min() >= most - 1


def test_noise_is_that_of_independent_pairs():
    data = line(4000)
    batches = take(StratifiedBatches(20), data, 400)
    x0, c = joined(batches, "x0"), joined(batches, "c")
    assert abs(float(torch.corrcoef(torch.cat([x0, c], dim=1).T)[0, 1])) < 0.05
    assert (joined(batches, "x1")[:, 0] == data.x1[joined(batches, "target_index"), 0]).all()


def test_a_stream_that_is_resumed_goes_on_with_the_same_batches():
    whole = take(StratifiedBatches(10), line(), 4)
    later = take(StratifiedBatches(10), line(), 2, start=2)
    for first, again in zip(whole[2:], later, strict=True):
        assert same(first, again)
        assert torch.equal(first.group, again.group)


def test_the_last_group_is_cut_where_the_batch_ends():
    batch = take(StratifiedBatches(16), line(), 1, batch_size=40)[0]
    assert batch.group.bincount().tolist() == [16, 16, 8]


def test_other_pairs_have_no_group():
    assert take(Independent(), line(), 1)[0].group is None


test_bad_input = refused(
    (lambda: StratifiedBatches(1), ValueError, "rows"),
    (lambda: StratifiedBatches(8, clusters=4), TypeError, "clusters"),
    (lambda: take(StratifiedBatches(8), moving_modes(), 1), TypeError, "endless"),
    (lambda: take(StratifiedBatches(8), Dataset(torch.zeros(9, 1)), 1), TypeError, "conditions"),
)


def test_fitted_strata_are_wanted():
    with pytest.raises(ValueError, match="not fitted"):
        take(StratifiedBatches(8, KMeansCondition(2)), line(), 1)


def test_groups_of_two_batches_stay_apart():
    """Both number theirs from 0: rows of far conditions would be compared."""
    c = torch.arange(3.0).repeat_interleave(40)[:, None]
    data = Dataset(torch.randn(120, 2, generator=seeded()), c)
    stream = StratifiedBatches(20).stream(data, batch_size=80, generator=seeded())
    parts = [next(stream) for _ in range(3)]
    whole = Pairs.cat(parts)
    assert sorted(set(whole.group.tolist())) == list(range(12))
    for group in range(12):
        assert len(whole.c[whole.group == group].unique()) == 1
