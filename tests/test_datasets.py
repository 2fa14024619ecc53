import math

import numpy as np
import pytest
import torch
from support import refused, seeded

from cotlearn import mixtures
from cotlearn.datasets import Dataset, Standardiser, Unconditional, digits, unconditional


@pytest.fixture
def rows():
    """Ten distinct rows, of three classes with 5, 3 and 2 rows."""
    c = torch.eye(3)[torch.tensor([0] * 5 + [1] * 3 + [2] * 2)]
    return Dataset(torch.arange(20.0).reshape(10, 2), c, name="rows")


def test_what_it_says_of_itself(rows):
    assert (len(rows), rows.dim, rows.condition_dim) == (10, 2, 3)
    assert Dataset(rows.x1).condition_dim == 0


def test_samples_are_rows_with_their_own_condition(rows):
    x1, c = rows.sample(200, generator=seeded())
    index = (x1[:, 0] / 2).long()
    assert torch.equal(rows.x1[index], x1)
    assert torch.equal(rows.c[index], c)
    assert len(index.unique()) == 10
    again, _ = rows.sample(200, generator=seeded())
    assert torch.equal(x1, again)
    assert Dataset(rows.x1).sample(4)[1] is None


def test_sample_given_draws_rows_of_that_condition_without_replacement(rows):
    wanted = torch.eye(3)[torch.tensor([1, 0, 1, 0, 1, 2, 0, 0, 0, 2])]
    x1 = rows.sample_given(wanted, generator=seeded())
    assert torch.equal(rows.c[(x1[:, 0] / 2).long()], wanted)
    assert len(x1.unique(dim=0)) == 10
    twice = rows.sample_given(torch.eye(3)[[2] * 5], generator=seeded())  # two rows, five draws
    _, counts = twice.unique(dim=0, return_counts=True)
    assert sorted(counts.tolist()) == [2, 3]


def test_conditions_are_the_distinct_ones_or_spread_over_many(rows):
    assert torch.equal(rows.conditions(), torch.eye(3))
    c = Dataset(torch.zeros(100, 1), torch.arange(100.0)[:, None]).conditions(n=5)
    assert c.shape == (5, 1)
    assert (c[0], c[-1]) == (0, 99)


def test_integer_labels_become_numbers():
    assert Dataset(torch.zeros(3, 2), torch.eye(3, dtype=torch.int64)).c.dtype == torch.float32


def test_leaving_the_condition_out(rows):
    bare = unconditional(rows)
    assert isinstance(bare, Dataset)
    assert len(bare) == 10
    assert bare.c is None
    endless = unconditional(mixtures.petals())
    assert isinstance(endless, Unconditional)
    assert (endless.dim, endless.condition_dim) == (2, 0)
    x1, c = endless.sample(5, generator=seeded())
    assert c is None
    assert torch.equal(x1, mixtures.petals().sample(5, generator=seeded())[0])
    assert "petals" in endless.name


def test_digits_are_the_real_ones():
    every, train, test = (digits(split) for split in ("all", "train", "test"))
    assert every.x1.shape == (1797, 64)
    assert every.c.shape == (1797, 10)
    assert (every.x1.min(), every.x1.max()) == (-1, 1)
    assert (every.c.sum(dim=1) == 1).all()
    assert len(train) + len(test) == 1797
    assert 0.24 < len(test) / 1797 < 0.26
    both = {tuple(x) for x in train.x1.tolist()} & {tuple(x) for x in test.x1.tolist()}
    assert not both  # no image stands on both sides
    assert (test.c.sum(dim=0) > 35).all()
    assert torch.equal(every.conditions(), torch.eye(10))


@pytest.mark.parametrize("kind", [torch.from_numpy, lambda array: array, torch.Tensor])
def test_standardiser(kind):
    table = np.random.default_rng(0).normal(3, [2, 5, 0], size=(100, 3))
    rows = kind(table)
    standardise = Standardiser.fit(rows)
    scaled = np.asarray(standardise(rows), dtype=np.float64)
    assert type(standardise(rows)) is type(rows)
    assert np.allclose(scaled.mean(axis=0), 0, atol=1e-6)
    assert np.allclose(scaled.std(axis=0), [1, 1, 0])
    assert (standardise(rows + 1)[:, 2] == 0).all()  # the column did not vary when it was fitted
    assert np.allclose(standardise.inverse(standardise(rows)), table, atol=1e-5)
    with pytest.raises(ValueError, match=r"rows must have shape \(rows, 3\), got \(100, 2\)"):
        standardise(rows[:, :2])


X, C = torch.arange(20.0).reshape(10, 2), torch.eye(3)[torch.arange(10) % 3]
ROWS = Dataset(X, C, name="rows")
test_bad_input = refused(
    (lambda: Dataset(X, C[:4]), ValueError, "x1 has 10 rows, c has 4"),
    (lambda: Dataset(X * math.nan), ValueError, "x1 has NaN"),
    (lambda: Dataset(X[:0]), ValueError, "x1 is empty"),
    (lambda: Dataset(X.tolist()), TypeError, "x1 must be a torch tensor"),
    (lambda: Dataset(X, C.argmax(dim=1)), ValueError, "c must have shape"),
    (lambda: ROWS.sample(0), ValueError, "n must be at least 1"),
    (lambda: ROWS.sample_given(torch.full((1, 3), 0.5)), ValueError, "c: no row of rows has"),
    (lambda: ROWS.sample_given(torch.eye(2)), ValueError, "c has 2 columns, expected 3"),
    (lambda: Dataset(X).sample_given(C), ValueError, "no condition"),
    (lambda: Dataset(X).conditions(), ValueError, "no condition"),
    (lambda: digits("validation"), ValueError, "split must be one of train, test, all"),
)


def test_many_rows_far_from_zero_are_standardised():
    """Their sum was rounded: a mean of -0.69 and a deviation of 0.72."""
    rows = torch.randn(100_000, 1, generator=torch.Generator().manual_seed(1)) + 1e7
    scaled = Standardiser.fit(rows)(rows).double()
    assert abs(float(scaled.mean())) < 0.5  # the mean is float32, too: 1e7 + 0.5 is rounded
    assert float(scaled.std()) == pytest.approx(1, abs=0.01)


def test_integer_conditions_and_their_rows_stay_together():
    """c was a copy and x1 was not: refilled together, rows got the conditions of others."""
    x1, c = torch.arange(8.0)[:, None], torch.arange(8)[:, None]
    data = Dataset(x1, c)
    order = torch.randperm(8, generator=seeded())
    x1.copy_(x1[order]), c.copy_(c[order])
    assert torch.equal(data.x1, data.c)


def test_a_data_set_of_ones_own_keeps_its_way_to_draw():
    class Shifted(Dataset):
        def sample(self, n, generator=None):
            x1, c = super().sample(n, generator)
            return x1 + 100, c

    data = Shifted(torch.zeros(8, 2), torch.eye(8))
    assert unconditional(data).sample(4)[0].min() == 100
