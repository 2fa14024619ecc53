"""kill -9 in the middle of a command: the same command goes on, and nothing that was done is lost.

`cotlearn grade` has its own test in tests/homework/test_grading.py.
"""

import os
import signal
import subprocess
import sys
import time

import pytest

from cotlearn.policies.policy import ChunkPolicy
from cotlearn.robots.episodes import read

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="no kill -9"),
]
QUIET = {**os.environ, "COTLEARN_PROGRESS": "0", "OMP_NUM_THREADS": "1"}
PATIENCE = 600  # seconds, on a very busy machine


#: `cotlearn`, but with a checkpoint every 100 steps, and with four rollouts for the modes, not 400.
SMALL = """
from cotlearn.flows import training
from cotlearn.policies.comparison import scores
training.fit.__kwdefaults__["checkpoint_every"] = 100
scores.MODE_STARTS = scores.MODE_DRAWS = 2
from cotlearn.cli import main
main()
"""


def start(words, folder):
    command = [sys.executable, "-c", SMALL, *map(str, words)]
    return subprocess.Popen(
        command, cwd=folder, env=QUIET, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def kill_when_there_is(file, words, folder):
    """Start a command, and kill it as soon as a file is there."""
    process = start(words, folder)
    deadline = time.monotonic() + PATIENCE
    while not file.exists():
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() < deadline, f"no {file}"
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL


def finish(words, folder):
    process = start(words, folder)
    said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    return said


def test_demos(tmp_path):
    words = ["demos", "arm-ring", "--episodes", 60, "--out", "made.npz"]
    part = tmp_path / "made.npz.parts" / "000000-000050.npz"
    kill_when_there_is(part, words, tmp_path)
    assert not (tmp_path / "made.npz").exists()
    part.rename(tmp_path / "kept.npz")
    before = (tmp_path / "kept.npz").stat()
    os.link(tmp_path / "kept.npz", part)
    finish(words, tmp_path)
    assert (tmp_path / "kept.npz").stat().st_mtime_ns == before.st_mtime_ns
    whole, kept = read(tmp_path / "made.npz"), read(tmp_path / "kept.npz")
    assert len(whole) == 60
    assert (whole.state[: len(kept.state)] == kept.state).all()
    assert not part.parent.exists()


def test_train(tmp_path):
    words = ["train", "arm-ring", "--coupling", "behaviour_cloning", "--steps", 600]
    words += ["--batch-size", 4, "--episodes", 20, "--rollouts", 0, "--out", "made.safetensors"]
    checkpoint = tmp_path / "made.training.safetensors"
    kill_when_there_is(checkpoint, words, tmp_path)
    assert not (tmp_path / "made.safetensors").exists()
    finish(words, tmp_path)
    assert ChunkPolicy.load(tmp_path / "made.safetensors").windows.task.name == "arm-ring"
    left = {file.name for file in tmp_path.iterdir() if not file.name.startswith(".")}
    assert left == {"made.safetensors"}


def test_bench(tmp_path):
    words = ["bench", "arm-ring", "--methods", "behaviour_cloning", "--seeds", "0,1"]
    words += ["--episodes", 2, "--train-episodes", 20, "--held-out", 5, "--steps", 20]
    words += ["--batch-size", 4, "--folder", "cells", "--weights", "weights"]
    words += ["--summary", "summary.json"]
    first = tmp_path / "cells" / "behaviour_cloning-0.json"
    kill_when_there_is(first, words, tmp_path)
    before = first.read_bytes()
    said = finish(words, tmp_path)
    assert "2 cells, 1 done already" in said
    assert first.read_bytes() == before
    assert (tmp_path / "cells" / "behaviour_cloning-1.json").exists()
    assert (tmp_path / "summary.json").exists()
    assert not list((tmp_path / "weights").glob("*training*"))
