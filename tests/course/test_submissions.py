"""Reading hand-ins, damaged and foreign ones included."""

import json

import handed_in
import nbformat
import pytest

from cotlearn.course import assets, submissions


def read(tmp_path, *sources, name="hw1.ipynb", **metadata):
    notebook = nbformat.v4.new_notebook(metadata=metadata)
    notebook.cells = [nbformat.v4.new_code_cell(source) for source in sources]
    handed_in.write(tmp_path / name, notebook)
    return submissions.read(tmp_path / name)


def test_cells_that_import_answer_or_check_are_plain(tmp_path):
    handed_in.write(tmp_path / "hw1.ipynb", handed_in.homework({"euler": "x"}, extra=("y = 1",)))
    found = submissions.read(tmp_path / "hw1.ipynb").cells
    assert [cell.plain for cell in found] == [True, False, True, True]
    assert [cell.number for cell in found] == [1, 2, 3, 4]


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
    with pytest.raises(ValueError, match=r"hw2\.ipynb is not a notebook: it is a folder, a link"):
        submissions.read(tmp_path / "hw2.ipynb")
    (tmp_path / "hw2.py").touch()
    with pytest.raises(ValueError, match=r"hand in the notebook \(\.ipynb\)"):
        submissions.read(tmp_path / "hw2.py")
    with (tmp_path / "large.ipynb").open("wb") as file:
        file.truncate(10**10)
    with pytest.raises(ValueError, match="too large: 10,000 MB"):
        submissions.read(tmp_path / "large.ipynb")


@pytest.mark.parametrize("kernel", [None, {}, {"language": None}])
def test_a_notebook_that_names_no_kernel_is_in_python(tmp_path, kernel):
    path = tmp_path / "hw1.ipynb"
    metadata = {"kernelspec": kernel, "cotlearn": None}
    path.write_text(json.dumps({**handed_in.homework({}), "metadata": metadata}))
    assert submissions.read(path).assignment == "hw1"


@pytest.mark.parametrize("metadata", [{"kernelspec": 3}, {"cotlearn": [1]}])
def test_fields_that_are_not_what_they_were(tmp_path, metadata):
    path = tmp_path / "hw1.ipynb"
    path.write_text(json.dumps({**handed_in.homework({}), "metadata": metadata}))
    with pytest.raises(ValueError, match="not a readable notebook"):
        submissions.read(path)


def test_another_kernel(tmp_path):
    with pytest.raises(ValueError, match="runs with a kernel for julia; choose the kernel Python"):
        read(tmp_path, "x = 1", kernelspec={"name": "j", "display_name": "j", "language": "julia"})


def test_the_assignment(tmp_path):
    assert read(tmp_path, "x = 1", name="é hw3 (1).ipynb").assignment == "hw3"
    assert read(tmp_path, 'check(f, "hw2.pair")', name="mine.ipynb").assignment == "hw2"
    assert read(tmp_path, 'check(f, "01.midpoint")', name="mine.ipynb").assignment == "01"
    stamp = {"assignment": "hw4", "version": "0.1.0"}
    assert read(tmp_path, 'check(f, "hw2.pair")', cotlearn=stamp).assignment == "hw4"
    with pytest.raises(ValueError, match=r"mine\.ipynb belongs to no assignment"):
        read(tmp_path, "x = 1", name="mine.ipynb")


def test_an_extra_is_not_the_lesson_of_its_number(monkeypatch):
    """The lesson's exercises were missing in it, and their ticks became crosses."""
    extras = assets.notebooks("extras")
    assert len(extras) > 10
    for path in extras:
        with pytest.raises(ValueError, match="is an extra, whose own cells judge"):
            submissions.read(path)


def test_the_challenge_has_a_command_of_its_own():
    """It was said to belong to no assignment, and a fresh copy does neither."""
    path = assets.course_folder() / "notebooks" / "homework" / "challenge.ipynb"
    with pytest.raises(ValueError, match="has no exercises to check; cotlearn challenge FILE"):
        submissions.read(path)
