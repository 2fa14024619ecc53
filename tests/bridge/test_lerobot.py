"""LeRobot's policies with paired noise: its own classes, and models of the same shape."""

import copy
from types import SimpleNamespace

import pytest
import torch
from peers import lerobot
from support import refused, seeded

from cotlearn.bridge import PairedNoise, pair_lerobot, paired_noise
from cotlearn.couplings import ConditionalOT, MinibatchOT

STATE, BLOCK, ACTION, PAD = (
    "observation.state",
    "observation.environment_state",
    "action",
    "action_is_pad",
)


def batch(rows=8, steps=16, width=2):
    generator = seeded(rows)
    pad = torch.arange(steps) >= steps - torch.arange(rows)[:, None]  # row i ends i steps early
    return {
        STATE: torch.randn(rows, 2, 2, generator=generator),
        BLOCK: torch.randn(rows, 2, 16, generator=generator),
        ACTION: torch.randn(rows, steps, width, generator=generator),
        PAD: pad,
    }


def pairing():
    return PairedNoise(ConditionalOT(), generator=seeded(2))


def expected(given, actions=None):
    """The noise that `pairing` hands out first, given the states."""
    actions = given[ACTION] if actions is None else actions
    states = {name: given[name] for name in (STATE, BLOCK) if name in given}
    return paired_noise(
        ConditionalOT(), actions, states, is_pad=given.get(PAD), generator=seeded(2)
    )


# --- its diffusion policy -------------------------------------------------------------------------


def diffusion(**options):
    lerobot()
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
    from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy

    inputs = {
        STATE: PolicyFeature(FeatureType.STATE, (2,)),
        BLOCK: PolicyFeature(FeatureType.ENV, (16,)),
    }
    if options.pop("pictures", False):
        inputs["observation.image"] = PolicyFeature(FeatureType.VISUAL, (3, 96, 96))
        options |= {"pretrained_backbone_weights": None, "crop_shape": None}
    options = {"horizon": 16, "n_action_steps": 8, "down_dims": (32, 64)} | options
    outputs = {ACTION: PolicyFeature(FeatureType.ACTION, (2,))}
    config = DiffusionConfig(
        input_features=inputs, output_features=outputs, device="cpu", **options
    )
    return DiffusionPolicy(config)


class Recorded(torch.nn.Module):
    """A network that keeps what it was given, and returns the same velocity everywhere."""

    def __init__(self, velocity):
        super().__init__()
        self.velocity, self.given = torch.nn.Parameter(velocity), []

    def forward(self, x, t, global_cond=None):
        self.given.append((x, t, global_cond))
        return self.velocity.expand_as(x)


@pytest.mark.slow
def test_a_diffusion_policy_trains_as_a_flow_on_paired_noise():
    policy, given = diffusion(), batch()
    policy.diffusion.unet = network = Recorded(torch.tensor([1.0, -2.0]))
    with pair_lerobot(policy, pairing()):
        loss, _ = policy.forward(given)
    (x_t, t, seen) = network.given[0]
    time, noise = (t / 100)[:, None, None], expected(given)
    assert torch.allclose(x_t, (1 - time) * noise + time * given[ACTION], atol=1e-5)
    assert torch.equal(seen, torch.cat([given[STATE], given[BLOCK]], dim=2).flatten(1))
    error = (network.velocity - (given[ACTION] - noise)).square()
    assert torch.allclose(loss, error.mean())


@pytest.mark.slow
def test_its_loss_leaves_padded_steps_out_if_it_is_told_to():
    policy, given = diffusion(do_mask_loss_for_padding=True), batch()
    policy.diffusion.unet = network = Recorded(torch.zeros(2))
    with pair_lerobot(policy, pairing()):
        loss, _ = policy.forward(given)
    error = (given[ACTION] - expected(given)).square()[~given[PAD]]
    assert torch.allclose(loss, error.mean())
    assert len(network.given) == 1


@pytest.mark.slow
def test_it_samples_in_euler_steps_and_remove_restores_the_diffusion():
    policy, noise = diffusion(clip_sample=False), torch.randn(4, 16, 2)
    policy.diffusion.unet = network = Recorded(torch.tensor([1.0, -2.0]))
    with pair_lerobot(policy, ConditionalOT(), nfe=4):
        assert "compute_loss" in vars(policy.diffusion)
        found = policy.diffusion.conditional_sample(4, noise=noise)
        policy.config.clip_sample, policy.config.clip_sample_range = True, 1.5
        clipped = policy.diffusion.conditional_sample(4, noise=noise)
    assert torch.equal(clipped, found.clamp(-1.5, 1.5))  # before, actions left the robot's range
    assert torch.allclose(found, noise + network.velocity, atol=1e-6)
    assert [float(t[0]) for _, t, _ in network.given[:4]] == [0, 25, 50, 75]
    assert not {"compute_loss", "conditional_sample"} & set(vars(policy.diffusion))


@pytest.mark.slow
def test_gradients_reach_the_network_and_a_copy_is_changed_like_the_policy():
    policy, given = diffusion(), batch()
    pair_lerobot(policy, ConditionalOT())
    twin = copy.deepcopy(policy)
    twin.forward(given)[0].backward()
    assert all(p.grad is None for p in policy.parameters())
    assert any(p.grad is not None and p.grad.abs().sum() > 0 for p in twin.parameters())
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.isfinite(policy.forward(given)[0])


@pytest.mark.slow
def test_another_horizon_is_refused_before_it_trains():
    policy = diffusion(horizon=64, n_action_steps=32)
    with (
        pair_lerobot(policy, ConditionalOT()),
        pytest.raises(ValueError, match="action has 16 steps, but horizon is 64"),
    ):
        policy.forward(batch())


@pytest.mark.slow
def test_pictures_need_a_condition_and_are_stacked_by_the_policy():
    policy, given = diffusion(pictures=True), batch()
    given["observation.image"] = torch.rand(8, 2, 3, 96, 96)
    with pytest.raises(ValueError, match="condition is missing: the policy sees pictures"):
        pair_lerobot(policy, ConditionalOT())
    read = lambda b: {"state": b[STATE], "kind": torch.arange(8) % 2}  # noqa: E731
    with pair_lerobot(policy, ConditionalOT(), condition=read):
        loss, _ = policy.forward(given)
    assert torch.isfinite(loss)


# --- its flow policies ----------------------------------------------------------------------------


class Objective:
    """What LeRobot 0.6's flow objective does: it draws noise by randn_like inside its loss."""

    def __init__(self, flow=True, draws=True):
        self.config, self.draws = SimpleNamespace(is_flow_matching=flow), draws

    def compute_loss(self, model, batch, seen):
        data = batch[ACTION]
        other = torch.randn_like(seen)  # of another shape: not the noise
        noise = torch.randn_like(data) if self.draws else torch.randn(data.shape)
        return noise, other, torch.randn_like(data) if self.draws else noise


def transformer(**options):
    return SimpleNamespace(config=SimpleNamespace(), objective=Objective(**options))


def test_the_first_noise_in_the_loss_of_a_transformer_is_paired():
    policy, given = transformer(), batch()
    with pair_lerobot(policy, pairing()):
        noise, other, later = policy.objective.compute_loss(None, given, torch.zeros(8, 3))
    assert torch.equal(noise, expected(given))
    assert other.shape == (8, 3)
    assert not torch.equal(later, noise)
    assert "compute_loss" not in vars(policy.objective)


def test_a_policy_that_is_paired_already_is_refused_until_that_is_removed():
    policy = transformer()
    first = pair_lerobot(policy, ConditionalOT())
    with pytest.raises(ValueError, match=r"policy is paired already: call remove\(\)"):
        pair_lerobot(policy, MinibatchOT())
    first.remove()
    pair_lerobot(policy, MinibatchOT()).remove()
    assert "compute_loss" not in vars(policy.objective)


def test_a_transformer_that_draws_otherwise_is_noticed():
    policy = transformer(draws=False)
    with (
        pair_lerobot(policy, ConditionalOT()),
        pytest.raises(RuntimeError, match="draws its noise in another way"),
    ):
        policy.objective.compute_loss(None, batch(), torch.zeros(8, 3))


def language_model(name):
    """SmolVLA, pi0 or pi0.5 of LeRobot, in whose forward the language model returns its input."""
    lerobot()
    pytest.importorskip("transformers")
    from importlib import import_module

    module = import_module(f"lerobot.policies.{name}.modeling_{name}")
    classes = {
        "smolvla": ("SmolVLAPolicy", "VLAFlowMatching"),
        "pi0": ("PI0Policy", "PI0Pytorch"),
        "pi05": ("PI05Policy", "PI05Pytorch"),
    }[name]
    outer, inner = (getattr(module, one) for one in classes)
    policy, model = outer.__new__(outer), inner.__new__(inner)
    torch.nn.Module.__init__(policy)
    torch.nn.Module.__init__(model)
    policy.config = model.config = SimpleNamespace(
        max_action_dim=32, max_state_dim=32, chunk_size=16, adapt_to_pi_aloha=False,
        output_features={ACTION: SimpleNamespace(shape=(2,))},
        action_feature=SimpleNamespace(shape=(2,)),
        time_sampling_beta_alpha=1.5, time_sampling_beta_beta=1.0,
        time_sampling_scale=0.999, time_sampling_offset=0.001,
    )  # fmt: skip
    policy.model, model.gradient_checkpointing_enabled = model, False
    model.action_out_proj = torch.nn.Linear(32, 32)
    model.given = []

    def embed(*inputs, **_):
        noisy, time = inputs[-2:]
        model.given.append((noisy, time))
        masks = torch.ones(noisy.shape[:2], dtype=torch.bool)
        parts = noisy, masks, masks
        return parts if name == "smolvla" else (*parts, None)

    def see(*_, **__):
        return torch.zeros(8, 1, 32), *(torch.ones(8, 1, dtype=torch.bool),) * 2

    def run(inputs_embeds, **_):
        return (None, inputs_embeds[1]), None

    weight = torch.nn.Linear(1, 1)
    layers = [SimpleNamespace(self_attn=SimpleNamespace(q_proj=weight))]
    gemma = SimpleNamespace(language_model=SimpleNamespace(layers=layers))
    gemma.model = gemma  # where 0.6 looks
    model.embed_prefix, model.embed_suffix = see, embed
    model.vlm_with_expert = SimpleNamespace(forward=run)
    model.paligemma_with_expert = SimpleNamespace(forward=run, paligemma=gemma)
    policy.prepare_images = policy._preprocess_images = lambda given: (None, None)
    return policy


@pytest.mark.slow
@pytest.mark.parametrize("name", ["smolvla", "pi0", "pi05"])
def test_a_language_model_is_given_paired_noise_of_its_own_width(name):
    policy, given = language_model(name), batch()
    given[STATE] = given[STATE][:, -1]
    given |= {"observation.language.tokens": None, "observation.language.attention_mask": None}
    with pair_lerobot(policy, pairing()):
        loss, _ = policy.forward(given)
    (noisy, time), wide = policy.model.given[0], torch.nn.functional.pad(given[ACTION], (0, 30))
    noise = expected(given, wide)
    time = time[:, None, None]
    assert torch.allclose(noisy, time * noise + (1 - time) * wide, atol=1e-5)
    assert torch.isfinite(loss)
    assert not {"forward"} & (set(vars(policy)) | set(vars(policy.model)))
    drawn = policy.model.sample_noise((8, 16, 32), "cpu")  # as sampling draws it
    assert not torch.equal(drawn, noise)


test_refused = refused(
    ({"policy": SimpleNamespace(config=None)}, TypeError, "policy must be Diffusion, MultiTaskDiT"),
    ({"policy": transformer(flow=False)}, ValueError, "set objective='flow_matching'"),
    ({"policy": transformer(), "nfe": 0}, ValueError, "nfe must be at least 1"),
    ({"policy": transformer(), "pairing": "ot"}, TypeError, "coupling must be a coupling"),
    of=lambda policy, pairing=None, **options: pair_lerobot(
        policy, pairing or ConditionalOT(), **options
    ),
)
