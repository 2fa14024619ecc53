import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from cotlearn import cli
from cotlearn.couplings import StratifiedOT, Transformed
from cotlearn.policies import choice, scores
from cotlearn.policies.choice import choose, with_choice
from cotlearn.policies.methods import METHODS
from cotlearn.policies.options import Options
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import rollout
from cotlearn.policies.training import train
from cotlearn.robots.episodes import write_lerobot
from cotlearn.robots.push_t.definition import PUSH_T

SMALL = Options(steps=20, batch_size=32, width=16, blocks=1, clusters=20, ot_batch_size=64)
SMALL = replace(SMALL, reflow_pairs=100, reflow_nfe=2)


@pytest.fixture(autouse=True)
def _little_to_score(monkeypatch):
    monkeypatch.setitem(vars(PUSH_T), "expert", lambda: SimpleNamespace(episode=_straight_on))
    monkeypatch.setattr(scores, "SCORED_STATES", 20)
    for name in ("SCORED_SAMPLES", "MODE_STARTS", "MODE_DRAWS"):
        monkeypatch.setattr(scores, name, 2)
    monkeypatch.setattr(scores, "rollout", _short)
    monkeypatch.setattr(choice, "FRONTIER_ROWS", 128)
    monkeypatch.setattr(choice, "FACTORS", (1.0, 100.0))
    monkeypatch.setattr(choice, "STRATUM_ROWS", (20, 40))


def _straight_on(seed, *, state):
    """A demonstration that goes to the T for ten steps."""
    return SimpleNamespace(action=np.repeat(state[None, 2:4].clip(0, 512), 10, axis=0))


def _short(policy, **options):
    return rollout(policy, **{**options, "max_steps": 9})


@pytest.mark.parametrize("method", METHODS)
def test_every_method_trains_and_acts(episodes, method, tmp_path):
    checkpoint = tmp_path / "c.safetensors"
    trained = train(method, episodes, options=SMALL, checkpoint=checkpoint, progress=False)
    assert math.isfinite(trained.history["loss"][-1])
    assert trained.seconds > 0
    history = np.repeat(episodes.state[:3, None], 2, axis=1)
    for sampler in trained.policy.sampler.variants:
        assert trained.policy.with_sampler(sampler).act(history).shape == (3, 8, 2)
    again = train(method, episodes, options=SMALL, progress=False)
    weights = zip(*(t.policy.network.parameters() for t in (trained, again)), strict=True)
    assert all(torch.equal(a, b) for a, b in weights)


def test_a_training_tells_its_coupling(episodes):
    methods = "stratified", "centred"
    plain, about = (train(m, episodes, options=SMALL, progress=False).coupling for m in methods)
    assert isinstance(plain, StratifiedOT)
    assert isinstance(about, Transformed)
    c = torch.randn(5, 12, generator=torch.Generator().manual_seed(0))
    mean = -about.forward(torch.zeros(5, 32), c)
    assert mean.std() > 0  # a regression that has learned something


@pytest.mark.parametrize("change", [{"frame": "world"}, {"label": "action"}])
def test_options(episodes, change):
    options = Options(**{**SMALL.__dict__, "steps": 2, **change})
    policy = train("independent", episodes, options=options, progress=False).policy
    assert policy.windows.frame == (options.frame or "body")


@pytest.mark.slow
def test_more_training_is_better(episodes):
    longer = Options(**{**SMALL.__dict__, "steps": 400, "width": 64})
    loss = train("behaviour_cloning", episodes, options=longer, progress=False).history["loss"]
    assert loss[-1] < 0.7 * loss[0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda e: train("magic", e), "method must be one of independent, minibatch_ot"),
        (lambda e: Options(steps=0), "steps must be at least 1"),
        (lambda e: Options(execute=17), "execute must be at most the 16 predicted"),
    ],
)
def test_bad_input(episodes, call, message):
    with pytest.raises(ValueError, match=message):
        call(episodes)


@pytest.mark.parametrize(
    ("method", "options", "message"),
    [
        ("conditional_ot", {"condition_weight": -1.0}, "condition_weight must be at least 0"),
        ("stratified", {"clusters": None}, "clusters must be an integer, got None"),
        ("stratified", {"clusters": 10**6}, "clusters must be at most"),
    ],
)
def test_options_of_a_coupling_are_looked_at(episodes, method, options, message):
    with pytest.raises(ValueError, match=message):
        train(method, episodes, options=replace(SMALL, **options))


@pytest.mark.slow
def test_the_frontier_chooses(episodes):
    options = replace(SMALL, clusters=None)
    opened = {"conditional_ot": "condition_weight", "residual": "clusters", "centred": "clusters"}
    for method, option in opened.items():
        chosen = choose(method, episodes, options)
        assert chosen["option"] == option
        assert chosen["value"] > 0
        assert len(chosen["frontier"]) == 3
        assert chosen["frontier"][0]["name"] == "independent"
        json.dumps(chosen, allow_nan=False)
        assert getattr(with_choice(method, episodes, options), option) == chosen["value"]
    assert with_choice("stratified", episodes, SMALL) == SMALL


# --- the commands ---------------------------------------------------------------------------------


def invoke(*arguments):
    return CliRunner().invoke(cli.app, [str(part) for part in arguments])


@pytest.fixture(scope="module")
def data(episodes, tmp_path_factory):
    pytest.importorskip("pyarrow")
    return write_lerobot(tmp_path_factory.mktemp("demonstrations") / "set", episodes)


def test_train_push_t(data, tmp_path):
    out = tmp_path / "policy.safetensors"
    result = invoke(
        *("train", "push-t", "--coupling", "stratified", "--steps", 3, "--batch-size", 16),
        *("--clusters", 8, "--episodes", 5, "--data", data, "--out", out, "--rollouts", 0),
    )
    assert result.exit_code == 0, result.output
    assert "5 episodes" in result.output
    assert ChunkPolicy.load(out).windows.frame == "body"
    assert [path.name for path in tmp_path.iterdir()] == [out.name]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("train", "push-t", "--coupling", "magic"), "method must be one of"),
        (("train", "push-t", "--frame", "mine"), "frame must be one of body, world"),
    ],
)
def test_bad_commands(data, tmp_path, arguments, message):
    result = invoke(*arguments, "--data", data, "--out", tmp_path / "x")
    assert (result.exit_code, message in result.output) == (2, True)
    assert "Traceback" not in result.output


def test_missing_demonstrations(tmp_path):
    for words, message in (
        (("push-t", "--data", tmp_path / "none.npz"), "no such file"),
        (("push-t-human",), "push-t-human needs --data"),
    ):
        result = invoke("train", *words)
        assert (result.exit_code, message in result.output) == (2, True)


def test_a_task_that_ships_no_demonstrations_says_how_to_record_them(monkeypatch):
    monkeypatch.setitem(vars(PUSH_T), "demonstrations", "")
    result = invoke("train", "push-t")
    assert (result.exit_code, "cotlearn demos push-t" in result.output) == (2, True)


def test_a_method_settles_what_its_network_predicts():
    def settled(method, prediction=""):
        return METHODS[method].settle(Options(prediction=prediction)).prediction

    assert settled("independent") == settled("diffusion") == "velocity"
    assert settled("independent", "data") == "data"
    assert settled("behaviour_cloning", "velocity") == "data"  # it has no choice
    with pytest.raises(ValueError, match="prediction of independent"):
        settled("independent", "noise")


def test_steps_that_cost_more_are_fewer(episodes):
    methods = "independent", "two_passes"
    one, two = (train(m, episodes, options=SMALL, progress=False).history for m in methods)
    assert two["step"][-1] == one["step"][-1] / 2


@pytest.mark.parametrize("method", ["mean_flow", "mean_flow_data"])
def test_mean_velocities_are_saved(episodes, tmp_path, method):
    policy = train(method, episodes, options=SMALL, progress=False).policy
    policy.save(tmp_path / "p.safetensors")
    history = np.repeat(episodes.state[:3, None], 2, axis=1)
    noise = policy.noise(3)
    again = ChunkPolicy.load(tmp_path / "p.safetensors")
    assert (again.act(history, noise=noise) == policy.act(history, noise=noise)).all()
