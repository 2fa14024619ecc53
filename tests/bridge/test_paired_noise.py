"""Noise that goes to rows which stay: brute force, invariances, and the warning's number."""

import itertools
import math
import pickle
import warnings

import pytest
import torch
from support import refused, seeded
from torch.utils.data import DataLoader, TensorDataset

from cotlearn.bridge import PairedNoise, paired_noise
from cotlearn.couplings import (
    ConditionalOT,
    EmbeddedClusters,
    Independent,
    KMeansCondition,
    MinibatchOT,
    StratifiedOT,
    Transformed,
    centred,
    combine,
)
from cotlearn.mixtures import petals

WITHIN = ConditionalOT(math.inf)


def chunks(rows=24, steps=4, columns=3, seed=0):
    return torch.randn(rows, steps, columns, generator=seeded(seed))


def rank(noise, of):
    """The row of `of` that each row of the noise is."""
    return (noise.flatten(1)[:, None] == of.flatten(1)[None]).all(dim=2).long().argmax(dim=1)


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_cheapest_of_all_permutations(seed):
    actions, noise = chunks(5, seed=seed), chunks(5, seed=100 + seed)
    paired = paired_noise(MinibatchOT(), actions, noise=noise)
    orders = itertools.permutations(range(5))
    best = min(orders, key=lambda order: float((noise[list(order)] - actions).square().sum()))
    assert torch.equal(paired, noise[list(best)])


def test_labels_keep_each_row_within_its_class():
    actions, labels, noise = chunks(12), torch.arange(12) % 2, chunks(12, seed=1)
    paired = paired_noise(WITHIN, actions, labels, noise=noise, generator=seeded())
    for label in (0, 1):  # within a class no exchange of two rows is cheaper
        rows = (labels == label).nonzero()[:, 0]
        for i, j in itertools.combinations(rows.tolist(), 2):
            now = (paired[[i, j]] - actions[[i, j]]).square().sum()
            assert now <= (paired[[j, i]] - actions[[i, j]]).square().sum() + 1e-5
    hot = paired_noise(WITHIN, actions, torch.eye(2)[labels], noise=noise, generator=seeded())
    assert torch.equal(paired, hot)
    named = paired_noise(WITHIN, actions, labels * 70 + 5, noise=noise, generator=seeded())
    assert torch.equal(paired, named)


def test_its_own_noise_is_a_permutation_of_what_the_generator_draws():
    actions = chunks()
    paired = paired_noise(MinibatchOT(), actions, generator=seeded(3))
    drawn = torch.randn(24, 12, generator=seeded(3)).view_as(actions)
    assert sorted(rank(paired, drawn).tolist()) == list(range(24))
    assert not paired.requires_grad


@pytest.mark.parametrize("seed", range(5))
def test_padded_columns_change_no_pair(seed):
    actions, condition = chunks(32, 4, 6, seed), torch.randn(32, 3, generator=seeded(seed + 50))
    noise = chunks(32, 4, 32, seed + 9)
    padded = torch.nn.functional.pad(actions, (0, 26))
    few = paired_noise(
        ConditionalOT(), actions, condition, noise=noise[..., :6], generator=seeded()
    )
    many = paired_noise(ConditionalOT(), padded, condition, noise=noise, generator=seeded())
    assert torch.equal(few, many[..., :6])
    assert torch.equal(rank(many, noise), rank(few, noise[..., :6]))


def test_what_stands_in_padded_steps_changes_no_pair():
    actions, noise, is_pad = chunks(), chunks(seed=1), torch.zeros(24, 4, dtype=torch.bool)
    is_pad[:8, 2:] = True
    other = actions.masked_fill(is_pad[..., None], 50.0)
    counted = paired_noise(MinibatchOT(), other, noise=noise)
    a, b = (paired_noise(MinibatchOT(), x, is_pad=is_pad, noise=noise) for x in (actions, other))
    assert torch.equal(a, b)
    assert not torch.equal(a, counted)


def test_a_dictionary_is_what_combine_makes_of_it():
    actions, noise = chunks(), chunks(seed=1)
    state, label = torch.randn(24, 2, 5, generator=seeded(2)), torch.arange(24) % 3
    one = paired_noise(
        WITHIN, actions, {"state": state, "task": label}, noise=noise, generator=seeded()
    )
    matrix = combine({"state": state.flatten(1), "task": torch.eye(3)[label]})
    assert torch.equal(one, paired_noise(WITHIN, actions, matrix, noise=noise, generator=seeded()))


def test_conditions_of_a_dictionary_count_equally_with_the_default_coupling():
    """A hundred columns of one slow sensor, and one of a goal."""
    g = seeded(3)
    place, goal, noise = (torch.randn(1024, k, generator=g) for k in (1, 1, 2))
    history = place[:, None] + 0.05 * torch.randn(1024, 100, 1, generator=g)
    actions = torch.cat([place, goal], 1) + 0.3 * torch.randn(1024, 2, generator=g)
    given, coupling = {"history": history, "goal": goal}, ConditionalOT()
    paired = paired_noise(coupling, actions, given, noise=noise, generator=seeded())
    columns = combine({"history": history.flatten(1), "goal": goal})
    expected = ConditionalOT("balanced")(noise, actions, columns, seeded())
    assert torch.equal(paired[expected.target_index], expected.x0)
    assert coupling.condition_weight == "scaled"


def test_pictures_go_through_fitted_clusters():
    kind = torch.arange(24) % 3
    pictures = torch.rand(24, 3, 4, 4, generator=seeded()) * 0.1 + kind[:, None, None, None]
    clusters = EmbeddedClusters(lambda rows: rows.mean(dim=1, keepdim=True), KMeansCondition(3))
    clusters.fit(pictures.flatten(1))
    actions, noise = chunks(), chunks(seed=1)
    options = {"noise": noise, "generator": seeded()}
    seen = paired_noise(ConditionalOT(math.inf, condition=clusters), actions, pictures, **options)
    options["generator"] = seeded()
    given = paired_noise(WITHIN, actions, clusters(pictures.flatten(1)), **options)
    options["generator"] = seeded()
    assert torch.equal(seen, given)
    assert torch.equal(seen, paired_noise(WITHIN, actions, kind, **options))


def test_a_frame_moves_and_turns_the_noise():
    angle = torch.rand(24, 1, generator=seeded()) * 6
    turn = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()], 1).view(24, 2, 2)

    def forward(x, c):
        return torch.einsum("bij,bj->bi", _turn(c), x)

    def inverse(x, c):
        return torch.einsum("bji,bj->bi", _turn(c), x)

    def _turn(c):
        a = c[:, :1]
        return torch.stack([a.cos(), -a.sin(), a.sin(), a.cos()], 1).view(-1, 2, 2)

    assert torch.allclose(_turn(angle), turn)
    actions = torch.randn(24, 2, generator=seeded(1))
    paired = paired_noise(
        Transformed(MinibatchOT(), forward=forward, inverse=inverse), actions, angle,
        generator=seeded(2),
    )  # fmt: skip
    drawn = torch.randn(24, 2, generator=seeded(2))
    in_frame = forward(paired, angle)
    assert torch.allclose(in_frame.norm(dim=1).sort()[0], drawn.norm(dim=1).sort()[0], atol=1e-5)
    turned = forward(actions, angle)
    assert (in_frame - turned).square().sum() < (drawn - turned).square().sum()


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16, torch.float64])
def test_any_type_and_autocast(kind):
    actions, condition = chunks().to(kind), torch.randn(24, 2).to(kind)
    plain = paired_noise(ConditionalOT(), actions, condition, generator=seeded())
    assert (plain.dtype, plain.shape) == (kind, actions.shape)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        mixed = paired_noise(ConditionalOT(), actions, condition, generator=seeded())
    assert torch.equal(plain, mixed)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_a_smaller_last_batch(rows):
    actions = chunks(rows)
    noise = paired_noise(ConditionalOT(), actions, torch.arange(rows), generator=seeded())
    assert torch.isfinite(noise).all()


@pytest.mark.slow  # torch takes ten seconds before it compiles anything
def test_a_compiled_step_trains_on_the_same_noise():
    pairing = PairedNoise(ConditionalOT())
    network = torch.nn.Linear(12, 12)
    actions, condition = chunks(), torch.randn(24, 2)

    def step():
        noise = pairing(actions, condition).flatten(1)
        noise = noise + paired_noise(ConditionalOT(), actions, condition).flatten(1)
        return (network(noise) - (actions.flatten(1) - noise)).square().mean()

    torch.manual_seed(0)
    plain = step()
    torch.manual_seed(0)
    compiled = torch.compile(step, backend="eager")()
    compiled.backward()
    assert torch.equal(plain, compiled)


test_refused = refused(
    ({"actions": [1.0]}, TypeError, "actions must be a floating-point tensor"),
    ({"actions": torch.ones(3, 2, dtype=torch.long)}, TypeError, "actions must be a floating"),
    ({"actions": torch.full((3, 2), math.nan)}, ValueError, "actions has NaN"),
    ({"noise": torch.ones(3, 2)}, ValueError, r"noise must have shape \(24, 4, 3\)"),
    ({"is_pad": torch.zeros(24, 3)}, ValueError, r"is_pad must be \(B, T\)"),
    ({"condition": [0] * 24}, TypeError, "condition must be a tensor or a dictionary"),
    ({"condition": torch.ones(24, 3, 8, 8)}, ValueError, "condition has the shape of pictures"),
    ({"condition": torch.ones(23, 1)}, ValueError, "c has 23 rows, x0 has 24"),
    ({"condition": {"a": torch.ones(23, 3, 8, 8)}}, ValueError, r"condition\['a'\] has the shape"),
    ({"coupling": ConditionalOT()}, TypeError, "ConditionalOT needs the conditions"),
    ({"coupling": MinibatchOT(sampling="replacement")}, ValueError, "draws rows repeatedly"),
    (
        {"coupling": ConditionalOT(0.1, label="source"), "condition": torch.rand(24, 2)},
        ValueError,
        "coupling must only move rows of noise, but ConditionalOT",
    ),
    of=lambda coupling=MinibatchOT(), actions=chunks(), **options: paired_noise(  # noqa: B008
        coupling, actions, **options
    ),
)


# --- the warning ----------------------------------------------------------------------------------


def test_sorted_noise_is_skewed_by_two_over_pi():
    """Naive OT gives label -1 the lower half of the noise, whose mean is -(2/pi)^.5."""
    pairing, labels = PairedNoise(MinibatchOT()), torch.arange(256) % 2
    actions = 100 * (2.0 * labels[:, None] - 1)
    torch.manual_seed(0)
    for _ in range(99):
        pairing(actions, labels)
    with pytest.warns(RuntimeWarning, match=r"explains 6[2345]% of the variance of the noise"):
        pairing(actions, labels)
    assert pairing.skew().explained == pytest.approx(2 / math.pi, abs=0.02)


@pytest.mark.parametrize("coupling", [ConditionalOT(), WITHIN, Independent()], ids=lambda k: k.name)
def test_no_warning_where_the_noise_keeps_its_law(coupling):
    pairing, generator = PairedNoise(coupling, generator=seeded()), seeded(1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(100):
            pairing(*petals().sample(64, generator=generator))
    assert abs(pairing.skew().explained) < 0.02


def test_small_batches_are_tested_later():
    pairing, labels = PairedNoise(MinibatchOT()), torch.tensor([0, 1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(159):  # 318 rows: fewer than 5 for each of 64 cells
            pairing(100 * (2.0 * labels[:, None] - 1), labels)
    with pytest.warns(RuntimeWarning, match="in 160 batches"):
        pairing(100 * (2.0 * labels[:, None] - 1), labels)


def test_a_column_that_is_constant_in_some_batches_does_not_stop_the_test():
    """As a gripper, which is open in all rows of many a small batch."""
    pairing, generator = PairedNoise(MinibatchOT(), generator=seeded()), seeded(1)
    labels, gripper = torch.arange(16) % 2, torch.randn(100, 16, 1, generator=generator) / 10
    gripper[:67] = 1
    place = 100 * (2.0 * labels[:, None] - 1)
    for some in gripper[:99]:
        pairing(torch.hstack([place, some]), labels)
    with pytest.warns(RuntimeWarning, match="in 100 batches"):
        pairing(torch.hstack([place, gripper[99]]), labels)
    assert pairing.skew().explained == pytest.approx(1 / math.pi, abs=0.04)  # of two columns, one


@pytest.mark.parametrize("count", [10, 1000])
def test_labels_mean_the_same_in_each_batch(count):
    """Noise that depends on the label is noticed, whichever labels a small batch holds."""
    pairing, generator = PairedNoise(Independent(), generator=seeded()), seeded(1)
    labels = torch.randint(count, (100, 8), generator=generator)
    noise = torch.randn(100, 8, 1, generator=generator) + 3 * labels[..., None] / count - 1.5
    for some, drawn in zip(labels[:99], noise, strict=False):
        pairing(torch.rand(8, 1), {"task": some}, noise=drawn)
    with pytest.warns(RuntimeWarning, match=r"explains 4\d% of the variance of the noise"):
        pairing(torch.rand(8, 1), {"task": labels[99]}, noise=noise[99])


@pytest.mark.parametrize("several", [True, False])
def test_a_picture_that_is_one_cluster_everywhere_is_noticed(several):
    """Clusters fitted to raw pictures see one picture in normalised ones, without an error."""
    pairing, generator = PairedNoise(ConditionalOT(), generator=seeded()), seeded(1)
    picture = torch.ones(8, 3)

    def some():
        state = torch.randn(8, 2, generator=generator)
        condition = {"state": state, "picture": picture} if several else picture
        pairing(torch.randn(8, 1, generator=generator), condition)

    for _ in range(99):
        some()
    words = "'picture' of the condition" if several else "the condition"
    with pytest.warns(RuntimeWarning, match=f"{words} was the same in all 800 rows"):
        some()


def test_skew_without_rows():
    with pytest.raises(ValueError, match="skew needs noise that was paired with a condition"):
        PairedNoise(MinibatchOT()).skew()
    with pytest.raises(TypeError, match="coupling must be a coupling such as"):
        PairedNoise("ot")


# --- workers --------------------------------------------------------------------------------------


class Paired:
    """A collate function, which a worker can import."""

    def __init__(self, generator):
        self.pairing = PairedNoise(WITHIN, generator=generator)

    def __call__(self, rows):
        x1, c = (torch.stack(part) for part in zip(*rows, strict=True))
        return self.pairing(x1, c)


@pytest.mark.slow
@pytest.mark.parametrize(("start", "seed"), [("fork", 1), ("warm", None), ("warm", 1)])
def test_no_two_workers_hand_out_the_same_noise(start, seed, warm):
    x1, c = petals().sample(128, generator=seeded())
    rows = TensorDataset(x1, c)

    def sums(generator):
        loader = DataLoader(
            rows, 16, collate_fn=Paired(generator), num_workers=2, generator=seeded(7),
            multiprocessing_context=warm if start == "warm" else start,
        )  # fmt: skip
        return [round(float(noise.double().sum()), 6) for _ in range(2) for noise in loader]

    seen = sums(seed and seeded(seed))
    assert len(set(seen)) == len(seen) == 16  # of two workers in two epochs
    assert seen == sums(seed and seeded(2))  # the loader's seed decides, as in torch


def test_a_pickled_copy_goes_on_with_the_same_noise():
    paired = PairedNoise(ConditionalOT(), generator=seeded(3))
    paired(chunks(), torch.arange(24) % 3)
    copy = pickle.loads(pickle.dumps(paired))
    expected = paired(chunks(), torch.arange(24) % 3)
    assert torch.equal(copy(chunks(), torch.arange(24) % 3), expected)


@pytest.mark.parametrize("coupling", [ConditionalOT, "ConditionalOT", None])
def test_a_class_or_a_name_is_no_coupling(coupling):
    for call in (lambda: paired_noise(coupling, chunks()), lambda: PairedNoise(coupling)):
        with pytest.raises(TypeError, match="coupling must be a coupling such as ConditionalOT"):
            call()


def test_a_training_on_pictures_is_tested_by_some_of_their_columns():
    """From 4,000 numbers on the test raised an error, after minutes."""
    paired, labels = PairedNoise(Independent()), torch.arange(32) % 4
    for seed in range(101):
        paired(chunks(32, 40, 103, seed=seed), labels)
    assert abs(paired.skew().explained) < 0.05


@pytest.mark.filterwarnings("error")
def test_batches_in_which_nothing_varies_are_not_tested():
    paired = PairedNoise(ConditionalOT())
    for seed in range(400):
        paired(chunks(1, seed=seed), torch.tensor([seed % 4]))
    with pytest.raises(ValueError, match="some column of the actions varies"):
        paired.skew()


def test_a_condition_that_changes_its_form_is_refused_at_once():
    """It was found a hundred batches later, as an error of `torch.cat`."""
    paired, labels = PairedNoise(ConditionalOT()), torch.arange(24) % 4
    paired(chunks(), labels)
    with pytest.raises(ValueError, match=r"one form in all batches, labels \(B,\); got \(B, 4\)"):
        paired(chunks(), torch.eye(4)[labels])


@pytest.mark.parametrize("coupling", [MinibatchOT(), WITHIN, ConditionalOT()])
def test_a_constant_of_all_actions_changes_no_pair_of_padded_steps(coupling):
    """Padded steps counted as zero, so that those that were there got noise near the constant."""
    actions, noise, label = chunks(64), chunks(64, seed=1), torch.arange(64) % 4
    is_pad = torch.arange(4) >= torch.randint(1, 6, (64, 1), generator=seeded(2))
    one, other = (
        paired_noise(coupling, a, label, is_pad=is_pad, noise=noise, generator=seeded())
        for a in (actions, actions + 3.0)
    )
    assert torch.equal(one, other)


def test_what_is_padded_may_be_anything():
    actions, is_pad = chunks(), torch.zeros(24, 4, dtype=torch.bool)
    is_pad[:, 3] = True
    actions[:, 3] = torch.nan
    assert (
        paired_noise(ConditionalOT(), actions, is_pad=is_pad, condition=chunks()[:, 0])
        .isfinite()
        .all()
    )


@pytest.mark.parametrize("c", [2**40 + torch.arange(24)[:, None] % 4, chunks()[:, 0] + 1j])
def test_conditions_that_would_merge_are_refused(c):
    with pytest.raises((TypeError, ValueError), match=r"condition (has integers|must hold real)"):
        paired_noise(WITHIN, chunks(), c)


@pytest.mark.parametrize(
    "coupling",
    [
        centred(MinibatchOT(), lambda c: 3 * c),
        ConditionalOT(math.inf, condition=KMeansCondition(4).fit(torch.randn(64, 2))),
        StratifiedOT(KMeansCondition(4).fit(torch.randn(64, 2))),
    ],
    ids=["a mean", "a condition", "clusters"],
)
def test_numbers_that_a_batch_makes_up_reach_no_function(coupling):
    """A mean got standardised columns: the condition explained 94 % of the noise."""
    states = 20 + 5 * torch.randn(64, 2, generator=seeded())
    labels = torch.arange(64) % 3
    for made_up, kind in (({"state": states}, "a dictionary"), (labels, "labels")):
        with pytest.raises(ValueError, match=f"as .* takes it, got {kind}"):
            paired_noise(coupling, 0.1 * states, made_up)
    paired_noise(coupling, 0.1 * states, states)
    paired_noise(StratifiedOT(2), 0.1 * states, {"state": states})  # clusters of the batch
