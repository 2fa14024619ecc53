"""Small notebooks for the tests of marking and grading, and the command that reads them."""

import os
import signal
import sys

import nbformat

from cotlearn.__main__ import main
from cotlearn.course import assignments
from cotlearn.course.execution import read

SETUP = "import torch\nfrom cotlearn.course import check"

PAIR = """def flow_matching_loss(network, x0, x1, t):
    place = (1 - t[:, None]) * x0 + t[:, None] * x1
    return (network(t, place) - (x1 - x0)).square().sum(dim=1)"""
EULER = """def euler(velocity, x0, nfe):
    x = x0
    for k in range(nfe):
        x = x + velocity(torch.full((len(x),), k / nfe), x) / nfe
    return x"""
EXACT = """def exact_velocity(t, x, means, s):
    ..."""
W2 = """from scipy.optimize import linear_sum_assignment
def squared_w2(a, b):
    cost = torch.cdist(a, b).square()
    return cost[linear_sum_assignment(cost)].mean()"""
NAMES = "loss", "euler", "exact_velocity", "squared_w2"


def answers(**changed: str) -> dict[str, str]:
    """Three right answers and a stub for homework 1, with some of them changed."""
    return dict(zip(NAMES, (PAIR, EULER, EXACT, W2), strict=True)) | changed


def homework(sources: dict[str, str], *, extra: tuple[str, ...] = (), stamp: bool = True):
    """A notebook for homework 1 with these answers."""
    notebook = nbformat.v4.new_notebook()
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook.metadata = {"kernelspec": kernel}
    if stamp:
        notebook.metadata["cotlearn"] = {"assignment": "hw1", "version": "0.1.0"}
    notebook.cells = [nbformat.v4.new_code_cell(SETUP)]
    notebook.cells += [nbformat.v4.new_code_cell(source) for source in extra]
    for name, source in sources.items():
        metadata = {"tags": ["exercise"], "cotlearn": {"question": f"hw1.{name}"}}
        notebook.cells.append(nbformat.v4.new_code_cell(source, metadata=metadata))
        call = {"loss": "flow_matching_loss"}.get(name, name)
        notebook.cells.append(nbformat.v4.new_code_cell(f'check({call}, "hw1.{name}")'))
    return notebook


def write(path, notebook) -> None:
    """Stores a notebook."""
    path.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(notebook, path)


def masters(folder):
    """A folder with a homework 1 that has one question, euler."""
    kept, notebook = [], read(assignments.find("hw1").path)
    left_out = False
    for cell in notebook.cells:
        if cell.source.startswith("# BEGIN QUESTION"):
            left_out = "name: euler\n" not in cell.source
        kept += [] if left_out else [cell]
    notebook.cells = kept
    write(folder / "hw1.ipynb", notebook)
    return folder


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
