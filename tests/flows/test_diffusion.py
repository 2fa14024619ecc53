import math

import pytest
import torch
from peers import peer
from support import refused, seeded

from cotlearn.couplings import Independent, Pairs
from cotlearn.datasets import Dataset
from cotlearn.flows import fit
from cotlearn.flows.diffusion import Diffusion, predict, regression_loss
from cotlearn.flows.networks import VelocityMLP

MEAN, DEVIATION = torch.tensor([0.5, -0.2]), torch.tensor([0.3, 0.1])


def optimal(diffusion):
    """The network that predicts its E[target | x_k] for independent Gaussian coordinates."""

    def network(t, x, c=None):
        kept = diffusion.alphas_cumprod[(t * diffusion.levels).round().long()].to(x)
        signal, rest = kept.sqrt(), (1 - kept).sqrt()
        residual = (x - signal * MEAN.to(x)) / (kept * DEVIATION.to(x) ** 2 + 1 - kept)
        noise = rest * residual
        data = MEAN.to(x) + signal * DEVIATION.to(x) ** 2 * residual
        targets = {"noise": noise, "data": data, "velocity": signal * noise - rest * data}
        return targets[diffusion.prediction]

    return network


def trained(network, data, loss, steps):
    options = {"steps": steps, "batch_size": 128, "progress": False}
    return fit(network, data, Independent(), loss=loss, **options).network


#: Every target that a network can predict, with zero terminal SNR where that can be sampled.
MODELS = [("noise", False), ("data", True), ("velocity", True)]


def noise(*shape, seed=0):
    return torch.randn(*shape, generator=seeded(seed), dtype=torch.float64)


def test_the_schedule():
    kept = Diffusion(100).alphas_cumprod
    assert kept.shape == (100,)
    assert (kept.diff() < 0).all()

    def f(time):
        return math.cos((time + 0.008) / 1.008 * math.pi / 2) ** 2

    for k in (0, 10, 50, 90):  # before beta is cut, the product telescopes
        assert kept[k].item() == pytest.approx(f((k + 1) / 100) / f(0), rel=1e-9)
    assert kept[-1] < 1e-5


def test_zero_terminal_snr():
    before = Diffusion(100).alphas_cumprod
    after = Diffusion(100, prediction="data", zero_terminal_snr=True).alphas_cumprod
    assert after[0].item() == pytest.approx(before[0].item(), rel=1e-12)
    assert after[-1] == 0
    assert (after.diff() < 0).all()
    rescaling = peer("diffusers.schedulers.scheduling_ddim")
    ratio = before / torch.cat([torch.ones(1, dtype=before.dtype), before[:-1]])
    judge = rescaling.rescale_zero_terminal_snr(1 - ratio)
    assert torch.allclose((1 - judge).cumprod(dim=0), after, atol=1e-9)


@pytest.mark.parametrize(("prediction", "zero"), MODELS)
def test_one_trailing_step_of_pure_noise_is_the_mean(prediction, zero):
    diffusion = Diffusion(100, clip=None, prediction=prediction, zero_terminal_snr=zero)
    x = diffusion.ddim(optimal(diffusion), noise(50, 2), nfe=1, spacing="trailing")
    assert torch.allclose(x, MEAN.expand_as(x).double(), atol=1e-9 if zero else 0.01)


@pytest.mark.parametrize(("prediction", "zero"), MODELS)
def test_ddpm_on_gaussian_data(prediction, zero):
    """The sample is affine in its noises: it is known from its values at 0 and at each of them."""
    diffusion = Diffusion(500, clip=None, prediction=prediction, zero_terminal_snr=zero)
    each = torch.cat([torch.zeros(500, 1), torch.eye(500)], dim=1).double()
    each = each[..., None].expand(-1, -1, 2)
    x = diffusion.ddpm(optimal(diffusion), each[0], noise=each[1:])
    assert torch.allclose(x[0], MEAN.double(), atol=0.01)
    assert torch.allclose((x[1:] - x[0]).norm(dim=0), DEVIATION.double(), rtol=0.04)


@pytest.mark.parametrize(("prediction", "zero"), MODELS)
def test_ddim_on_gaussian_data_is_the_map_it_should_be(prediction, zero):
    diffusion = Diffusion(1000, clip=None, prediction=prediction, zero_terminal_snr=zero)
    x0 = noise(100, 2)
    fine = diffusion.ddim(optimal(diffusion), x0, nfe=1000)
    assert torch.allclose(fine, MEAN + DEVIATION * x0, atol=0.003)  # the probability flow's
    coarse = diffusion.ddim(optimal(diffusion), x0, nfe=4, spacing="trailing")
    assert (coarse - fine).abs().max() > 0.02
    assert torch.equal(fine, diffusion.ddim(optimal(diffusion), x0, nfe=1000))


def test_levels():
    diffusion = Diffusion(100)
    assert diffusion.ddim_levels(4) == [75, 50, 25, 0]
    assert diffusion.ddim_levels(4, "trailing") == [99, 74, 49, 24]
    assert diffusion.ddim_levels(16)[:2] == [90, 84]
    assert diffusion.ddim_levels(100) == diffusion.ddim_levels(100, "trailing")


def test_noise_drawn_before_gives_the_same_samples_row_by_row():
    diffusion = Diffusion(10)
    network = VelocityMLP(2, seed=0).double()
    start, fresh = noise(6, 2), noise(9, 6, 2, seed=1)
    all_rows = diffusion.ddpm(network, start, noise=fresh)
    some = diffusion.ddpm(network, start[2:4], noise=fresh[:, 2:4])
    assert torch.allclose(all_rows[2:4], some)
    assert all_rows.abs().max() <= 1 + 1e-9  # the last step returns the clipped x1


@pytest.mark.parametrize("clip", [None, 1.0])
def test_against_diffusers(clip):
    diffusers = peer("diffusers")
    options = {
        "num_train_timesteps": 100,
        "beta_schedule": "squaredcos_cap_v2",
        "clip_sample": clip is not None,
    }
    ours = Diffusion(100, clip=clip)
    network = VelocityMLP(2, seed=0)
    x0, fresh = noise(8, 2).float(), noise(99, 8, 2, seed=1).float()

    for nfe, spacing in ((4, "leading"), (16, "leading"), (4, "trailing"), (100, "leading")):
        judge = diffusers.DDIMScheduler(**options, timestep_spacing=spacing)
        assert torch.allclose(judge.alphas_cumprod, ours.alphas_cumprod.float(), atol=1e-6)
        judge.set_timesteps(nfe)
        x = x0
        for k in judge.timesteps:
            x = judge.step(network(k / 100, x).detach(), k, x).prev_sample
        assert torch.allclose(ours.ddim(network, x0, nfe=nfe, spacing=spacing), x, atol=2e-4)

    judge = diffusers.DDPMScheduler(**options)
    x = x0
    for number, k in enumerate(reversed(range(100))):
        if k:
            spread = judge._get_variance(k).sqrt()
        x = judge.step(network(k / 100, x).detach(), k, x).prev_sample
        if k:
            x = x + spread * fresh[number]
    assert torch.allclose(ours.ddpm(network, x0, noise=fresh), x, atol=2e-4)


@pytest.fixture(autouse=True)
def _no_noise_in_the_judge(monkeypatch):
    """diffusers' DDPM adds its own noise; here it adds zeros, and the test adds ours."""
    try:
        from diffusers.schedulers import scheduling_ddpm
    except ImportError:
        return
    monkeypatch.setattr(scheduling_ddpm, "randn_tensor", lambda shape, **_: torch.zeros(shape))


@pytest.mark.slow
@pytest.mark.parametrize(("prediction", "zero"), MODELS)
def test_training_with_fit(prediction, zero):
    """A network that predicts the noise needs data of a small range, and its clipping."""
    spread = torch.tensor([1.0, 0.8]) if zero else DEVIATION
    generator = seeded()
    data = Dataset(MEAN + spread * torch.randn(4000, 2, generator=generator))
    clip = None if zero else 1.0
    diffusion = Diffusion(20, clip=clip, prediction=prediction, zero_terminal_snr=zero)
    network = trained(VelocityMLP(2, width=64, seed=0), data, diffusion.loss, 500)
    fresh = noise(19, 4000, 2, seed=1).float()
    x = diffusion.ddpm(network, noise(4000, 2).float(), noise=fresh)
    assert torch.allclose(x.mean(dim=0), MEAN, atol=0.1 if zero else 0.05)
    assert torch.allclose(x.std(dim=0), spread, atol=0.15 if zero else 0.09)


def test_regression_learns_the_conditional_mean():
    generator = seeded()
    c = torch.randint(2, (4000, 1), generator=generator).float()
    data = Dataset(2 * c - 1 + 0.5 * torch.randn(4000, 1, generator=generator), c)
    network = trained(VelocityMLP(1, 1, width=32, seed=0), data, regression_loss, 300)
    mean = predict(network, torch.randn(2, 1), torch.tensor([[0.0], [1.0]]))
    assert torch.allclose(mean, torch.tensor([[-1.0], [1.0]]), atol=0.1)


NET, X = VelocityMLP(2), torch.zeros(3, 2)
test_bad_input = refused(
    (lambda: Diffusion(1), "levels must be at least 2"),
    (lambda: Diffusion(10, clip=0.0), "clip must be above 0"),
    (lambda: Diffusion(prediction="x0"), "prediction must be one of velocity, data, noise"),
    (lambda: Diffusion(zero_terminal_snr=True), "prediction must be data or velocity"),
    (lambda: Diffusion(10).ddim_levels(11), "nfe must be at most the 10 levels"),
    (lambda: Diffusion(10).ddim_levels(2, "even"), "spacing must be one of leading, trailing"),
    (lambda: Diffusion(10).ddpm(NET, X, noise=X), r"noise must have shape \(9, 3, 2\)"),
    (lambda: Diffusion(10).ddim(NET, X, X[:2, :1], nfe=2), "condition_dim=0, but got c"),
    error=ValueError,
)


def test_data_beyond_the_clip_are_named():
    x, rows = 4 * torch.ones(8, 2), torch.arange(8)
    with pytest.warns(UserWarning, match="x1 reaches 4, and samples are clipped to 1"):
        Diffusion().loss(lambda t, x, c: x, Pairs(x, x, None, rows, rows), seeded())


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_has_the_noise_of_its_level(dtype):
    """1 - a was formed in half precision: the first twenty levels had no noise at all."""
    diffusion, seen = Diffusion(levels=1000, clip=None), []

    def network(t, x, c):
        seen.append(x.double())
        return torch.zeros_like(x)

    ones = torch.ones(20_000, 1, dtype=dtype)
    index = torch.arange(len(ones))
    diffusion.loss(network, Pairs(ones, 0 * ones, None, index, index), seeded())
    k = torch.randint(1000, (len(ones),), generator=seeded())
    right = (1 - diffusion.alphas_cumprod.double()).sqrt()[k]
    assert torch.allclose(seen[0][:, 0], right, rtol=0.01)
