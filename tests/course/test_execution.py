import json

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from cotlearn.course import execution, pages


@pytest.fixture
def write(tmp_path):
    """Writes a notebook of the given code cells into a folder with a space in its name."""
    folder = tmp_path / "a folder"
    folder.mkdir()

    def write(*sources, name="00_example"):
        cells = [new_markdown_cell("# 00 · An example")]
        cells += [new_code_cell(source) for source in sources]
        path = folder / f"{name}.ipynb"
        nbformat.write(new_notebook(cells=cells), path)
        return path

    return write


@pytest.mark.slow
def test_a_notebook_that_runs(write, tmp_path, monkeypatch, capsys):
    # A kernel of that name which somebody registered must not get in the way.
    rogue = tmp_path / "rogue" / "kernels" / "python3"
    rogue.mkdir(parents=True)
    (rogue / "kernel.json").write_text('{"argv": ["false"], "display_name": "x", "language": "x"}')
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setenv("JUPYTER_PATH", str(tmp_path / "rogue"))
    path = write(
        "import os, sys\nprint(sys.executable)\nprint('✓ claim: it is so')",
        "assert os.environ['COTLEARN_PROGRESS'] == '0'\n"
        "assert os.environ['OMP_NUM_THREADS'] == '1'\nopen('here.txt', 'w').close()",
        "1 + 1",
    )
    before = path.read_bytes()
    monkeypatch.setenv("COTLEARN_PROGRESS", "1")
    run = execution.execute(path)
    assert not run.error
    assert run.claims == 1
    assert "00_example:   0%" in capsys.readouterr().err
    assert (path.parent / "here.txt").exists()
    assert path.read_bytes() == before

    execution.store(run)
    assert nbformat.read(path, as_version=4).cells[-1].outputs[0].data["text/plain"] == "2"
    assert [item.name for item in path.parent.iterdir() if item.name.startswith(".")] == []

    page = pages.to_html(run, tmp_path / "pages")
    assert "An example" in page.read_text(encoding="utf-8")
    index = pages.write_index([run], tmp_path / "pages").read_text(encoding="utf-8")
    assert 'href="00_example.html"' in index
    assert "The notebooks as they ran" in index


def test_links_to_files_that_are_not_there_become_text(tmp_path):
    page = tmp_path / "a.html"
    kept = '<a href="a.html#x">1</a> <a href="https://a.b/c">2</a> <a class="z" href="#y">3</a>'
    page.write_text(f'{kept} <a href="../docs/play.md"><code>4</code></a>', "utf-8")
    pages.unlink_missing(page)
    assert page.read_text("utf-8") == f"{kept} <code>4</code>"


@pytest.mark.slow
def test_a_failing_cell_is_named_and_ends_the_run(write):
    run = execution.execute(write("x = 1", "x / 0", "print('✓ claim: never reached')"))
    assert run.claims == 0
    assert run.failed == 2
    assert "ZeroDivisionError" in run.error


@pytest.mark.slow
def test_an_endless_cell_is_stopped(write):
    run = execution.execute(write("while True:\n    pass"), timeout=1)
    assert "longer than 1 seconds" in run.error


@pytest.mark.slow
def test_a_kernel_that_dies_is_noticed(write):
    run = execution.execute(write("import os\nos._exit(1)"))
    assert run.failed == 1
    assert "kernel died" in run.error


@pytest.mark.slow
def test_a_notebook_without_code(write):
    run = execution.execute(write())
    assert not run.error
    assert execution.title(run.notebook) == "00 · An example"


def test_cells_without_an_id_of_their_own_get_one_without_a_word(write, caplog, recwarn):
    """Jupyter's package printed a warning with a path inside Python among the lines of a class."""
    path = write("1", "2", "3")
    stored = json.loads(path.read_text())
    stored["cells"][1].pop("id")
    stored["cells"][3]["id"] = stored["cells"][2]["id"]
    stored["cells"][2]["more"] = "than the format knows"
    path.write_text(json.dumps(stored))
    cells = execution.read(path).cells
    assert [cell.source for cell in cells[1:]] == ["1", "2", "3"]
    assert len({cell.id for cell in cells}) == 4
    assert cells[0].id == stored["cells"][0]["id"]
    stored["nbformat_minor"] = 4
    path.write_text(json.dumps(stored))
    assert "id" not in execution.read(path).cells[1]
    assert not [*recwarn, *caplog.records]


def test_damaged_and_missing_files(tmp_path):
    damaged = tmp_path / "damaged.ipynb"
    damaged.write_text('{"cells": [')
    with pytest.raises(ValueError, match="not a readable notebook"):
        execution.execute(damaged)
    with pytest.raises(ValueError, match="there is no notebook at"):
        execution.execute(tmp_path / "none.ipynb")
    with pytest.raises(ValueError, match="timeout must be at least 1"):
        execution.execute(damaged, timeout=0)
