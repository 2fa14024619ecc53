"""The training loop: reproducible, resumable, and clear about what is wrong."""

import math
import os
import signal
import threading
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from support import refused, same_weights, seeded, take
from torch import nn

from cotlearn.couplings import (
    ConditionalOT,
    EmbeddedClusters,
    Independent,
    KMeansCondition,
    MinibatchOT,
    ModelAligned,
    StratifiedOT,
)
from cotlearn.couplings.base import Batches
from cotlearn.datasets import Dataset, unconditional
from cotlearn.flows import (
    FlowMatching,
    VelocityMLP,
    conditional_flow_matching_loss,
    fit,
    integrate,
    training,
)
from cotlearn.flows.fingerprint import described
from cotlearn.flows.one_step import MeanFlow, MeanVelocity, Shortcut
from cotlearn.flows.training import FitResult
from cotlearn.metrics import squared_w2
from cotlearn.mixtures import moving_modes, petals

OPTIONS = {"steps": 30, "batch_size": 16, "seed": 3, "log_every": 7}


def network(seed=0, dim=2, condition_dim=4):
    return VelocityMLP(dim, condition_dim, width=16, depth=2, seed=seed)


def train(net=None, data=None, coupling=None, **options) -> FitResult:
    return fit(
        network() if net is None else net,
        petals() if data is None else data,
        MinibatchOT() if coupling is None else coupling,
        **{**OPTIONS, **options},
    )


class WholeNumbers:
    """Data of a user that draw integers."""

    def sample(self, n, generator=None):
        return torch.zeros(n, 2, dtype=torch.long), torch.zeros(n, 4)


def assert_same(first: FitResult, second: FitResult):
    """Bit for bit, all but the seconds."""
    assert same_weights(first.network, second.network)
    for name in ("step", "loss"):
        assert np.array_equal(first.history[name], second.history[name])


class Interrupting:
    """Data that send Ctrl-C once, while batch number `at` is drawn (perhaps ahead of its step)."""

    name = "petals"

    def __init__(self, at, data=None):
        self.at, self.data, self.calls = at, data or petals(), 0

    def sample(self, n, generator=None):
        self.calls += 1
        if self.calls == self.at:
            os.kill(os.getpid(), signal.SIGINT)
        return self.data.sample(n, generator=generator)


class Hooked:
    """The loss, with something that happens at its call number `at`."""

    def __init__(self, at=0, what=None):
        self.at, self.what, self.calls = at, what, 0
        self.__qualname__ = "conditional_flow_matching_loss"  # the checkpoint asks for the name

    def __call__(self, network, pairs, generator):
        self.calls += 1
        if self.calls == self.at:
            self.what()
        return conditional_flow_matching_loss(network, pairs, generator)


def fail():
    raise OSError("the disk is gone")


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


def kill():
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.safetensors"


# --- learning ---


@pytest.mark.slow
def test_it_learns():
    data = petals()
    options = {"steps": 500, "batch_size": 128, "seed": 0, "learning_rate": 1e-2}
    result = fit(VelocityMLP(2, 4, width=64, seed=0), data, ConditionalOT(math.inf), **options)
    assert result.history["loss"][-1] < 0.2 * result.history["loss"][0]
    c = data.conditions()[[0] * 400]
    noise = torch.randn(400, 2, generator=seeded())
    made = integrate(result.network, noise, c, nfe=8).x1
    truth = data.sample_given(c, generator=seeded(1))
    assert squared_w2(made, truth) < 0.05 * squared_w2(noise, truth)


def test_what_it_returns():
    result = train()
    assert not result.network.training
    assert not any(p.requires_grad for p in result.network.parameters())
    assert result.history["step"].tolist() == [7, 14, 21, 28, 30]
    assert (np.diff(result.history["seconds"]) > 0).all()
    assert np.isfinite(result.history["loss"]).all()


def test_the_network_that_is_passed_in_stays_as_it_is():
    net = network()
    before = {name: value.clone() for name, value in net.state_dict().items()}
    result = train(net)
    assert all(torch.equal(before[name], value) for name, value in net.state_dict().items())
    assert all(p.requires_grad and p.grad is None for p in net.parameters())
    assert net.training
    assert not torch.equal(before["layers.0.weight"], result.network.layers[0].weight)


def test_a_trained_network_can_be_trained_on():
    first = train()
    second = train(first.network)
    assert not torch.equal(first.network.layers[0].weight, second.network.layers[0].weight)


def test_frozen_layers_stay_frozen():
    net = network()
    net.layers[0].requires_grad_(False)
    result = train(net)
    assert torch.equal(net.layers[0].weight, result.network.layers[0].weight)
    assert not torch.equal(net.layers[2].weight, result.network.layers[2].weight)


def test_the_same_call_gives_the_same_numbers():
    torch.manual_seed(0)
    first = train()
    torch.manual_seed(1)  # global randomness has no part in it
    torch.rand(3)
    assert_same(first, train())


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 4},
        {"batch_size": 8},
        {"ot_batch_size": 32},
        {"learning_rate": 1e-3},
        {"schedule": "constant"},
        {"ema": 0.5},
        {"coupling": Independent()},
        {"source": lambda n, generator=None: torch.rand(n, 2, generator=generator)},
        {"loss": lambda net, pairs, g: 2 * conditional_flow_matching_loss(net, pairs, g) ** 2},
    ],
)
def test_every_option_changes_the_numbers(change):
    first, second = train(), train(**change)
    assert not torch.equal(first.network.layers[0].weight, second.network.layers[0].weight)


def test_the_log_interval_changes_nothing_but_the_log():
    coarse, fine = train(log_every=10), train(log_every=1)
    assert torch.equal(coarse.network.layers[0].weight, fine.network.layers[0].weight)
    means = fine.history["loss"].reshape(3, 10).mean(axis=1)
    assert np.allclose(coarse.history["loss"], means)


def test_the_first_step_by_hand():
    """One step of Adam moves each weight by the learning rate against its gradient's sign."""
    net = network()
    result = train(net, steps=1, ema=0.0, learning_rate=0.01)
    moved = result.network.layers[-1].weight - net.layers[-1].weight
    assert torch.allclose(moved.abs(), torch.full_like(moved, 0.01), rtol=1e-2)


def test_the_average_of_the_weights():
    """Its decay is min(ema, (1 + s) / (10 + s)) in step s."""
    net = network()
    raw = [train(net, steps=n, ema=0.0, schedule="constant") for n in (1, 2, 3)]
    expected = net.layers[0].weight
    for step, result in enumerate(raw):
        decay = min(0.15, (1 + step) / (10 + step))
        expected = decay * expected + (1 - decay) * result.network.layers[0].weight
    averaged = train(net, steps=3, ema=0.15, schedule="constant").network
    assert torch.allclose(averaged.layers[0].weight, expected, atol=1e-6)


def test_without_a_condition_and_with_continuous_ones():
    train(network(condition_dim=0), unconditional(petals()))
    train(network(condition_dim=1), moving_modes(), ConditionalOT("balanced"))


def test_double_precision():
    result = train(network(condition_dim=0).double(), Dataset(torch.randn(99, 2).double()))
    assert result.network.layers[0].weight.dtype == torch.float64


def test_buffers_of_the_network_are_those_of_the_training():
    class Normalised(nn.Module):
        def __init__(self):
            super().__init__()
            self.norm, self.out = nn.BatchNorm1d(2), nn.Linear(2, 2)

        def forward(self, t, x, c):
            return self.out(self.norm(x))

    net = Normalised()
    assert train(net).network.norm.num_batches_tracked == OPTIONS["steps"]
    assert net.norm.num_batches_tracked == 0


def test_weights_of_rows_reach_the_loss():
    class Half(Independent):
        def __call__(self, x0, x1, c=None, generator=None):
            pairs = super().__call__(x0, x1, c, generator)
            return replace(pairs, weight=2.0 * (torch.arange(len(x0)) < len(x0) // 2))

    seen = []

    def loss(net, pairs, generator):
        losses = conditional_flow_matching_loss(net, pairs, generator)
        seen.append(losses.detach()[: len(losses) // 2].mean())
        return losses

    history = train(coupling=Half(), loss=loss, log_every=1).history
    assert np.allclose(history["loss"], torch.stack(seen))


def test_the_coupling_sees_the_averaged_network_before_each_step():
    class Watching(MinibatchOT):
        def observe(self, network, step):
            self._seen = [*getattr(self, "_seen", []), (step, network.training)]

    coupling = Watching()
    train(coupling=coupling)
    assert coupling._seen == [(step, False) for step in range(30)]


# --- interruption ---


@pytest.mark.parametrize("ot_batch_size", [16, 64])
@pytest.mark.parametrize("at", [2, 4, 6])  # the first call takes a fingerprint of the data
def test_ctrl_c_leaves_a_checkpoint_that_resumes_to_the_same_result(path, at, ot_batch_size):
    options = {"ot_batch_size": ot_batch_size, "checkpoint": path}
    with pytest.raises(KeyboardInterrupt, match="stopped after step"):
        train(data=Interrupting(at), **options)
    assert path.exists()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert_same(train(**options), train(ot_batch_size=ot_batch_size))


@pytest.mark.parametrize("at", [3, 5])
def test_pairs_that_a_network_chose_for_several_batches_are_not_chosen_again(path, at):
    """A resumed training paired the rest of the block with a later network."""
    options = {"ot_batch_size": 64, "loss": Hooked(), "steps": 26}
    stopped = options | {"loss": Hooked(at, interrupt)}
    with pytest.raises(KeyboardInterrupt, match=f"stopped after step {4 * math.ceil(at / 4)}$"):
        train(coupling=ModelAligned(warmup_steps=5), checkpoint=path, **stopped)
    resumed = train(coupling=ModelAligned(warmup_steps=5), checkpoint=path, **options)
    assert_same(resumed, train(coupling=ModelAligned(warmup_steps=5), **options))


def test_a_coupling_that_keeps_a_network_serves_one_training_at_a_time():
    """Each network chose pairs by the other one's errors."""
    coupling = ModelAligned()

    def begin_another():
        with pytest.raises(RuntimeError, match="another training uses this ModelAligned"):
            train(coupling=coupling)

    train(coupling=coupling, loss=Hooked(5, begin_another))
    train(coupling=coupling)


@pytest.mark.parametrize("seed", [np.int64(3), np.uint8(3)])
def test_a_seed_of_numpy_is_that_number(seed):
    assert_same(train(seed=seed), train(seed=3))


def test_interrupted_twice_and_resumed_in_double_precision(path):
    class Double:
        name = "petals"

        def sample(self, n, generator=None):
            x1, c = petals().sample(n, generator=generator)
            return x1.double(), c

    for at in (4, 6):
        with pytest.raises(KeyboardInterrupt):
            train(network().double(), Interrupting(at, Double()), checkpoint=path)
    resumed = train(network().double(), Double(), checkpoint=path, coupling=MinibatchOT())
    assert_same(resumed, train(network().double(), Double()))


def test_ctrl_c_without_a_checkpoint():
    with pytest.raises(KeyboardInterrupt):
        train(data=Interrupting(2))


def test_a_second_ctrl_c_does_not_wait_for_the_step():
    def twice():
        interrupt()
        interrupt()
        raise AssertionError("still here")

    with pytest.raises(KeyboardInterrupt):
        train(loss=Hooked(3, twice))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_leaves_the_last_checkpoint(path, monkeypatch):
    monkeypatch.setattr(training, "CHECKPOINT_EVERY", 10)
    options = {"checkpoint": path}
    with pytest.raises(OSError, match="the disk is gone"):
        train(loss=Hooked(24, fail), **options)
    counting = Hooked()
    assert_same(train(loss=counting, **options), train())
    assert counting.calls == 10  # it went on after step 20


@pytest.mark.parametrize("coupling", [Independent(), MinibatchOT()], ids=repr)
def test_an_error_of_the_data_is_raised(coupling):
    class Broken(Interrupting):
        def sample(self, n, generator=None):
            self.calls += 1
            if self.calls == self.at:
                raise OSError("the disk is gone")
            return self.data.sample(n, generator=generator)

    threads = threading.active_count()
    with pytest.raises(OSError, match="the disk is gone"):
        train(data=Broken(9), coupling=coupling)
    assert threading.active_count() == threads


def test_training_in_a_thread():
    results = []
    thread = threading.Thread(target=lambda: results.append(train()))
    thread.start()
    thread.join()
    assert_same(results[0], train())


def ended(what, path, said):
    """Trains in a process of its own until step 19, and what happens there."""
    with open(said, "w") as file:
        os.dup2(file.fileno(), 2)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a `make test &` ignores Ctrl-C
    training.CHECKPOINT_EVERY = 5
    train(loss=Hooked(19, what), checkpoint=path)


@pytest.mark.skipif(os.name == "nt", reason="signals of Unix")
@pytest.mark.slow
@pytest.mark.parametrize(("what", "left"), [(kill, 30 - 15), (interrupt, 30 - 19)])
def test_a_killed_process_resumes_to_the_same_result(warm, path, tmp_path, what, left):
    process = warm.Process(target=ended, args=(what, path, tmp_path / "said"))
    process.start()
    process.join()
    said = (tmp_path / "said").read_text()
    assert process.exitcode == (-signal.SIGKILL if what is kill else 1), said
    assert what is kill or "KeyboardInterrupt: training stopped after step 19" in said
    counting = Hooked()
    resumed = train(loss=counting, checkpoint=path)
    assert counting.calls == left
    assert_same(resumed, train())


def test_a_finished_training_is_loaded_and_not_repeated(path):
    first = train(checkpoint=path)
    counting = Hooked()
    second = train(loss=counting, checkpoint=path)
    assert counting.calls == 0
    assert_same(first, second)
    assert np.array_equal(first.history["seconds"], second.history["seconds"])
    assert [p.name for p in path.parent.iterdir()] == ["run.safetensors"]  # nothing left behind


def test_the_state_of_a_coupling_is_kept(path):
    class Counting(MinibatchOT):
        def __init__(self):
            super().__init__()
            self._steps = torch.zeros(())

        def observe(self, network, step):
            self._steps = self._steps + 1

        def state_dict(self):
            return {"steps": self._steps}

        def load_state_dict(self, state):
            self._steps = state["steps"]

    with pytest.raises(KeyboardInterrupt):
        train(loss=Hooked(9, interrupt), coupling=Counting(), checkpoint=path)
    coupling = Counting()
    train(coupling=coupling, checkpoint=path)
    assert coupling._steps == 30


def test_networks_with_shared_weights_can_be_saved(path):
    class Tied(nn.Module):
        def __init__(self):
            super().__init__()
            self.first = nn.Linear(2, 2)
            self.second = nn.Linear(2, 2)
            self.second.weight = self.first.weight

        def forward(self, t, x, c):
            return self.second(torch.tanh(self.first(x)))

    torch.manual_seed(0)
    net = Tied()
    with pytest.raises(KeyboardInterrupt):
        train(net, Interrupting(9), checkpoint=path)
    assert_same(train(net, checkpoint=path), train(net))


@pytest.mark.parametrize("begun_compiled", [True, False])
def test_a_checkpoint_does_not_know_whether_the_network_is_compiled(path, begun_compiled):
    compiled = MeanVelocity(torch.compile(network(condition_dim=5), backend="eager"))
    plain = MeanVelocity(network(condition_dim=5))
    begun, resumed = (compiled, plain) if begun_compiled else (plain, compiled)
    with pytest.raises(KeyboardInterrupt):
        train(begun, Interrupting(9), checkpoint=path)
    result, whole = train(resumed, checkpoint=path).network, train(plain).network
    values = zip(result.state_dict().values(), whole.state_dict().values(), strict=True)
    assert all(torch.equal(one, other) for one, other in values)


# --- checkpoints that do not fit ---


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    path = tmp_path_factory.mktemp("finished") / "run.safetensors"
    train(checkpoint=path)
    return path.read_bytes()


def test_a_flipped_byte_is_found_or_does_no_harm(path, finished):
    whole = train()
    rng = np.random.default_rng(0)
    header = 8 + int.from_bytes(finished[:8], "little")
    places = [*range(12), *rng.integers(header, size=40), *rng.integers(len(finished), size=40)]
    found = 0
    for place in places:
        damaged = bytearray(finished)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            result = train(checkpoint=path)
        except ValueError as error:
            assert str(path) in str(error)  # noqa: PT017
            assert "damaged" in str(error)  # noqa: PT017
            found += 1
        else:
            assert_same(result, whole)  # a byte of padding, for instance
    assert found >= 0.9 * len(places)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.5, 0.999])
def test_a_truncated_checkpoint_is_found(path, finished, share):
    path.write_bytes(finished[: int(share * len(finished))])
    with pytest.raises(ValueError, match=r"run.safetensors is damaged"):
        train(checkpoint=path)


def test_a_checkpoint_knows_the_settings_of_a_loss(path):
    def scaled(factor):
        def loss(network, pairs, generator):
            return factor * conditional_flow_matching_loss(network, pairs, generator)

        return loss

    first = train(loss=scaled(2.0), checkpoint=path)
    assert_same(train(loss=scaled(2.0), checkpoint=path), first)
    with pytest.raises(ValueError, match=r"loss was .*factor=2\.0.*factor=3\.0"):
        train(loss=scaled(3.0), checkpoint=path)


def test_how_a_checkpoint_names_a_loss():
    def weighed(network, pairs, generator, power=1.0, scale=None):
        return pairs.x0[:, 0]

    name = "test_how_a_checkpoint_names_a_loss.<locals>.weighed(power=1.0)"
    assert described(weighed) == name
    assert described(partial(weighed, power=2.0)) == f"{name}(power=2.0)"
    assert described(conditional_flow_matching_loss) == "conditional_flow_matching_loss"
    assert described(FlowMatching(0.3)) == repr(FlowMatching(0.3))
    assert described(FlowMatching(0.3).__call__).startswith(f"{FlowMatching(0.3)!r}: ")


def test_a_loss_without_a_repr_resumes_in_another_process(path):
    class Plain:
        def __call__(self, network, pairs, generator):
            return conditional_flow_matching_loss(network, pairs, generator)

    first, another = train(loss=Plain(), checkpoint=path), Plain()  # at another address
    assert_same(train(loss=another, checkpoint=path), first)


def test_another_file_is_no_checkpoint(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("what I learned")
    with pytest.raises(ValueError, match=r"notes.txt is damaged or was not written by cotlearn"):
        train(checkpoint=path)
    assert path.read_text() == "what I learned"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": 31}, "steps was 30, now it is 31"),
        ({"batch_size": 8}, "batch_size was 16, now it is 8"),
        ({"ot_batch_size": 32}, "ot_batch_size was 16, now it is 32"),
        ({"seed": 4}, "seed was 3, now it is 4"),
        ({"learning_rate": 1e-3}, "learning_rate was 0.002, now it is 0.001"),
        ({"schedule": "constant"}, "schedule was 'cosine', now it is 'constant'"),
        ({"ema": 0.9}, "ema was 0.99, now it is 0.9"),
        ({"coupling": Independent()}, r"coupling was .MinibatchOT\(.*now it is 'Independent"),
        ({"coupling": MinibatchOT(plan="sinkhorn")}, r"coupling was .* now it is .*sinkhorn"),
        ({"data": moving_modes()}, "data was 'petals', now it is 'moving_modes'"),
        ({"loss": lambda *args: None}, "loss was 'conditional_flow_matching_loss', now it is"),
        ({"loss": FlowMatching(prediction="data")}, "loss was 'conditional_flow_matching_loss', "),
        ({"net": VelocityMLP(2, 4, width=8)}, "initial weights was"),
        ({"net": VelocityMLP(2, 4, width=16, seed=2)}, "initial weights was"),
        ({"data": Dataset(*petals().sample(99), name="petals")}, "rows of data was"),
        ({"source": lambda n, generator: torch.zeros(n, 2)}, "source was 'standard normal', now"),
    ],
)
def test_a_checkpoint_of_another_training_says_what_differs(path, finished, change, message):
    path.write_bytes(finished)
    with pytest.raises(ValueError, match=f"run.safetensors.*(?s:{message})"):
        train(**change, checkpoint=path)
    assert path.read_bytes() == finished


# --- what goes wrong ---


@pytest.mark.parametrize("every", [1000, 2])
def test_a_loss_that_is_not_finite_stops(path, every, monkeypatch):
    monkeypatch.setattr(training, "CHECKPOINT_EVERY", every)
    with pytest.raises(RuntimeError, match=r"the loss became (nan|inf) by step .* learning_rate"):
        train(loss=lambda net, pairs, g: net(0, pairs.x0, pairs.c).sum(dim=1) * math.inf)
    with pytest.raises(RuntimeError, match="the loss became"):
        train(learning_rate=1e30, checkpoint=path)
    if path.exists():  # a checkpoint from before it went wrong, never one with NaN in it
        from cotlearn.storage import load_tensors

        tensors, _ = load_tensors(path)
        assert torch.isfinite(tensors["unlogged"]).all()


test_bad_input = refused(
    ({"steps": 0}, ValueError, "steps must be at least 1"),
    ({"steps": 1.5}, TypeError, "steps must be an integer"),
    ({"batch_size": 0}, ValueError, "batch_size must be at least 1"),
    ({"ot_batch_size": 8}, ValueError, "ot_batch_size must be at least 16"),
    ({"ot_batch_size": 24}, ValueError, "ot_batch_size must be a multiple of batch_size 16"),
    ({"seed": -1}, ValueError, "seed must be at least 0"),
    ({"seed": None}, TypeError, "seed must be an integer"),
    ({"learning_rate": 0}, ValueError, "learning_rate must be above 0"),
    ({"learning_rate": -1}, ValueError, "learning_rate must be at least 0"),
    ({"learning_rate": math.nan}, ValueError, "learning_rate must be at least 0"),
    ({"schedule": "linear"}, ValueError, "schedule must be one of cosine, constant"),
    ({"ema": 1.1}, ValueError, r"ema must lie in \[0, 1\]"),
    ({"ema": -0.1}, ValueError, "ema must be at least 0"),
    ({"log_every": 0}, ValueError, "log_every must be at least 1"),
    ({"net": lambda t, x, c: x}, TypeError, "network must be a torch.nn.Module, got <function"),
    ({"net": VelocityMLP}, TypeError, "network must be .* got <class .*VelocityMLP"),
    ({"net": nn.Identity()}, ValueError, "network has no parameters"),
    ({"net": nn.LazyLinear(2)}, ValueError, "network has lazy layers"),
    ({"loss": MeanFlow}, TypeError, "loss must be .* got the class MeanFlow"),
    ({"loss": MeanFlow()}, TypeError, "network must be called as u.* got VelocityMLP"),
    ({"loss": Shortcut()}, TypeError, "network must be called as u.* got VelocityMLP"),
    ({"data": WholeNumbers()}, TypeError, r"must return x1 as floating point, got torch.int64"),
    ({"data": petals}, TypeError, "data must be .* with sample"),
    ({"data": torch.zeros(3, 2)}, TypeError, "data must be .* with sample"),
    ({"coupling": MinibatchOT}, TypeError, "coupling must .* got <class .*MinibatchOT"),
    ({"coupling": "minibatch_ot"}, TypeError, "coupling must be a coupling .* got 'minibatch_ot'"),
    ({"data": unconditional(petals()), "coupling": ConditionalOT()}, TypeError, "needs the"),
    ({"data": unconditional(petals())}, ValueError, "c is missing: VelocityMLP needs"),
    ({"net": network(condition_dim=0)}, ValueError, "condition_dim=0, but got c"),
    ({"net": network(condition_dim=3)}, ValueError, "c has 4 columns, expected 3"),
    ({"net": network(dim=3)}, ValueError, "x1 has 2 columns, expected 3"),
    ({"loss": lambda net, pairs, g: torch.zeros(())}, ValueError, "loss must return one value"),
    ({"loss": lambda net, pairs, g: torch.ones(len(pairs))}, ValueError, "it has no gradient"),
    ({"source": lambda n, generator=None: torch.zeros(n, 3)}, ValueError, r"source\(n\) must"),
    of=train,
)


def test_batches_that_end_before_the_training():
    few = Batches(iter(take(Independent(), petals(), 3)))
    with pytest.raises(ValueError, match="stream of Batches ended after 3 batches, and steps is 5"):
        fit(network(), petals(), few, steps=5, batch_size=20, progress=False)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_trains_and_resumes(path):
    net = network().cuda()
    with pytest.raises(KeyboardInterrupt):
        train(net, Interrupting(9), checkpoint=path)
    resumed, whole = train(net, checkpoint=path), train(net)
    assert next(resumed.network.parameters()).is_cuda
    assert np.allclose(resumed.history["loss"], whole.history["loss"], rtol=1e-3)


@pytest.mark.parametrize("around", [torch.no_grad, torch.inference_mode])
def test_gradients_that_are_off_around_it_are_on_inside(around):
    net = network()
    with around():
        inside = train(net, steps=3)
    assert_same(inside, train(network(), steps=3))


def test_dropout_is_reproducible_and_resumes(path):
    """It drew from torch's global randomness: two trainings differed."""

    def dropping():
        net = network()
        net.layers.insert(2, nn.Dropout(0.3))
        return net

    torch.manual_seed(1)
    before = torch.get_rng_state()
    first = train(dropping())
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(2)
    assert_same(train(dropping()), first)
    with pytest.raises(KeyboardInterrupt):
        train(dropping(), loss=Hooked(9, interrupt), checkpoint=path)
    assert_same(train(dropping(), checkpoint=path), first)


def test_what_a_coupling_prepares_does_not_count_for_a_step(monkeypatch):
    class Slow(Independent):
        def stream(self, *given, **options):
            time.sleep(0.3)
            yield from super().stream(*given, **options)

    bars = []
    make = training.progress_bar
    monkeypatch.setattr(training, "progress_bar", lambda **o: bars.append(make(**o)) or bars[-1])
    began = time.time()
    fit(VelocityMLP(2, 4, width=8), petals(), Slow(), steps=1, batch_size=8, progress=True)
    assert bars[0].start_t - began > 0.29


def test_data_that_draw_in_a_way_of_their_own_are_other_data(tmp_path):
    """Their rows were compared, and not which of them are drawn."""

    class Weighted(Dataset):
        def sample(self, n, generator=None):
            return self.x1[torch.multinomial(weights, n, True, generator=generator)], None

    data, network = (
        Weighted(torch.randn(64, 2, generator=seeded())),
        VelocityMLP(2, width=8, depth=1),
    )
    options = {"steps": 2, "batch_size": 8, "checkpoint": tmp_path / "a.safetensors"}
    weights = torch.ones(64)
    fit(network, data, Independent(), **options)
    weights = torch.eye(64)[3]
    with pytest.raises(ValueError, match="rows of data was"):
        fit(network, data, Independent(), **options)


@pytest.mark.parametrize("kind", [torch.bfloat16, torch.float16])
def test_weights_of_half_precision_are_named(kind):
    """The average of the weights did not follow them."""
    data = Dataset(torch.randn(64, 2, generator=seeded()).to(kind))
    network = VelocityMLP(2, width=8, depth=1, seed=0).to(kind)
    with pytest.warns(RuntimeWarning, match="keep them in float32"):
        fit(network, data, Independent(), steps=1, batch_size=8)


def test_a_sampler_without_a_generator_is_named():
    network, data = VelocityMLP(2, width=8, depth=1, seed=0), Dataset(torch.zeros(8, 2))
    with pytest.raises(TypeError, match=r"source must take \(n, generator=...\)"):
        fit(network, data, Independent(), steps=1, batch_size=8, source=lambda n: torch.zeros(n, 2))


def test_clusters_of_an_embedding_resume_in_the_same_process(tmp_path):
    """What the stream fitted changed the contents of the coupling."""
    coupling = StratifiedOT(EmbeddedClusters(lambda c: c[:, :2], KMeansCondition(3)))
    data = Dataset(*petals().sample(400, seeded()))
    network = VelocityMLP(2, 4, width=8, depth=1, seed=0)
    options = {"steps": 2, "batch_size": 32, "checkpoint": tmp_path / "a.safetensors"}
    for _ in range(2):
        fit(network, data, coupling, **options)
