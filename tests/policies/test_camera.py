import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch

from cotlearn.couplings import Independent
from cotlearn.flows.diffusion import Diffusion
from cotlearn.flows.matching import conditional_flow_matching_loss
from cotlearn.flows.solvers import integrate
from cotlearn.policies import choice, pixels
from cotlearn.policies.choice import choose, with_choice
from cotlearn.policies.methods import METHODS
from cotlearn.policies.options import Options
from cotlearn.policies.pixels import CameraLoss, CameraNetwork, Pixels, TurnedMLP
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.samplers import FlowSampler
from cotlearn.policies.settings import COMPARED
from cotlearn.policies.training import train
from cotlearn.randomness import generator_for
from cotlearn.storage import load_tensors, save_tensors

CAMERA = Pixels(size=16, features=3, components=4, condition_clusters=5)
SMALL = Options(steps=4, batch_size=16, width=16, blocks=1, clusters=20, ot_batch_size=32)
SMALL = replace(SMALL, condition_weight=1.0, camera=CAMERA, reflow_pairs=100, reflow_nfe=2)


@pytest.fixture(scope="module")
def windows(episodes):
    return SMALL.windows(episodes)


@pytest.fixture(scope="module")
def data(episodes, windows):
    return windows.dataset(episodes, label="intention")


@pytest.fixture(scope="module")
def network(windows):
    return SMALL.make_network(windows, seed=0)


def _turn(x, angle):
    """Chunks (B, 2 n) turned by an angle."""
    cos, sin = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[cos, -sin], [sin, cos]])
    return (x.unflatten(1, (-1, 2)) @ turn.T).flatten(1)


def test_a_network_that_sees(network, data):
    c, x = data.c[:6], torch.randn(6, network.dim, generator=torch.Generator().manual_seed(0))
    v = network(0.3, x, c)
    assert v.shape == x.shape
    assert isinstance(network, CameraNetwork)
    assert network.head.inner.condition_dim == 2 * (2 + 2) + 3
    features = network.encode(c)
    assert features.shape == (6, 4 + 3 + 4)
    assert torch.equal(network.head(0.3, x, features), v)
    other = c.clone()
    other[:, 2:6] += 1  # where the T was a step ago
    assert torch.equal(network(0.3, x, other), v)
    other[:, 8] += 1  # where it is
    assert not torch.allclose(network(0.3, x, other), v)


def test_the_pose_error_of_the_true_pose_is_zero(network, data, episodes):
    c = data.c[:9]
    now = network.camera.scenes(c)[:, -1]
    assert now[:, :4].numpy() == pytest.approx(episodes.state[:9, :4], abs=1e-3)
    pose = torch.cat([(now[:, 2:4] - 256) / 128, now[:, 4:]], dim=1)
    features = torch.cat([pose, torch.zeros(9, 7)], dim=1)
    assert network.pose_error(features, c).max() < 1e-6
    features[:, 0] += 0.5
    assert network.pose_error(features, c).numpy() == pytest.approx(0.25, abs=1e-5)


def test_a_turned_world_gets_a_turned_velocity():
    """All but the goal, which stays where it is, looks the same from a T that was turned."""
    head = TurnedMLP(8, 2, 2, width=16, blocks=1, seed=0)
    generator = torch.Generator().manual_seed(0)
    x, free = torch.randn(5, 8, generator=generator), torch.randn(5, 2, generator=generator)
    seen = []
    head.inner.register_forward_pre_hook(lambda _, inputs: seen.append(inputs))
    for angle in (0.0, 0.7):
        place = _turn(torch.tensor([[0.4, -0.2]]), angle).expand(5, 2)
        facing = torch.tensor([[math.cos(1 + angle), math.sin(1 + angle)]]).expand(5, 2)
        hand = _turn(torch.randn(5, 4, generator=torch.Generator().manual_seed(1)), angle)
        v = head(0.5, _turn(x, angle), torch.cat([place, 3 * facing, free, hand], dim=1))
        seen[-1] = (*seen[-1], _turn(v, -angle))
    (_, x0, c0, _), (_, x1, c1, _) = seen
    assert torch.allclose(x0, x1, atol=1e-5)  # a chunk as seen from the T
    assert torch.allclose(c0[:, :4], c1[:, :4], atol=1e-5)  # places of the hand
    assert torch.equal(c0[:, 8:], free)
    assert not torch.allclose(c0[:, 4:8], c1[:, 4:8])  # the goal has not been turned


def test_shifted_pictures():
    pictures = torch.arange(2 * 5 * 6 * 3).view(2, 5, 6, 3).to(torch.uint8)
    assert pixels.shifted(pictures, 0) is pictures
    seen = set()
    rows, columns = np.meshgrid(range(5), range(6), indexing="ij")
    for seed in range(60):
        moved = pixels.shifted(pictures, 1, torch.Generator().manual_seed(seed))
        for image, original in zip(moved, pictures, strict=True):
            match = []
            for down, right in product((-1, 0, 1), repeat=2):
                found = original[(rows + down).clip(0, 4), (columns + right).clip(0, 5)]
                match += [(down, right)] if torch.equal(image, found) else []
            assert len(match) == 1
            seen.update(match)
    assert len(seen) == 9


@pytest.mark.parametrize("loss", [conditional_flow_matching_loss, Diffusion().loss])
def test_the_loss_is_that_of_the_head_and_of_the_pose(network, data, loss):
    pairs = Independent()(torch.randn(20, network.dim), data.x1[:20], data.c[:20])
    plain = CameraLoss(loss, pose=0.0)(network, pairs, generator_for(0, 0))
    assert torch.allclose(plain, loss(network, pairs, generator_for(0, 0)), atol=1e-4)
    both = CameraLoss(loss, pose=2.0)(network, pairs, generator_for(0, 0))
    error = network.pose_error(network.encode(pairs.c), pairs.c)
    assert torch.allclose(both, plain + 2 * error, atol=1e-4)


def test_one_look_for_a_chunk(network, windows, episodes):
    policy = ChunkPolicy(network, windows, FlowSampler(4))
    history = windows.cut(episodes)[0][:5]
    noise = policy.noise(5, torch.Generator().manual_seed(0))
    looks = []
    hook = network.encoder.register_forward_hook(lambda *_: looks.append(1))
    actions = policy.chunk(history, noise=noise)
    hook.remove()
    assert looks == [1]
    c = windows.condition(history)
    x = integrate(network, noise[0], c, nfe=4).x1
    expected = windows.actions(x, history).clip(0, 512)
    assert actions == pytest.approx(expected, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("method", [*COMPARED, "conditional_ot", "stratified", "mean_flow"])
def test_every_method_trains_and_is_kept(episodes, method, tmp_path):
    made = [train(method, episodes, options=SMALL, progress=False).policy for _ in range(2)]
    weights = zip(*(policy.network.parameters() for policy in made), strict=True)
    assert all(torch.equal(a, b) for a, b in weights)
    policy = made[0]
    history = np.repeat(episodes.state[:3, None], 2, axis=1)
    policy.save(tmp_path / "p.safetensors")
    back = ChunkPolicy.load(tmp_path / "p.safetensors")
    noise = policy.noise(3, torch.Generator().manual_seed(0))
    assert np.array_equal(policy.act(history, noise=noise), back.act(history, noise=noise))
    clusters = method in ("conditional_ot", "stratified", "residual")
    fitted = {"mean", "basis", "centroids", "limit", "scale"} if clusters else set()
    assert set(back.fitted) == fitted
    assert all(torch.equal(back.fitted[name], policy.fitted[name]) for name in back.fitted)
    policy.save(tmp_path / "half.safetensors", half=True)
    near = ChunkPolicy.load(tmp_path / "half.safetensors")
    assert near.network.camera == policy.network.camera
    assert near.act(history, noise=noise) == pytest.approx(policy.act(history, noise=noise), abs=5)
    for sampler in policy.sampler.variants:
        if sampler.draws == 1:
            assert policy.with_sampler(sampler).act(history).shape == (3, 8, 2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size": 10**6}, "size must be at most 1024, got 1000000"),
        ({"size": 0}, "size must be at least 1"),
        ({"observe": 10**12}, "the shape"),
        ({"low": [0.0]}, r"low must have shape \(6,\)"),
        ({"high": [math.inf] * 6}, "high has NaN or infinite values"),
    ],
)
def test_a_file_with_another_camera(network, windows, tmp_path, change, message):
    """It is refused when it is loaded; an image of 10^6 pixels squared is not even tried."""
    path = tmp_path / "crafted.safetensors"
    ChunkPolicy(network, windows, FlowSampler()).save(path)
    tensors, record = load_tensors(path)
    record["policy"]["network"]["camera"] |= change
    save_tensors(path, tensors, record)
    with pytest.raises(ValueError, match=f"crafted.safetensors .*{message}"):
        ChunkPolicy.load(path)


def test_the_coupling_sees_pictures(data, windows):
    seen = METHODS["stratified"].fitted_pictures(SMALL, data, windows)
    assert seen.labels(data.c).unique().numel() == 20
    camera = SMALL.camera.camera(windows)
    assert torch.equal(seen.labels(data.c), seen.inner.labels(camera(data.c)))
    other = data.c.clone()
    other[:, 2:6] = 0  # where the T was a step ago is in no picture
    assert torch.equal(seen.labels(other), seen.labels(data.c))
    assert METHODS["independent"].fitted_pictures(SMALL, data, windows) is None
    assert METHODS["stratified"].coupling(SMALL, seen).clusters is seen
    few = METHODS["conditional_ot"].fitted_pictures(SMALL, data, windows)
    assert few.labels(data.c).unique().numel() == 5


def test_bad_options():
    with pytest.raises(ValueError, match="frame must be agent with a camera, got body"):
        replace(SMALL, frame="body")
    with pytest.raises(ValueError, match="size must be at least 1"):
        Pixels(size=0)


def test_the_frontier_can_be_asked_for_pictures(episodes, monkeypatch):
    monkeypatch.setattr(choice, "FRONTIER_ROWS", 128)
    monkeypatch.setattr(choice, "FACTORS", (1.0, 100.0))
    chosen = choose("conditional_ot", episodes, replace(SMALL, condition_weight=None))
    assert chosen["option"] == "condition_weight"
    assert len(chosen["frontier"]) == 3
    balanced = replace(SMALL, condition_weight="balanced")
    assert with_choice("conditional_ot", None, balanced) is balanced  # COT Policy's rule
