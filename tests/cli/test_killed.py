"""Ctrl-C or kill -9 in the middle of a command: the same command goes on, and nothing is lost.

`grade`, `check`, `run` and `homework` have tests in tests/course.
"""

import contextlib
import os
import signal
import sys
import time
from itertools import islice

import numpy as np
import pytest
from support import soon, until

from cotlearn.policies.policy import ChunkPolicy
from cotlearn.report import FewStepModel
from cotlearn.robots.episodes import read

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="no kill -9"),
    pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT]),
]


def command(words, folder):
    """`cotlearn` in a process of its own, with checkpoints, a small advice and few rollouts."""
    from cotlearn.cli import app
    from cotlearn.diagnostics import recommendation
    from cotlearn.flows import training
    from cotlearn.policies import scores
    from cotlearn.report import findings

    advice = findings.recommend
    small = {"rows": 128, "probe_steps": 10}
    findings.recommend = lambda *given, **options: advice(*given, **options | small)
    candidates = recommendation.candidates
    recommendation.candidates = lambda x1, c: dict(islice(candidates(x1, c).items(), 2))
    training.CHECKPOINT_EVERY = 100
    scores.MODE_STARTS = scores.MODE_DRAWS = 2
    os.environ["COTLEARN_PROGRESS"] = "0"
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a `make test &` ignores Ctrl-C
    os.chdir(folder)
    with open("said.txt", "w") as said, contextlib.redirect_stdout(said):
        os.dup2(said.fileno(), 1)
        app([str(word) for word in words])


@pytest.fixture
def start(warm):
    """Starts a command in a process that has imported everything already."""

    def started(words, folder):
        process = warm.Process(target=command, args=(words, folder))
        process.start()
        return process

    return started


def end_when_there_is(file, process, number):
    """Ends a process as soon as a file is there."""
    until(lambda: file.exists() or not process.is_alive(), patience=600, every=0.01)
    assert process.is_alive(), f"ended with {process.exitcode}"
    begun = time.monotonic()
    os.kill(process.pid, number)
    process.join()
    assert process.exitcode == (130 if number == signal.SIGINT else -number)
    assert time.monotonic() - begun < soon()


def finish(process, folder):
    process.join(600)
    said = (folder / "said.txt").read_text()
    assert process.exitcode == 0, said
    (folder / "said.txt").unlink()
    return said


def test_demos(tmp_path, start, number):
    words = ["demos", "arm-ring", "--episodes", 60, "--out", "made.npz"]
    part = tmp_path / "made.npz.parts" / "000000-000050.npz"
    end_when_there_is(part, start(words, tmp_path), number)
    assert not (tmp_path / "made.npz").exists()
    part.rename(tmp_path / "kept.npz")
    before = (tmp_path / "kept.npz").stat()
    os.link(tmp_path / "kept.npz", part)
    finish(start(words, tmp_path), tmp_path)
    assert (tmp_path / "kept.npz").stat().st_mtime_ns == before.st_mtime_ns
    whole, kept = read(tmp_path / "made.npz"), read(tmp_path / "kept.npz")
    assert len(whole) == 60
    assert (whole.state[: len(kept.state)] == kept.state).all()
    assert not part.parent.exists()


def test_train(tmp_path, start, number):
    words = ["train", "arm-ring", "--coupling", "behaviour_cloning", "--steps", 300]
    words += ["--batch-size", 4, "--episodes", 20, "--rollouts", 0, "--out", "made.safetensors"]
    checkpoint = tmp_path / "made.training.safetensors"
    end_when_there_is(checkpoint, start(words, tmp_path), number)
    assert not (tmp_path / "made.safetensors").exists()
    other = tmp_path / "homemade.training.safetensors"  # of another run
    other.write_bytes(b"")
    made = tmp_path / "made.safetensors"
    words[words.index("--rollouts") + 1] = 5000
    end_when_there_is(made, start(words, tmp_path), number)  # in the rollouts
    content = made.read_bytes()
    assert checkpoint.exists()  # so that nothing is trained again
    words[words.index("--rollouts") + 1] = 1
    finish(start(words, tmp_path), tmp_path)
    assert made.read_bytes() == content
    other.unlink()
    assert ChunkPolicy.load(tmp_path / "made.safetensors").windows.task.name == "arm-ring"
    left = {file.name for file in tmp_path.iterdir() if not file.name.startswith(".")}
    assert left == {"made.safetensors"}


def test_report(tmp_path, start, number):
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "mine.npz", x1=rng.normal(size=(200, 2)), c=rng.normal(size=(200, 1)))
    words = ["report", "mine.npz", "--steps", 120, "--out", "r.html"]
    checkpoint = tmp_path / ".r.html.independent.training.safetensors"
    end_when_there_is(checkpoint, start(words, tmp_path), number)
    kept = checkpoint.stat()
    other = tmp_path / ".r.html.b.independent.training.safetensors"  # of --out r.html.b
    other.write_bytes(b"")
    assert "page: r.html" in finish(start(words, tmp_path), tmp_path)
    assert kept.st_size
    other.unlink()
    FewStepModel.load(tmp_path / "r.safetensors")
    left = {file.name for file in tmp_path.iterdir()}
    assert left == {"mine.npz", "r.html", "r.safetensors"}


def test_bench(tmp_path, start, number):
    words = ["bench", "arm-ring", "behaviour_cloning", "--seeds", "0,1", "--episodes", 2]
    words += ["--train-episodes", 20, "--steps", 20, "--batch-size", 4]
    words += ["--tables", "tables", "--weights", "weights"]
    table = tmp_path / "tables" / "study.csv"
    end_when_there_is(table, start(words, tmp_path), number)
    before = table.read_text().splitlines()
    assert "2 cells, 1 done already" in finish(start(words, tmp_path), tmp_path)
    assert table.read_text().splitlines()[: len(before)] == before
    assert len(table.read_text().splitlines()) == len(before) + 1
    assert not list((tmp_path / "weights").glob("*training*"))
