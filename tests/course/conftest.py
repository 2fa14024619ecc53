import handed_in
import pytest


@pytest.fixture(scope="module")
def masters(tmp_path_factory):
    """A folder with a homework 1 of one question."""
    return handed_in.masters(tmp_path_factory.mktemp("masters"))


@pytest.fixture
def begun(warm, tmp_path):
    """Starts a command in a folder, from a process that has imported everything."""
    processes = []

    def start(words, environment):
        processes.append(
            warm.Process(target=handed_in.command, args=(words, tmp_path, environment))
        )
        processes[-1].start()
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.join()
