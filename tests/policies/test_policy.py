import copy
import time
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from safetensors.torch import save_file

import cotlearn.robots  # noqa: F401  (registers the environment)
from cotlearn.flows.diffusion import Diffusion
from cotlearn.flows.networks import ResidualMLP, VelocityMLP
from cotlearn.flows.solvers import integrate
from cotlearn.policies import samplers
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.samplers import DDIMSampler, DDPMSampler, FlowSampler, MeanSampler
from cotlearn.policies.windows import Windows
from cotlearn.storage import load_tensors, save_tensors

SAMPLERS = [
    *(FlowSampler(2), FlowSampler(2, "midpoint"), FlowSampler(2, prediction="data")),
    *(DDIMSampler(4), DDIMSampler(2, spacing="trailing", prediction="data")),
    *(DDPMSampler(10), DDPMSampler(10, prediction="velocity"), MeanSampler()),
]


@pytest.fixture(scope="module")
def windows(episodes):
    return Windows.fit(episodes)


@pytest.fixture(scope="module")
def network(windows):
    return ResidualMLP(windows.dim, windows.condition_dim, width=16, blocks=1, context=8, seed=0)


@pytest.fixture(scope="module")
def history(windows, episodes):
    return windows.cut(episodes)[0][:5]


@pytest.mark.parametrize("sampler", SAMPLERS, ids=str)
def test_a_policy_acts(network, windows, history, sampler):
    policy = ChunkPolicy(network, windows, sampler)
    actions = policy.act(history, generator=torch.Generator().manual_seed(0))
    assert actions.shape == (5, 8, 2)
    assert ((actions >= 0) & (actions <= 512)).all()
    noise = policy.noise(5, torch.Generator().manual_seed(0))
    assert np.array_equal(actions, policy.act(history, noise=noise))
    one = policy.act(history[2:3], noise=noise[:, 2:3])
    assert np.allclose(one, actions[2:3], atol=1e-2)  # an episode does not see its neighbours
    assert np.array_equal(policy.chunk(history, noise=noise)[:, :8], actions)


def test_the_first_noise_is_the_same_for_all(network, windows):
    policies = [ChunkPolicy(network, windows, sampler) for sampler in SAMPLERS]
    first, *draws = (p.noise(3, torch.Generator().manual_seed(1))[0] for p in policies)
    assert all(torch.equal(first, other) for other in draws)


def test_chunks_by_hand(network, windows, history):
    noise = torch.randn(1, 5, 32, generator=torch.Generator().manual_seed(0))
    c = windows.condition(history)
    by_flow = integrate(network, noise[0], c, nfe=4).x1
    by_diffusion = Diffusion(100).ddim(network, noise[0], c, nfe=4)
    for sampler, x in ((FlowSampler(4), by_flow), (DDIMSampler(4), by_diffusion)):
        found = ChunkPolicy(network, windows, sampler).chunk(history, noise=noise)
        assert np.array_equal(found, windows.actions(x, history).clip(0, 512))


@pytest.mark.parametrize("sampler", SAMPLERS, ids=str)
def test_save_and_load(windows, history, tmp_path, sampler):
    network = ResidualMLP(32, 12, width=24, blocks=2, context=8, seed=1)
    policy = ChunkPolicy(network, windows, sampler, execute=4, about={"seed": 1})
    path = tmp_path / "policy.safetensors"
    policy.save(path)
    again = ChunkPolicy.load(path)
    assert again.about == {"seed": 1}
    noise = policy.noise(5)
    assert np.array_equal(again.act(history, noise=noise), policy.act(history, noise=noise))
    assert again.sampler == sampler
    policy.save(tmp_path / "half.safetensors", half=True)
    assert (tmp_path / "half.safetensors").stat().st_size < path.stat().st_size
    half = ChunkPolicy.load(tmp_path / "half.safetensors")
    assert np.allclose(half.act(history, noise=noise), policy.act(history, noise=noise), atol=20)


def test_temperature_scales_the_noise(network, windows, history, tmp_path):
    policy = ChunkPolicy(network, windows, FlowSampler(2), temperature=0.5)
    noise = policy.noise(5)
    warm = replace(policy, temperature=1.0)
    assert np.array_equal(policy.chunk(history, noise=noise), warm.chunk(history, noise=noise / 2))
    policy.save(tmp_path / "policy.safetensors")
    assert ChunkPolicy.load(tmp_path / "policy.safetensors").temperature == 0.5
    with pytest.raises(ValueError, match="temperature must be at least 0 and finite, got -1"):
        replace(policy, temperature=-1.0)


def test_a_network_that_predicts_the_data_has_no_velocity_at_the_end():
    with pytest.raises(ValueError, match="method must be one of euler, midpoint; got 'heun'"):
        FlowSampler(2, "heun", prediction="data")


def test_latency_and_another_sampler(network, windows):
    policy = ChunkPolicy(network, windows, FlowSampler(1))
    assert 0 < policy.latency(repetitions=3) < 1
    slow = policy.with_sampler(FlowSampler(64))
    assert slow.network is policy.network
    assert slow.latency(repetitions=3) > 3 * policy.latency(repetitions=3)


OTHER = [DDPMSampler(), FlowSampler(1, prediction="data"), MeanSampler(), samplers.JumpSampler(1)]


@pytest.mark.parametrize("other", OTHER)
def test_a_sampler_must_fit_the_training(network, windows, other):
    policy = ChunkPolicy(network, windows, FlowSampler(1))
    with pytest.raises(ValueError, match="sampler must be for the training 'flow, velocity', got"):
        policy.with_sampler(other)


def test_a_policy_drives_gymnasiums_vector_environment(network, windows):
    worlds = gymnasium.make_vec("cotlearn/PushT-v0", num_envs=2)
    state, _ = worlds.reset(seed=1)
    history = np.repeat(state[:, None], 2, axis=1)
    policy = ChunkPolicy(network, windows, FlowSampler(1))
    for action in policy.act(history).transpose(1, 0, 2)[:2]:
        state, *_ = worlds.step(action.astype(np.float32))
    assert state.shape == (2, 5)
    worlds.close()


NARROW, STATES = ResidualMLP(16, 12), np.zeros((3, 2, 5))


@pytest.mark.parametrize(
    ("changes", "history", "noise", "message"),
    [
        ({"execute": 17}, None, None, "execute must be at most the 16"),
        ({"execute": 0}, None, None, "execute must be at least 1"),
        ({"network": NARROW}, None, None, "network has dim 16, but these windows need 32"),
        ({"network": VelocityMLP(32)}, None, None, "network has condition_dim 0"),
        ({}, STATES[:, :1], None, r"history must have shape \(any, 2, 5\)"),
        ({}, STATES * np.nan, None, "history has NaN"),
        ({}, STATES, torch.zeros(2, 3, 32), r"noise must have shape \(1, 3, 32\)"),
        ({"sampler": FlowSampler(3, "midpoint")}, STATES, None, "nfe must be divisible by 2"),
    ],
)
def test_what_does_not_fit(windows, network, changes, history, noise, message):
    given = {"network": network, "windows": windows, "sampler": FlowSampler(), **changes}
    with pytest.raises(ValueError, match=message):
        ChunkPolicy(**given).act(history, noise=noise)


def test_a_network_that_went_wrong(windows, history):
    network = ResidualMLP(32, 12, width=8, blocks=1, seed=0)
    with torch.no_grad():
        network.last[-1].bias.fill_(torch.nan)
    with pytest.raises(RuntimeError, match="not finite"):
        ChunkPolicy(network, windows, MeanSampler()).act(history)


JUMP = {"kind": "JumpSampler", "prediction": "velocity"}
DDPM = {"kind": "DDPMSampler", "prediction": "noise"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"network": {"blocks": 3_000_000}}, "3000000 layers cannot have"),
        ({"network": {"blocks": 2}}, "blocks.1"),
        ({"network": {"width": 10**7}}, "expected .*10000000"),
        ({"network": {"width": "wide"}}, "width must be an integer"),
        ({"windows": {"action_range": [[-1.0], [1.0]]}}, r"action_range must have shape \(2, 2\)"),
        ({"windows": {"action_range": [[-1.0] * 3] * 2}}, r"action_range must have shape \(2, 2\)"),
        ({"windows": {"observation_range": [0.0]}}, r"observation_range must have shape \(2, 6\)"),
        ({"windows": {"predict": 10**12, "knots": 16}}, "predict must be at most 10000"),
        ({"sampler": {"nfe": 10**12}}, "nfe must be at most 10000"),
        ({"sampler": {**JUMP, "nfe": 10**12}}, "nfe must be at most 10000"),
        ({"sampler": {**DDPM, "levels": 20_000}}, "levels must be at most 10000"),
        ({"sampler": {**DDPM, "kind": "DDIMSampler", "levels": 20_000}}, "levels must be at most"),
        ({"sampler": {**DDPM, "clip": "much"}}, "clip must be"),
        ({"windows": 3}, "holds no policy that fits"),
    ],
)
def test_a_file_whose_claims_do_not_fit_its_weights(windows, network, tmp_path, change, message):
    path = tmp_path / "crafted.safetensors"
    ChunkPolicy(network, windows, FlowSampler()).save(path)
    tensors, record = load_tensors(path)
    for name, new in change.items():
        some = isinstance(new, dict) and "kind" not in new
        record["policy"][name] = {**record["policy"][name], **new} if some else new
    save_tensors(path, tensors, record)
    begun = time.monotonic()
    with pytest.raises(ValueError, match=f"crafted.safetensors .*{message}"):
        ChunkPolicy.load(path)
    assert time.monotonic() - begun < 20  # three million blocks take minutes


def test_foreign_weights(windows, network, tmp_path):
    with pytest.raises(FileNotFoundError):
        ChunkPolicy.load(tmp_path / "none.safetensors")
    path = tmp_path / "other.safetensors"
    save_file({"x": torch.zeros(3)}, path)
    with pytest.raises(ValueError, match="damaged or was not written by cotlearn"):
        ChunkPolicy.load(path)
    save_tensors(path, {"x": torch.zeros(3)}, {})
    with pytest.raises(ValueError, match="holds no policy"):
        ChunkPolicy.load(path)
    with pytest.raises(TypeError, match="MeanVelocity to save it, got VelocityMLP"):
        ChunkPolicy(VelocityMLP(32, 12), windows, FlowSampler()).save(tmp_path / "x.safetensors")


def test_weights_too_large_for_half_precision_are_not_stored(windows, network, tmp_path):
    """They were infinite in the file, and loaded without a word."""
    large = copy.deepcopy(network)
    with torch.no_grad():
        large.first.weight.mul_(1e6)
    policy = ChunkPolicy(large, windows, FlowSampler(1))
    with pytest.raises(ValueError, match=r"half must be False: first\.weight exceeds 65504"):
        policy.save(tmp_path / "policy.safetensors", half=True)
    policy.save(tmp_path / "policy.safetensors")


def test_a_policy_acts_whatever_torch_s_default_type(windows, network, history):
    policy = ChunkPolicy(network, windows, FlowSampler(1))
    torch.set_default_dtype(torch.float64)
    try:
        found = policy.act(history, generator=torch.Generator().manual_seed(0))
    finally:
        torch.set_default_dtype(torch.float32)
    right = policy.act(history, generator=torch.Generator().manual_seed(0))
    assert np.isfinite(found).all()
    assert found.shape == right.shape
