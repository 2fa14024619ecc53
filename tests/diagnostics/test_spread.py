"""Between and within, against closed forms."""

import math

import numpy as np
import pytest
import torch
from support import refused, seeded

from cotlearn import mixtures
from cotlearn.diagnostics import between_within
from cotlearn.gaussian import LinearGaussian

OTHER = LinearGaussian(A=np.eye(2) / 5, b=[1.0, 2.0], S=3 * np.eye(2), S_c=[[2.0, 0.5], [0.5, 1]])


@pytest.mark.slow
@pytest.mark.parametrize("problem", [LinearGaussian.example(), OTHER])
def test_linear_gaussian(problem):
    """Var(x1) = S + A S_c A': within and between."""
    x1, c = problem.sample(600, np.random.default_rng(0))
    found = between_within(torch.from_numpy(x1), torch.from_numpy(c))
    within = np.trace(problem.S)
    between = np.trace(problem.A @ problem.S_c @ problem.A.T)
    assert found.total == pytest.approx(within + between, rel=0.15)  # so few rows vary
    left = np.square(x1 - c @ problem.A.T - problem.b).sum(axis=1).mean()
    assert left == pytest.approx(within, rel=0.15)
    assert found.within == pytest.approx(left, rel=0.05)
    assert found.between_share == pytest.approx(between / (within + between), abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("data", "within", "between"),
    [
        (mixtures.petals(), 1.2**2 + 2 * 0.25**2, 16.0),
        (mixtures.eight_gaussians(), 0.2, 25.0),
        (mixtures.moving_modes(), 4 + 2 * 0.25**2, 0.0),
        # |mean|^2 - |E mean|^2 on half a circle of radius 3: 9 (1 - (2 / pi)^2)
        (mixtures.rotating_pair(), 1 + 2 * 0.25**2, 9 * (1 - 4 / math.pi**2)),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_mixtures(data, within, between):
    found = between_within(*data.sample(600, generator=seeded()))
    assert found.within == pytest.approx(within, rel=0.12)
    assert found.between_share == pytest.approx(between / (within + between), abs=0.02)
    assert found.within + found.between == pytest.approx(found.total)


@pytest.mark.slow
def test_labels_in_any_order_and_columns_of_any_scale():
    x1, c = mixtures.petals().sample(300, generator=seeded())
    order = c.argmax(dim=1).argsort()
    assert between_within(x1[order], c[order]).within == pytest.approx(1.565, rel=0.1)
    x1, c = mixtures.rotating_pair().sample(300, generator=seeded())
    plain = between_within(x1, c)
    assert between_within(x1, 1e4 * c + 3).within == pytest.approx(plain.within, rel=1e-6)


@pytest.mark.slow
def test_one_condition_and_constant_data():
    x1 = torch.randn(500, 2, generator=seeded())
    constant = between_within(x1, torch.full((500, 1), 0.1))
    assert constant.within == pytest.approx(constant.total, rel=0.1)
    still = between_within(torch.zeros(500, 2), x1)
    assert (still.total, still.between_share) == (0, 0)


@pytest.mark.slow
@pytest.mark.slow
def test_shifts_of_the_data_and_constant_columns_of_the_condition_change_nothing():
    c = torch.randn(300, 3, generator=seeded())
    x1 = torch.stack([torch.sin(2 * c[:, 0]), torch.cos(2 * c[:, 1])], dim=1)
    x1 = x1 + 0.1 * torch.randn(300, 2, generator=seeded(1))
    share = between_within(x1, c).between_share
    assert share > 0.8
    moved = torch.cat([x1[:, :1] + 50, x1[:, 1:], torch.full((300, 1), 100.0)], dim=1)
    assert between_within(moved, c).between_share == pytest.approx(share, abs=0.01)
    for columns in (1, 14):
        padded = torch.cat([c, torch.ones(300, columns)], dim=1)
        assert between_within(x1, padded).between_share == pytest.approx(share, abs=1e-6)
    assert between_within(x1, torch.ones(300, 2)).between_share < 0.05


def test_integer_conditions():
    x1, c = mixtures.petals().sample(200, generator=seeded())
    assert between_within(x1, c.long()) == between_within(x1, c)


def smooth(n, columns, seed, *, share=0.6, waves=0.0):
    """x1 (n, 2) of which a function of c explains a share: a plane, or sines of planes."""
    rng = np.random.default_rng(seed)
    c = rng.standard_normal((n, columns))
    slope = rng.standard_normal((columns, 2))
    plane = c @ (slope / np.linalg.norm(slope, axis=0))
    if waves:  # the variance of sin(w z), z standard normal, is (1 - exp(-2 w^2)) / 2
        plane = np.sin(waves * plane) / math.sqrt((1 - math.exp(-2 * waves**2)) / 2)
    x1 = math.sqrt(share) * plane + math.sqrt(1 - share) * rng.standard_normal((n, 2))
    return torch.from_numpy(x1), torch.from_numpy(c)


# columns, rows, repetitions, waves: the share that ten neighbours find, and a bound on ours.
# The last two are a plane, where the regression is right at once.
SIXTY = [
    (4, 200, 6, 1.4, 0.37, 0.41),
    (4, 1000, 1, 1.4, 0.48, 0.54),
    (12, 200, 3, 1.4, 0.18, 0.22),
    (12, 2000, 1, 1.4, 0.28, 0.5),
    (4, 200, 3, 0.0, 0.46, 0.54),
    (12, 400, 1, 0.0, 0.34, 0.5),
]


@pytest.mark.slow
@pytest.mark.parametrize(("columns", "rows", "seeds", "waves", "neighbours", "bound"), SIXTY)
def test_a_share_of_sixty_percent(columns, rows, seeds, waves, neighbours, bound):
    """Nearer than neighbours, and not above the truth by more than chance."""
    drawn = [smooth(rows, columns, seed, waves=waves) for seed in range(seeds)]
    shares = [between_within(x1, c).between_share for x1, c in drawn]
    assert np.mean(shares) > bound > neighbours
    assert np.mean(shares) < 0.6 + 3 * 0.9 / math.sqrt(rows * seeds)  # of 2 (rows * seeds) numbers


@pytest.mark.slow
@pytest.mark.parametrize("columns", [4, 12])
def test_a_condition_that_says_nothing_explains_nothing(columns):
    drawn = [smooth(200, columns, seed, share=0.0) for seed in range(2)]
    shares = [between_within(x1, c).between_share for x1, c in drawn]
    assert np.mean(shares) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_what_is_learned_of_an_episode_is_not_what_its_condition_tells(seed):
    """24 episodes of 16 rows: x1 and c wander, each on its own; rows alone would give .9."""
    rng = np.random.default_rng(seed)
    episode = np.repeat(np.arange(24), 16)
    place, says = rng.normal(size=(24, 2)), rng.normal(size=(24, 3))
    x1 = torch.from_numpy(place[episode] + 0.2 * rng.normal(size=(384, 2)))
    c = torch.from_numpy(says[episode] + 0.05 * rng.normal(size=(384, 3)))
    assert between_within(x1, c).between_share > 0.7
    found = between_within(x1, c, groups=episode)
    assert found.between_share < 0.1
    assert [rows for rows, _ in found.curve] == [96, 192, 384]


def test_groups_are_checked():
    x1, c = torch.randn(60, 2), torch.randn(60, 1)
    with pytest.raises(ValueError, match=r"one value for each of 60 rows, got \(59,\)"):
        between_within(x1, c, groups=torch.zeros(59))
    with pytest.raises(ValueError, match="groups has 3 different values: at least 4"):
        between_within(x1, c, groups=torch.arange(60) % 3)


@pytest.mark.slow
def test_the_curve_shows_that_more_rows_would_help():
    found = between_within(*smooth(800, 4, 0, waves=2.0))
    rows, shares = zip(*found.curve, strict=True)
    assert rows == (200, 400, 800)
    assert shares[0] < shares[1] < shares[2] == found.between_share < 0.62


X = torch.randn(50, 2)


test_bad_input = refused(
    (lambda: between_within(X / 0, X), ValueError, "x1 has NaN"),
    (lambda: between_within(X, X[:4]), ValueError, "c has 4 rows, x1 has 50"),
    (lambda: between_within(X, X[:, 0]), ValueError, "c must have shape"),
    (lambda: between_within(X[:39], X[:39]), ValueError, "x1 needs at least 40 rows, got 39"),
)
