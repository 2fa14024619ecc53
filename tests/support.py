"""What many tests need: fixed randomness, batches of a stream, comparisons, refused calls."""

import inspect
import os
import time
import urllib.request

import pytest
import torch

from cotlearn import mixtures


def seeded(seed=0):
    """A generator."""
    return torch.Generator().manual_seed(seed)


def toys():
    """All data sets of `cotlearn.mixtures` by name, with their usual options: a new one joins."""
    functions = inspect.getmembers(mixtures, inspect.isfunction)
    kind = mixtures.ConditionalGaussianMixture
    public = {name: f for name, f in functions if not name.startswith("_")}
    return {name: f() for name, f in public.items() if f.__annotations__.get("return") is kind}


def take(coupling, data, count, batch_size=20, **options):
    """The first batches of a stream."""
    options = {"batch_size": batch_size, "generator": seeded(5), **options}
    stream = coupling.stream(data, **options)
    return [next(stream) for _ in range(count)]


def joined(batches, name):
    """One field of all batches."""
    return torch.cat([getattr(batch, name) for batch in batches])


def same(a, b):
    """Whether two batches are equal, in all but their weights."""
    names = ("x0", "x1", "c", "source_index", "target_index")
    return all(torch.equal(getattr(a, name), getattr(b, name)) for name in names)


def same_weights(a, b):
    """Whether two networks are equal, bit for bit."""
    left, right = a.state_dict(), b.state_dict()
    return left.keys() == right.keys() and all(torch.equal(left[k], right[k]) for k in left)


class Still(torch.nn.Module):
    """A network whose velocity is zero."""

    def forward(self, t, x, c=None):
        return torch.zeros_like(x)


def refused(*cases, error=None, of=None):
    """A test of wrong calls; each case is (call, error, message).

    With an `error` for all of them, each case is (call, message). With `of`, which is the function
    that all of them call, its arguments as a dictionary take the place of the call.
    """
    rows = [case if error is None else (case[0], error, case[1]) for case in cases]

    @pytest.mark.parametrize(("call", "error", "message"), rows)
    def test(call, error, message):
        with pytest.raises(error, match=message):
            call() if of is None else of(**call)

    return test


def soon():
    """Three seconds, or as much longer as this machine is busy."""
    return 3 * max(1, os.getloadavg()[0] / (os.cpu_count() or 1))


def until(condition, *, patience=120, every=0.05):
    """Wait until something is so; `patience` is seconds."""
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(every)


def until_answered(server, port, seconds=120):
    """Wait until a Jupyter server, a process, answers at its port."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and server.poll() is None:
        try:
            urllib.request.urlopen(f"http://localhost:{port}/api", timeout=5)
        except OSError:
            time.sleep(0.5)
        else:
            return
    pytest.fail("JupyterLab did not start")
