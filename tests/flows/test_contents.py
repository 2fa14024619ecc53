"""A checkpoint goes on only with what its coupling and its loss held."""

import copy
import linecache
import logging
import sys
import threading
import types
from argparse import Namespace
from functools import partial

import numpy as np
import pytest
import torch
from support import seeded

from cotlearn.couplings import (
    ConditionalOT,
    Coupling,
    FixedPairs,
    Independent,
    KMeansCondition,
    MinibatchOT,
    OwnUnits,
    Reflow,
    StratifiedOT,
    Transformed,
    centred,
)
from cotlearn.couplings.base import Match
from cotlearn.datasets import Dataset
from cotlearn.flows import FlowMatching, VelocityMLP, conditional_flow_matching_loss, fit
from cotlearn.flows.contents import contents

X, C, Z = (torch.randn(64, 2, generator=seeded(k)) for k in range(3))
TEACHER = torch.nn.Linear(2, 2)


class Mine(Coupling):
    """A user's coupling with an __init__ of its own."""

    def __init__(self, strength, table=None):
        self.strength, self.table, self._calls = strength, table, 0

    def match(self, x0, x1, c, rng):
        self._calls += 1
        return Match(np.arange(len(x0)), np.arange(len(x0)))


def net(seed):
    return VelocityMLP(2, 2, width=8, depth=1, seed=seed)


SOURCE = """
import numpy as np, torch
from cotlearn.couplings import Coupling
from cotlearn.couplings.base import Match

class K(Coupling):
    def match(self, x0, x1, c, rng):
        return Match(np.arange(len(x0)), np.arange(len(x0))[::STEP])

class M(torch.nn.Linear):
    def forward(self, t, x, c):
        return STEP * super().forward(x)
"""


def written(step):
    """The classes of a user's file, which has been edited; as inspect finds them in a notebook."""
    name = f"<a file with {step}>"
    text = SOURCE.replace("STEP", str(step))
    linecache.cache[name] = len(text), None, text.splitlines(keepends=True), name
    space = {"__name__": "users_file"}
    exec(compile(text, name, "exec"), space)
    return space


def kind(step):
    return written(step)["K"]


def heir(step):
    return type("Heir", (kind(step),), {"__module__": "users_file"})


def module(step):
    torch.manual_seed(0)
    return written(step)["M"](2, 2)


def patched(step):
    coupling = Independent()
    coupling.match = kind(step)().match.__func__
    return coupling


class Scaled:
    def __init__(self, by):
        self.by = by

    def __call__(self, network, pairs, generator):
        return self.by * conditional_flow_matching_loss(network, pairs, generator)


class Shifted(Scaled):
    __qualname__ = "Scaled"

    def __call__(self, network, pairs, generator):
        return self.by + conditional_flow_matching_loss(network, pairs, generator)


class Acting(torch.nn.Module):
    """A network with plain attributes."""

    def __init__(self, act, times=1, bias=0.0):
        super().__init__()
        self.act, self.times, self._bias = act, times, bias
        self.layer = torch.nn.Linear(4, 2)
        torch.nn.init.ones_(self.layer.weight), torch.nn.init.zeros_(self.layer.bias)

    def forward(self, t, x, c):
        return self.times * self.act(self.layer(torch.cat([x, c], dim=1))) + self._bias


class Config:
    def __init__(self, rate):
        self.rate = rate


SETTINGS = {"scale": 1.0}


HELPERS = types.ModuleType("users_helpers")


def with_helper(factor):
    """A network whose methods use a module, a class and a function of other files of the user's."""
    text = (
        f"def scale(x):\n    return {factor} * x\n\n\n"
        f"class Scale:\n    by = {factor}\n\n"
        "    def __call__(self, x):\n        return self.by * x\n"
    )
    name = f"<helpers with {factor}>"
    linecache.cache[name] = len(text), None, text.splitlines(keepends=True), name
    exec(compile(text, name, "exec"), vars(HELPERS))
    return HELPERS


class ByModule(torch.nn.Module):
    def forward(self, t, x, c):
        return HELPERS.scale(x)


class ByClass(torch.nn.Module):
    def forward(self, t, x, c):
        return HELPERS.Scale()(x)


class ByInner(torch.nn.Module):
    def forward(self, t, x, c):
        return sum(HELPERS.scale(column) for column in x.T)


def using(factor, network, monkeypatch):
    """The digest of a network that uses these helpers."""
    monkeypatch.setitem(sys.modules, HELPERS.__name__, with_helper(factor))
    return contents(network())


def by_setting(scale):
    """A loss that reads a dictionary of its file; it counts as it is when it is read."""
    SETTINGS["scale"] = scale
    return scaled_by_settings


def scaled_by_settings(network, pairs, generator):
    return SETTINGS["scale"] * conditional_flow_matching_loss(network, pairs, generator)


def around(tensor):
    def loss(network, pairs, generator):
        return conditional_flow_matching_loss(network, pairs, generator) * tensor.sum()

    return loss


def clusters(c, k=4):
    return KMeansCondition(k).fit(c)


def seeded_layer(kind, *args, **options):
    torch.manual_seed(0)
    return kind(*args, **options)


attention = partial(seeded_layer, torch.nn.MultiheadAttention, 8)


def encoder(activation="relu", **options):
    kind = torch.nn.TransformerEncoderLayer
    return seeded_layer(kind, 8, 2, 16, activation=activation, **options)


def rated(rate):
    return type("Rated", (Scaled,), {"rate": rate, "__module__": __name__})(1)


OTHERS = {
    "fixed pairs": (lambda: FixedPairs(Z), lambda: FixedPairs(-Z)),
    "a teacher's code": (lambda: Reflow(lambda x, c: x + 1), lambda: Reflow(lambda x, c: 9 - x)),
    "a teacher's weights": (
        lambda: Reflow(partial(net(0), 0.5)),
        lambda: Reflow(partial(net(1), 0.5)),
    ),
    "a mean network": (
        lambda: centred(MinibatchOT(), net(0)),
        lambda: centred(MinibatchOT(), net(1)),
    ),
    "clusters": (
        lambda: ConditionalOT(condition=clusters(C)),
        lambda: ConditionalOT(condition=clusters(9 * C)),
    ),
    "fitted strata": (lambda: StratifiedOT(clusters(C)), lambda: StratifiedOT(clusters(9 * C))),
    "units": (
        lambda: ConditionalOT(1.0, condition=OwnUnits.fit(C)),
        lambda: ConditionalOT(1.0, condition=OwnUnits.fit(9 * C)),
    ),
    "an option of one's own": (lambda: Mine(1.0), lambda: Mine(2.0)),
    "a tensor of one's own": (lambda: Mine(1.0, Z), lambda: Mine(1.0, X)),
    "a transform": (
        lambda: Transformed(Independent(), lambda x, c: x),
        lambda: Transformed(Independent(), lambda x, c: -x),
    ),
    "a loss": (lambda: around(Z), lambda: around(X)),
    "a method": (lambda: kind(1)(), lambda: kind(2)()),
    "a method of a class above": (lambda: heir(1)(), lambda: heir(2)()),
    "a method of a loss": (lambda: Scaled(1), lambda: Shifted(1)),
    "a function in the place of a method": (lambda: patched(1), lambda: patched(2)),
    "a function of torch": (lambda: Reflow(torch.tanh), lambda: Reflow(torch.relu)),
    "a list of a loss": (lambda: Scaled([1.0]), lambda: Scaled([2.0])),
    "a set of a loss": (lambda: Scaled({"a", "b"}), lambda: Scaled({"a", "c"})),
    "a loss in a loss": (
        lambda: Scaled(FlowMatching()),
        lambda: Scaled(FlowMatching(prediction="data")),
    ),
    "a user's object": (lambda: Scaled(Config(1)), lambda: Scaled(Config(2))),
    "settings": (lambda: Scaled(Namespace(rate=1)), lambda: Scaled(Namespace(rate=2))),
    "a dictionary of the file": (lambda: by_setting(1.0), lambda: by_setting(2.0)),
    "what a network computes": (lambda: Acting(torch.tanh), lambda: Acting(torch.relu)),
    "a network's number": (lambda: Acting(torch.tanh, 2), lambda: Acting(torch.tanh, 3)),
    "a network's hidden number": (
        lambda: Acting(torch.tanh),
        lambda: Acting(torch.tanh, bias=1.0),
    ),
    "heads of attention": (lambda: attention(2), lambda: attention(4)),
    "a layer's function": (lambda: encoder("relu"), lambda: encoder("gelu")),
    "a layer's order": (lambda: encoder(), lambda: encoder(norm_first=True)),
    "a class's number": (lambda: rated(1.0), lambda: rated(2.0)),
    "a network's method": (lambda: module(1), lambda: module(2)),
    "a network's part": (
        lambda: torch.nn.Sequential(torch.nn.Dropout(0.1)),
        lambda: torch.nn.Sequential(torch.nn.Dropout(0.2)),
    ),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_contents_are_told_apart_and_equal_ones_are_not(name):
    one, other = OTHERS[name]
    assert contents(one()) == contents(one())
    assert contents(one()) != contents(other())


def test_a_teacher_that_is_a_global_counts_with_its_weights():
    def teacher(x, c):
        return TEACHER(x)

    before = contents(Reflow(teacher))
    with torch.no_grad():
        TEACHER.weight.add_(1)
    assert contents(Reflow(teacher)) != before


@pytest.mark.parametrize("network", [ByModule, ByClass, ByInner])
def test_what_a_network_uses_of_a_users_module_counts(network, monkeypatch):
    first = using(1, network, monkeypatch)
    assert using(2, network, monkeypatch) != first
    assert using(1, network, monkeypatch) == first


def test_what_training_changes_does_not_count():
    data = Dataset(X, C)
    for coupling in (StratifiedOT(4), StratifiedOT(KMeansCondition(4)), Mine(1.0), MinibatchOT()):
        fresh, before = copy.deepcopy(coupling), contents(coupling)
        next(coupling.stream(data, batch_size=16))
        assert contents(coupling) == before
        fresh.load_state_dict(coupling.state_dict())
        assert contents(fresh) == before
    assert contents(FlowMatching(0.3)) != contents(FlowMatching(0.4))


@pytest.mark.slow
def test_a_network_in_another_mode_or_compiled_is_the_same():
    network = Acting(torch.tanh)
    before = contents(network)
    network(0.0, X, C)
    assert contents(network.eval()) == before
    assert contents(torch.compile(network)) == before
    assert contents(torch.nn.Sequential(torch.compile(network))) == contents(
        torch.nn.Sequential(network)
    )


def test_a_class_without_a_text_is_known_by_its_name():
    space = {"__name__": "typed_in"}
    exec("class K:\n    def f(self): return 1", space)
    assert contents(space["K"]()) == contents(space["K"]())


def test_a_checkpoint_is_refused_by_another_network(tmp_path):
    def train(act, step=1):
        options = {"steps": 2, "batch_size": 8, "checkpoint": tmp_path / "a.safetensors"}
        return fit(Acting(act), Dataset(X, C), kind(step)(), **options)

    train(torch.tanh)
    train(torch.tanh)
    with pytest.raises(ValueError, match="contents of the network was"):
        train(torch.relu)
    with pytest.raises(ValueError, match="contents of the coupling was"):
        train(torch.tanh, -1)


@pytest.mark.parametrize("part", ["coupling", "loss"])
def test_a_checkpoint_is_refused_with_other_contents(tmp_path, part):
    def train(first):
        parts = {"coupling": FixedPairs(Z), "loss": around(Z)}
        parts[part] = {"coupling": FixedPairs, "loss": around}[part](Z if first else -Z)
        options = {"steps": 2, "batch_size": 8, "checkpoint": tmp_path / "a.safetensors"}
        return fit(net(0), Dataset(X, C), parts["coupling"], loss=parts["loss"], **options)

    train(True)
    train(True)
    with pytest.raises(ValueError, match=f"contents of the {part} was"):
        train(False)


def test_what_only_watches_does_not_count():
    log, lock = logging.getLogger("cotlearn.test"), threading.Lock()
    first = contents(Scaled({"log": None})), contents(Scaled(log)), contents(Scaled(lock))
    log.setLevel(logging.ERROR)
    assert contents(Scaled(log)) == first[1]
    with lock:
        assert contents(Scaled(lock)) == first[2]
