"""course.py, as if it lay in an empty checkout in a folder with a space."""

import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from unittest import mock

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_notebook

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def script(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("course_script", ROOT / "course.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    root = tmp_path / "a checkout"
    root.mkdir()
    (root / "pyproject.toml").write_text("[project]\n")
    (root / "constraints.txt").write_text("numpy==2\n")
    module.ROOT, module.VENV = root, root / ".venv"
    module.PYTHON, module.STAMP = module.VENV / "bin" / "python", module.VENV / "stamp.txt"
    monkeypatch.delenv("COTLEARN_PEERS", raising=False)
    return module


@pytest.fixture
def installs(script, monkeypatch):
    """Replaces the slow steps of the set-up and records that they were taken."""
    steps = []

    def create(base):
        steps.append("create")
        script.VENV.mkdir()

    monkeypatch.setattr(script, "create", create)
    monkeypatch.setattr(script, "install", lambda *what: steps.append(what[-1]))
    monkeypatch.setattr(script, "can_run", lambda python, code: script.VENV.exists())
    monkeypatch.setattr(script, "find_python", lambda: sys.executable)
    return steps


FIRST = ["create", ".[dev]", "torchcfm"]


def test_the_second_run_installs_nothing(script, installs):
    script.set_up("dev")
    script.set_up("dev")
    assert installs == FIRST


def test_peers_are_added_and_serve_those_who_need_none(script, installs):
    script.set_up("dev")
    for extras in ("dev,peers", "dev", "dev,peers"):
        script.set_up(extras)
    assert installs == [*FIRST, ".[dev,peers]", "torchcfm"]


@pytest.mark.parametrize("name", ["pyproject.toml", "constraints.txt"])
def test_a_changed_file_installs_again_in_place(script, installs, name):
    script.set_up("dev")
    (script.ROOT / name).write_text("changed")
    script.set_up("dev")
    assert installs == FIRST + FIRST[1:]


def test_line_ends_of_windows_are_no_change(script):
    before = script.fingerprint("dev")
    (script.ROOT / "constraints.txt").write_bytes(b"numpy==2\r\n")
    assert script.fingerprint("dev") == before


def test_an_interrupted_set_up_goes_on(script, installs, monkeypatch, capsys):
    def interrupt(*what):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(script, "install", interrupt)
        assert script.main(["setup"]) == 130
    assert "run the same command again" in capsys.readouterr().out
    assert script.main(["setup"]) == 0
    assert installs == FIRST


@pytest.mark.parametrize("content", ["", "of something else"])
def test_a_damaged_stamp_counts_for_nothing(script, installs, content):
    script.set_up("dev")
    script.STAMP.write_text(content)
    script.set_up("dev")
    assert installs == FIRST + FIRST[1:]


def test_a_damaged_environment_is_named(script, installs, monkeypatch):
    monkeypatch.setattr(script, "is_whole", lambda: False)
    with pytest.raises(SystemExit, match=r"remove .*\.venv and run the same command again"):
        script.set_up("dev")
    assert not script.STAMP.exists()


def test_uv_installs_or_else_pip(script, monkeypatch):
    commands = []
    monkeypatch.setattr(script, "run", lambda *words: commands.append(words) or 1)
    monkeypatch.setattr(script.shutil, "which", lambda name, path=None: "/bin/uv")
    with pytest.raises(SystemExit, match="Is the network reachable"):
        script.install("numpy")
    assert [command[:2] for command in commands] == [("/bin/uv", "pip"), (script.PYTHON, "-m")]
    monkeypatch.setattr(script.shutil, "which", lambda name, path=None: None)
    with pytest.raises(SystemExit):
        script.install("numpy")
    assert commands[2][:4] == (script.PYTHON, "-m", "pip", "install")
    assert commands[2][-2:] == ("--constraint", "constraints.txt")


def test_it_is_said_that_pip_does_not_know_what_uv_was_asked(script, monkeypatch, capsys):
    monkeypatch.setenv("UV_TORCH_BACKEND", "cpu")
    monkeypatch.setattr(script, "run", lambda *words: int("uv" in str(words[0])))
    monkeypatch.setattr(script.shutil, "which", lambda name, path=None: "/bin/uv")
    script.install("numpy")
    assert "pip does not know UV_TORCH_BACKEND" in capsys.readouterr().out


def test_an_unsupported_python_looks_for_another(script, monkeypatch):
    monkeypatch.setattr(script.sys, "version_info", (3, 14))
    monkeypatch.setattr(script.shutil, "which", lambda name: None)
    with pytest.raises(SystemExit, match=r"needs Python 3\.11 to 3\.13 .* this is python3\.14"):
        script.find_python()
    monkeypatch.setattr(script.shutil, "which", lambda name: f"/bin/{name}")
    monkeypatch.setattr(script, "can_run", lambda python, code: "3.12" in str(python))
    assert script.find_python() == "/bin/python3.12"


def test_a_missing_venv_module_names_the_package(script, monkeypatch):
    monkeypatch.setattr(script, "can_run", lambda python, code: False)
    major, minor = sys.version_info[:2]
    with pytest.raises(SystemExit, match=rf"sudo apt install python{major}\.{minor}-venv"):
        script.find_python()


def test_disk_and_download(script, monkeypatch, capsys):
    monkeypatch.setattr(script.sys, "platform", "linux")
    monkeypatch.delenv("UV_TORCH_BACKEND", raising=False)
    script.announce()
    printed = capsys.readouterr().out
    assert "GB to download" in printed
    assert "UV_TORCH_BACKEND=cpu" in printed
    script.DISK = 1e9
    with pytest.raises(SystemExit, match="GB are free"):
        script.announce()


def test_unknown_command_and_help(script, capsys):
    assert script.main(["lap"]) == 2
    assert "there are: test, lab, check, course" in capsys.readouterr().out
    assert script.main([]) == 2
    assert "python course.py lab" in capsys.readouterr().out


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_make_has_a_recipe_for_every_command(script):
    """`make check` did nothing, and said so as if all was well."""
    for name in [*script.commands([]), "test"]:
        command = ["make", "--dry-run", f"--directory={ROOT}", name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert f"course.py {name}" in done.stdout, done.stderr


def test_the_installation_says_each_minute_that_it_goes_on(script, capsys):
    done = mock.Mock(wait=mock.Mock(side_effect=[False, False, True]))
    script.count_minutes(done)
    assert capsys.readouterr().out.splitlines()[-1] == "installing, 2 min so far ..."


def test_nothing_of_the_users_python_leaks_in(script, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/elsewhere")
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")  # else each process compiles its imports
    monkeypatch.setenv("PIP_USER", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", "/wheels")
    monkeypatch.delenv("UV_FIND_LINKS", raising=False)
    environment = script.environment()
    assert not {"PYTHONPATH", "PYTHONDONTWRITEBYTECODE", "PIP_USER"} & set(environment)
    assert environment["UV_FIND_LINKS"] == "/wheels"
    assert environment["PATH"].startswith(str(script.PYTHON.parent))


@pytest.fixture
def outcome(script, monkeypatch):
    """Runs a command whose programs end as told; returns its exit status and the programs."""

    def run(name, **codes):
        seen = []

        def program(*words):
            seen.append(words)
            return next((code for word, code in codes.items() if word in str(words)), 0)

        monkeypatch.setattr(script, "set_up", lambda extras: None)
        monkeypatch.setattr(script, "program", program)
        return script.main([name]), seen

    monkeypatch.setattr(os, "environ", dict(os.environ))
    return run


def test_every_part_runs_and_pytest_last(outcome):
    code, seen = outcome("test")
    assert code == 0
    assert ["pytest" in words for words in seen] == [False] * 4 + [True]
    assert seen[-1][-2:] == ("notebooks", "tests")
    assert os.environ["COTLEARN_FAILED"] == ""
    code, seen = outcome("test", mypy=1, imports=2)
    assert (code, len(seen)) == (2, 5)
    assert os.environ["COTLEARN_FAILED"] == "mypy, lint-imports"


@pytest.mark.parametrize("status", [1, 3, 5, -9])  # failures, a crash, no tests, killed
def test_a_pytest_that_does_not_pass_fails(outcome, status):
    assert outcome("test", pytest=status)[0] == status


def test_other_commands_end_at_the_first_failure(outcome):
    assert outcome("docs", codespell=65) == (65, [("codespell",)])
    assert [words[0] for words in outcome("docs")[1]] == ["codespell", "sphinx-build"]


def test_the_site_is_announced_and_found(script, outcome, capsys, monkeypatch):
    outcome("docs")
    assert f"to read: {script.ROOT / 'build' / 'site' / 'index.html'}" in capsys.readouterr().out
    outcome("docs", sphinx=1)
    assert "to read" not in capsys.readouterr().out
    monkeypatch.undo()
    monkeypatch.setattr(script, "run", lambda *words: 0)
    script.program("sphinx-build", ".")
    assert "building the site" in capsys.readouterr().out


def test_the_closing_line_stays_the_last(tmp_path):
    """A notebook and a test in one run, as `make test` does it, after a failure of lint."""
    nbformat.write(new_notebook(cells=[new_code_cell("1 + 1")]), tmp_path / "00_tiny.ipynb")
    (tmp_path / "test_tiny.py").write_text("def test_it():\n    pass\n")
    conftest = (ROOT / "tests" / "conftest.py").read_text("utf-8")
    (tmp_path / "conftest.py").write_text(conftest)
    command = [sys.executable, "-m", "pytest", "--nbval-lax", "--nbval-current-env"]
    environment = os.environ | {"COTLEARN_FAILED": "lint"}
    options = {"cwd": tmp_path, "env": environment, "capture_output": True, "text": True}
    done = subprocess.run(command, **options, check=False)
    lines = done.stdout.splitlines()
    assert done.returncode == 0, done.stdout
    assert " 2 passed in " in lines[-1]
    assert any(re.match(r"00_tiny\.ipynb +\d+\.\d$", line) for line in lines)
    assert any("FAILED before: lint" in line for line in lines)


def test_a_typo_gets_a_suggestion(script, capsys):
    assert script.main(["tets"]) == 2
    assert capsys.readouterr().out.endswith("got tets; did you mean test?\n")


SLOW_TO_END = """
import pathlib, sys, time
try:
    print("ready", flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    time.sleep(1)
    pathlib.Path(sys.argv[1]).write_text("all is in order")
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="has no groups of processes")
@pytest.mark.parametrize("alone", [True, False])
def test_what_ctrl_c_ends_ends_in_order(tmp_path, alone):
    """It was killed after a quarter of a second, and JupyterLab ran on. `timeout` signals alone."""
    note = tmp_path / "note"
    start = f"import course, sys; course.run(sys.executable, '-c', {SLOW_TO_END!r}, {str(note)!r})"
    with subprocess.Popen(
        [sys.executable, "-c", start],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True,
    ) as process:  # fmt: skip
        assert process.stdout.readline() == b"ready\n"
        signalled = os.kill if alone else os.killpg
        signalled(process.pid, signal.SIGINT)
        assert process.wait(20) != 0
    assert note.read_text() == "all is in order"
