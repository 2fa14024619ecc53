"""Reading learners' notebooks, damaged ones included, and taking out what an answer needs."""

import handed_in
import nbformat
import pytest

from cotlearn.homework import submissions


def read(tmp_path, *sources, name="hw1.ipynb", **metadata):
    notebook = nbformat.v4.new_notebook(metadata=metadata)
    notebook.cells = [nbformat.v4.new_code_cell(source) for source in sources]
    handed_in.write(tmp_path / name, notebook)
    return submissions.read(tmp_path / name)


def needed(submission, name):
    return [cell.number for cell in submission.needed({name})]


def test_an_answer_brings_what_it_uses(tmp_path):
    imports = "import torch", "import numpy as np"
    helper = "scale = 2", "def helper(x):\n    return scale * x"
    answer = "def answer(x):\n    return torch.ones(1) * helper(x)"
    found = read(tmp_path, *imports, *helper, "while True:\n    pass", answer, "1 / 0")
    assert needed(found, "answer") == [1, 3, 4, 6]


F = "def f():\n    return a"


@pytest.mark.parametrize(
    ("cells", "numbers"),
    [
        (("a = 1", "a = 2", F, "a = 3"), [2, 3]),  # the last definition before counts
        ((F, "a = 3"), [1, 2]),  # one after counts if there is none before
        (("f = 1", "f = f + 1"), [1, 2]),  # an answer that changes itself brings both
    ],
)
def test_the_definition_that_counts(tmp_path, cells, numbers):
    assert needed(read(tmp_path, *cells), "f") == numbers


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("import a.b, c as d", {"a", "d"}),
        ("from x import y, z as w", {"y", "w"}),
        ("for i in range(3):\n    j = i", {"i", "j"}),
        ("with open(f) as g:\n    pass", {"g"}),
        ("x, (y, *z) = 1, (2, 3)", {"x", "y", "z"}),
        ("class A:\n    b = 1\n    def c(self):\n        d = 1", {"A"}),
        ("[k for k in range(3)]", set()),
        ("if (n := 3) > 2:\n    m: int = n", {"n", "m"}),
        ("def f(a):\n    b = a", {"f"}),
        ("x.y = 1", set()),
    ],
)
def test_what_a_cell_binds(source, names):
    assert submissions.parse_cell(1, nbformat.v4.new_code_cell(source)).binds == names


def test_lines_of_ipython_are_left_out():
    source = "%matplotlib inline\n!pip install x\n%%y\nx = 7 % 3\nhelp?\nif x:\n    %time f()"
    kept = submissions.python_only(source)
    assert kept.splitlines() == ["pass", "pass", "%%y", "x = 7 % 3", "", "if x:", "    pass"]
    assert submissions.python_only("%%bash\nls") == ""
    assert submissions.python_only("%%time\nx = 1") == "\nx = 1"


BROKEN = [b"", b"hello", b"{}", b"[]", b"null", b'{"cells": 3}', b"\xff\xfe\x00", b'{"cells": [1]}']
BROKEN += [b'z"cells": [], "nbformat": 4}', b'{"cells": [], "nbformat": 4|']


@pytest.mark.parametrize("content", BROKEN)
def test_what_is_no_notebook(tmp_path, content):
    path = tmp_path / "hw 1 é.ipynb"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"hw 1 é\.ipynb is not a readable notebook"):
        submissions.read(path)


def test_what_is_no_file(tmp_path):
    with pytest.raises(ValueError, match="there is no notebook at"):
        submissions.read(tmp_path / "hw1.ipynb")
    (tmp_path / "hw2.ipynb").mkdir()
    with pytest.raises(ValueError, match=r"hw2\.ipynb is not a readable notebook: it is a folder"):
        submissions.read(tmp_path / "hw2.ipynb")


def test_another_kernel(tmp_path):
    with pytest.raises(ValueError, match="runs with a kernel for julia; choose the kernel Python"):
        read(tmp_path, "x = 1", kernelspec={"name": "j", "display_name": "j", "language": "julia"})
    with pytest.raises(ValueError, match="runs with a kernel for r;"):
        read(tmp_path, "x = 1", language_info={"name": "R"})


def test_the_assignment(tmp_path):
    assert read(tmp_path, "x = 1", name="é hw3 (1).ipynb").assignment == "hw3"
    assert read(tmp_path, 'check(f, "hw2.pair")', name="mine.ipynb").assignment == "hw2"
    assert read(tmp_path, 'check(f, "01.midpoint")', name="mine.ipynb").assignment == "01"
    stamp = {"assignment": "hw4", "version": "0.1.0"}
    assert read(tmp_path, 'check(f, "hw2.pair")', cotlearn=stamp).assignment == "hw4"
    assert read(tmp_path, "x = 1", name="mine.ipynb").assignment is None
