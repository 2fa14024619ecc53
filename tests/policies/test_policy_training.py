import json
import math
import signal
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from cotlearn import cli, plots
from cotlearn.couplings import StratifiedOT, Transformed
from cotlearn.flows import training
from cotlearn.policies.comparison import choice, scores
from cotlearn.policies.comparison.cells import Protocol, bench, read_record
from cotlearn.policies.comparison.choice import choose, with_choice
from cotlearn.policies.comparison.summary import summarise
from cotlearn.policies.methods import METHODS, Method
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import rollout
from cotlearn.policies.samplers import MeanSampler
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.training import Options, train
from cotlearn.robots.episodes import write_lerobot
from cotlearn.robots.push_t.definition import PUSH_T

SMALL = Options(steps=20, batch_size=32, width=16, blocks=1, clusters=20, ot_batch_size=64)
SMALL = replace(SMALL, reflow_pairs=100, reflow_nfe=2)


@pytest.fixture(autouse=True)
def _little_to_score(monkeypatch):
    monkeypatch.setitem(vars(PUSH_T), "expert", lambda: SimpleNamespace(episode=_straight_on))
    monkeypatch.setattr(scores, "SCORED_STATES", 20)
    for name in ("SCORED_SAMPLES", "MODE_STARTS", "MODE_DRAWS", "TRIALS"):
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


@pytest.mark.parametrize("change", [{"network": "unet"}, {"frame": "world"}, {"label": "action"}])
def test_options(episodes, change):
    options = Options(**{**SMALL.__dict__, "steps": 2, **change})
    policy = train("independent", episodes, options=options, progress=False).policy
    assert policy.windows.frame == (options.frame or "body")
    assert (type(policy.network).__name__ == "TemporalUNet") == (options.network == "unet")


def test_more_training_is_better(episodes):
    longer = Options(**{**SMALL.__dict__, "steps": 400, "width": 64})
    loss = train("behaviour_cloning", episodes, options=longer, progress=False).history["loss"]
    assert loss[-1] < 0.7 * loss[0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda e: train("magic", e), "method must be one of independent, minibatch_ot"),
        (lambda e: Options(steps=0), "steps must be at least 1"),
        (lambda e: Options(network="lstm"), "network must be one of mlp, unet"),
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


# --- the benchmark --------------------------------------------------------------------------------

PROTOCOL = Protocol(options=SMALL, held_out=3, episodes=2)


def run(episodes, folder, methods=("behaviour_cloning",), protocol=PROTOCOL, **options):
    """A comparison of one seed with its weights beside the cells, and what it said."""
    said = []
    given = {"seeds": [0], "weights": folder / "weights", "say": said.append, **options}
    bench(episodes, folder=folder, methods=methods, protocol=protocol, **given)
    return said


def test_bench_goes_on_and_is_summarised(episodes, tmp_path):
    folder = tmp_path / "cells"
    run(episodes, folder, ["independent"])
    before = (folder / "independent-0.json").read_bytes()
    methods = ["independent", "reflow", "conditional_ot", "diffusion"]
    assert "4 cells, 1 done already" in run(episodes, folder, methods)
    run(episodes, folder, ["behaviour_cloning"], seeds=[0, 1])
    assert (folder / "independent-0.json").read_bytes() == before
    assert len(list(folder.glob("*-*.json"))) == 6
    assert not list((folder / "weights").glob("*training*"))
    cell = json.loads((folder / "conditional_ot-0.json").read_text())
    assert len(cell["samplers"]["euler-2"]["outcomes"]["coverage"]) == 2
    assert cell["chosen"]["value"] > 0

    summary = summarise(folder, tmp_path / "summary.json", command="as in the test")
    assert json.loads((tmp_path / "summary.json").read_text()) == json.loads(json.dumps(summary))
    rows = {(row["method"], row["sampler"]): row for row in summary["rows"]}
    assert len(rows) == 3 * 10 + 10 + 1  # each sampler as trained and at its temperature
    assert summary["demonstrations"]["mode_entropy"] == 0  # always straight on
    reference = rows["independent", "euler-16"]
    assert reference["against_reference"]["coverage"] == (0.0, 0.0, 0.0)
    assert rows["diffusion", "ddpm-100"]["nfe"] == 100
    row = rows["behaviour_cloning", "mean"]
    assert len(row["coverage_of_seeds"]) == 2
    low, high = row["coverage_interval"]
    assert low <= row["coverage"] <= high

    (folder / "reflow-0.json").unlink()  # the weights are still there: no new training
    assert not any("training" in line for line in run(episodes, folder, methods))


def test_an_interrupted_bench_loses_nothing(episodes, tmp_path, monkeypatch):
    protocol = replace(PROTOCOL, options=replace(SMALL, steps=60))
    run(episodes, tmp_path / "a", ["independent"], protocol)
    step, calls = training._gradient_step, []

    def interrupted(*arguments):
        step(*arguments)
        calls.append(1)
        if len(calls) == 25:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(training, "_gradient_step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(episodes, tmp_path / "b", ["independent"], protocol)
    assert not list((tmp_path / "b").glob("*.json"))
    run(episodes, tmp_path / "b", ["independent"], protocol)
    assert len(calls) == 60  # 25 and 35
    first, second = (json.loads((tmp_path / k / "independent-0.json").read_text()) for k in "ab")
    assert first["training"]["loss"] == second["training"]["loss"]
    for name, found in first["samplers"].items():
        assert found["outcomes"] == second["samplers"][name]["outcomes"]


def test_what_does_not_belong_together(episodes, tmp_path):
    run(episodes, tmp_path)
    other = replace(PROTOCOL, episodes=3)
    with pytest.raises(ValueError, match=r"another protocol \(episodes\)"):
        run(episodes, tmp_path, protocol=other)
    with pytest.raises(ValueError, match="was trained with another protocol"):
        run(episodes, tmp_path / "new", protocol=other, weights=tmp_path / "weights")
    (tmp_path / "behaviour_cloning-0.json").write_text("{")
    with pytest.raises(ValueError, match="is damaged: delete it"):
        run(episodes, tmp_path)
    with pytest.raises(ValueError, match="method must be one of"):
        run(episodes, tmp_path, ["magic"])
    with pytest.raises(ValueError, match="holds no cells yet"):
        summarise(tmp_path / "empty", tmp_path / "x.json", command="")


def test_cells_and_weights_of_version_0_1_still_belong_to_their_protocol(episodes):
    """Two options were renamed, and those of a camera stood among the others."""
    for setting in SETTINGS.values():
        record = Protocol(options=setting.options).record(episodes)
        options = {**record["options"]}
        options["whole"], options["early"] = options.pop("open_loop"), options.pop("share_at_t0")
        camera = options.pop("camera")
        if camera:
            options |= {**camera, "network": "camera", "condition_weight": None}
        assert read_record({**record, "options": options}) == record == read_record(record)


def test_a_row_is_all_that_a_new_method_needs(episodes, tmp_path, monkeypatch):
    def loss(network, pairs, generator):
        return network(0.0, pairs.x0, pairs.c)[:, 0]

    made = {"loss": lambda options: loss, "sampler": lambda options, clip: MeanSampler()}
    nothing = Method("nothing", "does nothing in particular", **made)
    monkeypatch.setitem(METHODS, "nothing", nothing)
    for command in ("train", "bench"):
        assert "nothing: does nothing in particular." in invoke(command, "--help").output
    assert train("nothing", episodes, options=SMALL, progress=False).policy.sampler.name == "mean"
    run(episodes, tmp_path, ["nothing"])
    rows = summarise(tmp_path, tmp_path / "summary.json", command="")["rows"]
    assert [row["method"] for row in rows] == ["nothing"]
    assert plots.label_of("nothing") == "nothing"


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


def test_bench_push_t(data, tmp_path):
    words = ["bench", "push-t", "--methods", "behaviour_cloning", "--seeds", "0", "--data", data]
    words += ["--steps", 2, "--batch-size", 8, "--held-out", 2, "--episodes", 2]
    words += ["--folder", tmp_path / "cells", "--weights", tmp_path / "weights"]
    result = invoke(*words)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "cells" / "behaviour_cloning-0.json").is_file()
    assert (tmp_path / "cells.json").is_file()
    assert "1 cells, 1 done already" in invoke(*words).output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("train", "push-t", "--coupling", "magic"), "method must be one of"),
        (("train", "push-t", "--network", "lstm"), "network must be one of mlp, unet"),
        (("train", "push-t", "--frame", "mine"), "frame must be one of body, world"),
        (("bench", "push-t", "--seeds", "1,two"), "seeds must be integers with commas between"),
        (("bench", "push-t", "--methods", "magic"), "method must be one of"),
        (("bench", "push-t-human"), "held_out must"),
    ],
)
def test_bad_commands(data, tmp_path, arguments, message):
    place = ("--folder", tmp_path) if arguments[0] == "bench" else ("--out", tmp_path / "x")
    result = invoke(*arguments, "--data", data, *place)
    assert (result.exit_code, message in result.output) == (2, True)
    assert "Traceback" not in result.output


def test_missing_demonstrations(tmp_path):
    for words, message in (
        (("push-t", "--data", tmp_path / "none.npz"), "no such file"),
        (("push-t-human",), "push-t-human needs --data"),
    ):
        result = invoke("train", *words)
        assert (result.exit_code, message in result.output) == (2, True)


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
def test_mean_velocities_are_saved_and_need_the_mlp(episodes, tmp_path, method):
    policy = train(method, episodes, options=SMALL, progress=False).policy
    policy.save(tmp_path / "p.safetensors")
    history = np.repeat(episodes.state[:3, None], 2, axis=1)
    noise = policy.noise(3)
    again = ChunkPolicy.load(tmp_path / "p.safetensors")
    assert (again.act(history, noise=noise) == policy.act(history, noise=noise)).all()
    with pytest.raises(ValueError, match=f"{method} needs network mlp"):
        train(method, episodes, options=replace(SMALL, network="unet"), progress=False)
