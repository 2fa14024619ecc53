import os
import signal
import sys

import handed_in
import pytest

from cotlearn.__main__ import main


def command(words, folder, environment):
    """`cotlearn` in a process that has imported everything."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a `make test &` ignores Ctrl-C
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    said = os.open("said", os.O_CREAT | os.O_WRONLY)
    os.dup2(said, 1)
    os.dup2(said, 2)
    sys.path.insert(0, "")  # as `python -m` does
    sys.argv = ["cotlearn", *words]
    main()


@pytest.fixture
def key(monkeypatch):
    """Of grading."""
    monkeypatch.setenv("COTLEARN_GRADING_KEY", "of these tests")


@pytest.fixture(scope="module")
def masters(tmp_path_factory):
    """A folder with a homework 1 of one question."""
    return handed_in.masters(tmp_path_factory.mktemp("masters"))


@pytest.fixture
def begun(warm, tmp_path):
    """Starts a command in a folder, from a process that has imported everything."""
    processes = []

    def start(words, environment):
        processes.append(warm.Process(target=command, args=(words, tmp_path, environment)))
        processes[-1].start()
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.join()
