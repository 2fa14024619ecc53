import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_notebook
from typer.testing import CliRunner

from cotlearn import cli
from cotlearn.cli import course
from cotlearn.course import assets, copies, doctor, execution, record


def invoke(*arguments):
    return CliRunner().invoke(cli.app, list(arguments))


@pytest.fixture
def notebook(tmp_path):
    def write(*sources):
        path = tmp_path / "a notebook.ipynb"
        nbformat.write(new_notebook(cells=[new_code_cell(source) for source in sources]), path)
        return path

    return write


@pytest.mark.slow
def test_run_stores_outputs_and_pages(notebook, tmp_path):
    path = notebook("print('✓ claim: it is so')", "6 * 7")
    result = invoke("run", str(path), "--inplace", "--html", str(tmp_path / "pages"))
    assert result.exit_code == 0, result.output
    assert "1 claim passed" in result.output
    assert result.output.startswith("executing a notebook ...")
    assert nbformat.read(path, as_version=4).cells[1].outputs[0].data["text/plain"] == "42"
    pages = {page.name for page in (tmp_path / "pages").glob("*.html")}
    assert pages == {"a notebook.html", "index.html"}


@pytest.mark.slow
def test_a_run_of_pages_that_is_stopped_goes_on(notebook, tmp_path, monkeypatch):
    """It said so, and began again with the first notebook."""
    first = notebook("print('✓ claim: it is so')")
    second = first.rename(tmp_path / "b.ipynb")
    first = notebook("print('✓ claim: it is so')")
    pages, execute = tmp_path / "pages", execution.execute
    words = ("run", str(first), str(second), "--html", str(pages))

    def stopped(path, **options):
        if path == second:
            raise KeyboardInterrupt
        return execute(path, **options)

    monkeypatch.setattr(execution, "execute", stopped)
    result = invoke(*words)
    assert result.exit_code == 130
    assert "again to go on" in result.output

    monkeypatch.setattr(execution, "execute", execute)
    result = invoke(*words)
    assert result.exit_code == 0, result.output
    assert result.output.startswith("a notebook was executed before the stop\nexecuting b ...")
    assert "2 notebooks" in result.output
    assert "2 claims passed" in result.output
    assert not list(pages.glob(".*"))  # nothing is kept any more

    result = invoke(*words)
    assert result.output.startswith("executing a notebook ...")


@pytest.mark.slow
def test_run_shows_the_failing_cell(notebook):
    path = notebook("x = 1", "y = x / 0  # [not markup]", "print('never')")
    before = path.read_bytes()
    result = invoke("run", str(path), "--inplace")
    assert result.exit_code == 1
    assert "cell 1 of" in result.output
    assert "y = x / 0  # [not markup]" in result.output
    assert "ZeroDivisionError" in result.output
    assert path.read_bytes() == before


def test_run_knows_near_names(monkeypatch):
    found = {"": [Path("00_start_here.ipynb")]}
    monkeypatch.setattr(assets, "notebooks", lambda room="": found.get(room, []))
    result = invoke("run", "00_start_her")
    assert result.exit_code == 2
    assert "there is no notebook '00_start_her'; did you mean: 00_start_here?" in result.output


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "said"),
    [("hw1", "executed; cotlearn check hw1 judges the answers"), ("challenge", "1 claim passed")],
)
def test_run_finds_homework_by_its_name(name, said, monkeypatch, tmp_path):
    """It said that there is no such notebook; and homework runs without a right answer, too."""
    monkeypatch.setattr(copies, "folder", lambda: tmp_path)
    code = [new_code_cell(f"print('✓ claim: {name} ran')")]
    nbformat.write(new_notebook(cells=code), tmp_path / f"{name}.ipynb")
    result = invoke("run", name)
    assert (result.exit_code, f"executing {name} ..." in result.output) == (0, True)
    assert said in result.output


def test_run_refuses_a_damaged_notebook(tmp_path):
    path = tmp_path / "damaged.ipynb"
    path.write_text("{")
    result = invoke("run", str(path))
    assert result.exit_code == 2
    assert "not a readable notebook" in result.output
    assert "Traceback" not in result.output


@pytest.fixture
def launched(monkeypatch):
    """Records the command that would start JupyterLab."""
    commands = []
    monkeypatch.setattr(course, "_serve", lambda *given: commands.append(given) or 0)
    return commands


def test_lab_in_a_checkout_opens_copies_beside_the_notebooks(launched, monkeypatch, tmp_path):
    monkeypatch.setattr(course, "_has_display", lambda: False)
    monkeypatch.setattr(course.os, "geteuid", lambda: 0, raising=False)
    monkeypatch.setattr(course.copies, "make", lambda to, outputs: ([to], []))
    result = invoke("lab", "--port", "9999")
    assert result.exit_code == 0, result.output
    assert "1 notebooks copied" in result.output
    assert "outputs cleared" in result.output
    (command, environment), *_ = launched
    assert command[:3] == [sys.executable, "-m", "jupyterlab"]
    assert "--LabApp.default_url=/lab/tree/my-course/00_start_here.ipynb" in command
    assert f"--ServerApp.root_dir={assets.checkout()}" in command
    assert {"--no-browser", "--allow-root"} <= set(command)
    assert command[-2:] == ["--port", "9999"]
    assert environment["JUPYTER_PATH"].startswith(sys.prefix)
    assert environment["OMP_NUM_THREADS"]
    tabs = assets.checkout() / "my-course" / ".jupyterlab"
    assert environment["JUPYTERLAB_WORKSPACES_DIR"] == str(tabs)


def test_lab_starts_a_notebook_over_and_opens_it(launched, tmp_path, monkeypatch):
    own = tmp_path / "mine"
    invoke("lab", "--to", str(own))
    (own / "03_conditions_break_it.ipynb").write_text("my work")
    monkeypatch.setattr(record, "file", lambda: tmp_path / "progress.json")
    kept = {"04.weight": "correct", "hw1.euler": "correct"}
    record.remember({"03.labels_follow": "correct", **kept})
    result = invoke("lab", "--to", str(own), "--fresh", "03", "--with-outputs")
    assert "yours is now 03_conditions_break_it.backup-1.ipynb" in result.output
    assert record.read().keys() == kept.keys()
    assert (own / "03_conditions_break_it.backup-1.ipynb").read_text() == "my work"
    assert '"image/png"' in (own / "03_conditions_break_it.ipynb").read_text("utf-8")
    assert '"image/png"' not in (own / "02_couplings.ipynb").read_text("utf-8")
    assert "--LabApp.default_url=/lab/tree/03_conditions_break_it.ipynb" in launched[1][0]
    result = invoke("lab", "--to", str(own), "--fresh", "99")
    assert (result.exit_code, len(launched)) == (2, 2)
    assert "there is no notebook '99'" in result.output


def test_lab_without_the_notebook_to_start_over_names_an_example(launched):
    result = invoke("lab", "--fresh")
    assert (result.exit_code, launched) == (2, [])
    assert "cotlearn lab --fresh 03" in result.output


def test_lab_with_a_display_opens_a_browser(launched, monkeypatch):
    monkeypatch.setattr(course, "_has_display", lambda: True)
    monkeypatch.setattr(course.os, "geteuid", lambda: 1000, raising=False)
    monkeypatch.setattr(course.copies, "make", lambda to, outputs: ([], []))
    invoke("lab")
    assert len(launched[0][0]) == 8  # the folder, the first page, how to save, no question, a shell
    assert "terminado_settings={'shell_command':" in launched[0][0][-1]  # which is no login shell


def test_lab_copies_once_to_a_folder_elsewhere(launched, tmp_path, monkeypatch):
    source = tmp_path / "a checkout" / "notebooks"
    source.mkdir(parents=True)
    (source / "00_start_here.ipynb").write_text('{"cells": []}')
    monkeypatch.setattr(assets, "course_folder", lambda: source.parent)
    target = tmp_path / "my work"
    assert "1 notebooks copied" in invoke("lab", "--to", str(target)).output
    (target / "00_start_here.ipynb").write_text("mine")
    assert invoke("lab", "--to", str(target)).output == ""
    assert (target / "00_start_here.ipynb").read_text() == "mine"


def test_lab_without_jupyterlab_says_what_to_install(monkeypatch):
    monkeypatch.setattr(course.importlib.util, "find_spec", lambda name: None)
    result = invoke("lab")
    assert (result.exit_code, "pip install '.[course]'" in result.output) == (2, True)


def examined(monkeypatch, *findings):
    monkeypatch.setattr(doctor, "examine", lambda: list(findings))
    return invoke("doctor")


def test_doctor_passes_when_only_luxuries_are_missing(monkeypatch):
    good = doctor.Finding("Python", "3.12.0", ok=True)
    luxury = doctor.Finding("images", "none", ok=False, required=False, remedy="apt get [them]")
    result = examined(monkeypatch, good, luxury)
    assert (result.exit_code, "apt get [them]" in result.output) == (0, True)
    assert "Not there, and some parts of the course need it: images." in result.output
    assert "has all it needs" not in result.output
    assert "has all it needs" in examined(monkeypatch, good).output


def test_doctor_names_what_a_base_installation_lacks(monkeypatch):
    """It ended in "The course has all it needs", without JupyterLab and the simulators."""
    needed = ["numpy>=1", 'nope>=1; extra == "course"', 'never>=1; extra == "course"']
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: needed)
    monkeypatch.setattr(doctor.assets, "checkout", lambda: None)
    result = examined(monkeypatch, *doctor.check_packages())
    assert result.exit_code == 0
    assert "The library has all it needs; what is marked ! is for the course." in result.output
    assert "then pip install '.[course]'" in result.output
    assert result.output.count("pip install") == 1  # and not a line for each package


@pytest.mark.parametrize(("typed", "meant"), [("repot", "report"), ("doktor", "doctor")])
def test_a_typo_of_a_command_gets_a_suggestion(typed, meant):
    assert f"Did you mean '{meant}'?" in invoke(typed).output


@pytest.mark.slow
def test_lab_asks_nothing_about_news():
    """JupyterLab's toast, and a warning of the debugger for each kernel."""
    found = {**os.environ, "JUPYTER_CONFIG_PATH": str(course.CONFIG)}
    code = "import json; from jupyterlab_server.config import get_page_config as g;"
    code += "print(json.dumps(g([])['disabledExtensions']))"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=found, capture_output=True, text=True, check=False)
    assert "@jupyterlab/apputils-extension:announcements" in done.stdout, done.stderr


def test_doctor_fails_when_something_needed_is_missing(monkeypatch):
    result = examined(monkeypatch, doctor.Finding("torch", "missing", ok=False, remedy="fix me"))
    assert (result.exit_code, "fix me" in result.output) == (1, True)


def test_doctor_compares_versions(monkeypatch):
    needed = ["numpy>=999", "nope>=1", 'pytest; extra == "x"']
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: needed)
    monkeypatch.setattr(doctor.assets, "checkout", lambda: None)
    old, missing = doctor.check_packages()
    assert not old.ok
    assert "supported: >=999" in old.found
    assert missing.found.startswith("missing")
    assert '"nope>=1"' in missing.remedy


def test_doctor_looks_at_this_machine():
    assert doctor.check_matplotlib().ok
    assert doctor.check_processor().ok
    assert "GB free" in doctor.check_disk().found


def test_help_is_grouped_and_the_version_is_printed():
    run = invoke("--version")
    assert (run.exit_code, run.output.strip()) == (0, version("cotlearn"))
    words = invoke("--help").output
    learn, use, teach = (words.index(f" {panel} ") for panel in ("Learn", "Use", "Teach"))
    assert learn < words.index("doctor")
    assert use < words.index("report ") < words.index("watch")
    assert teach < words.index("grade")
