import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_notebook

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def script(tmp_path):
    """course.py, as if it lay in an empty checkout in a folder with a space."""
    spec = importlib.util.spec_from_file_location("course_script", ROOT / "course.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    root = tmp_path / "a checkout"
    root.mkdir()
    (root / "pyproject.toml").write_text("[project]\n")
    (root / "constraints.txt").write_text("numpy==2\n")
    module.ROOT, module.VENV, module.BUILD = root, root / ".venv", root / "build"
    module.STAMP, module.UNFINISHED = module.VENV / "stamp.json", module.VENV / "unfinished"
    return module


@pytest.fixture
def installs(script, monkeypatch):
    """Replaces the slow steps of the set-up and records that they were taken."""
    steps = []

    def create(base):
        steps.append("create")
        if script.VENV.exists():
            script.remove(script.VENV)
        script.VENV.mkdir()

    monkeypatch.setattr(script, "create", create)
    monkeypatch.setattr(script, "install", lambda python: steps.append("install"))
    monkeypatch.setattr(script, "is_whole", lambda python: True)
    monkeypatch.setattr(script, "can_run", lambda python, code: script.VENV.exists())
    monkeypatch.setattr(script, "require_venv_module", lambda python: None)
    monkeypatch.setattr(script, "check_disk", lambda free: None)
    return steps


def test_the_second_run_installs_nothing(script, installs):
    script.set_up()
    script.set_up()
    assert installs == ["create", "install"]


@pytest.mark.parametrize("name", ["pyproject.toml", "constraints.txt"])
def test_a_changed_file_installs_again_in_place(script, installs, name):
    script.set_up()
    (script.ROOT / name).write_text("changed")
    script.set_up()
    assert installs == ["create", "install", "install"]


def test_line_ends_of_windows_are_no_change(script):
    before = script.fingerprint()
    (script.ROOT / "constraints.txt").write_bytes(b"numpy==2\r\n")
    assert script.fingerprint() == before


def test_an_interrupted_set_up_is_taken_up_again(script, installs, monkeypatch):
    def interrupt(python):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(script, "install", interrupt)
        assert script.main(["setup"]) == 130
    assert not script.STAMP.exists()
    assert script.main(["setup"]) == 0
    assert installs == ["create", "install"]


def test_a_half_made_environment_is_built_anew(script, installs):
    script.VENV.mkdir()
    script.UNFINISHED.touch()
    script.set_up()
    assert installs == ["create", "install"]
    assert not script.UNFINISHED.exists()


def test_a_damaged_environment_is_repaired(script, installs, monkeypatch):
    script.set_up()
    answers = iter([False, False, True])  # when looked at, after an installation, after a rebuild
    monkeypatch.setattr(script, "is_whole", lambda python: next(answers))
    script.set_up()
    assert installs == ["create", "install", "install", "create", "install"]


@pytest.mark.parametrize("content", ["", "{", '{"fingerprint": "of something else"}', "[]"])
def test_a_damaged_stamp_counts_for_nothing(script, installs, content):
    script.set_up()
    script.STAMP.write_text(content)
    assert not script.is_ready(script.venv_python())


def test_a_failed_installation_says_so(script, monkeypatch, capsys):
    monkeypatch.setattr(script.subprocess, "call", lambda *args, **kwargs: 1)
    with pytest.raises(script.Problem, match="Is the network reachable"):
        script.install(Path("python"))


def test_an_unsupported_python_looks_for_another(script, monkeypatch):
    monkeypatch.setattr(script.sys, "version_info", (3, 14, 0))
    monkeypatch.setattr(script.shutil, "which", lambda name: None)
    with pytest.raises(script.Problem, match=r"needs Python 3\.11 to 3\.13"):
        script.find_python()
    monkeypatch.setattr(script.shutil, "which", lambda name: f"/bin/{name}")
    monkeypatch.setattr(script, "can_run", lambda python, code: "3.12" in str(python))
    assert script.find_python() == "/bin/python3.12"


def test_a_missing_venv_module_names_the_package(script, monkeypatch):
    monkeypatch.setattr(script, "can_run", lambda python, code: False)
    major, minor = sys.version_info[:2]
    with pytest.raises(script.Problem, match=rf"sudo apt install python{major}\.{minor}-venv"):
        script.require_venv_module(sys.executable)


def test_disk_and_download(script, monkeypatch, capsys):
    with pytest.raises(script.Problem, match=r"Only 0\.5 GB are free"):
        script.check_disk(0.5)
    monkeypatch.setattr(script.sys, "platform", "linux")
    script.check_disk(5.0)
    assert "torch with CUDA would need" in capsys.readouterr().out
    script.announce_download(False)
    printed = capsys.readouterr().out
    assert "GB to download" in printed
    assert "PyTorch's page 'Start Locally'" in printed
    script.announce_download(True)
    assert "CUDA" not in capsys.readouterr().out


def test_a_problem_ends_without_a_traceback(script, monkeypatch, capsys):

    def fail():
        raise script.Problem("fix this")

    monkeypatch.setattr(script, "set_up", fail)
    assert script.main(["lab"]) == 1
    assert "fix this" in capsys.readouterr().err


def test_unknown_command_and_help(script, capsys):
    assert script.main(["lap"]) == 2
    assert "there are: lab, test, course" in capsys.readouterr().err
    assert script.main([]) == 0
    assert "python course.py lab" in capsys.readouterr().out


def test_nothing_of_the_users_python_leaks_in(script, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/elsewhere")
    monkeypatch.setenv("PYTHONWARNINGS", "error")
    monkeypatch.setenv("PIP_USER", "1")
    environment = script.child_environment(EXTRA="1")
    assert not {"PYTHONPATH", "PYTHONWARNINGS"} & set(environment)
    assert environment["PIP_USER"] == "0"
    assert environment["EXTRA"] == "1"


@pytest.fixture
def outcome(script, monkeypatch):
    """Runs `test` with commands that end as told; returns its exit status and the commands."""

    def run(**codes):
        seen = []

        def call(command, **environment):
            seen.append((command, environment))
            return next((code for word, code in codes.items() if word in str(command)), 0)

        monkeypatch.setattr(script, "call", call)
        return script.test(Path("python"), []), seen

    return run


def test_all_parts_pass_and_pytest_runs_once_and_last(outcome):
    code, seen = outcome()
    assert code == 0
    assert ["pytest" in command for command, _ in seen] == [False] * 4 + [True]
    command, environment = seen[-1]
    assert command[-2:] == ["notebooks", "tests"]
    assert environment["COTLEARN_FAILED"] == ""
    assert environment["COTLEARN_PROGRESS"] == "0"
    assert environment["OMP_NUM_THREADS"] == "1"


def test_every_part_runs_though_one_failed(outcome):
    code, seen = outcome(mypy=1, imports=2)
    assert code == 1
    assert len(seen) == 5
    assert seen[-1][1]["COTLEARN_FAILED"] == "types, import rules"


@pytest.mark.parametrize("status", [1, 3, 5, -9])  # failures, a crash, no tests, killed
def test_a_pytest_that_does_not_pass_fails(outcome, status):
    assert outcome(pytest=status)[0] == 1


def test_an_interruption_ends_it_at_once(outcome):
    code, seen = outcome(mypy=130)
    assert (code, len(seen)) == (130, 3)
    assert outcome(pytest=130)[0] == 130


def test_the_closing_line_stays_the_last(tmp_path):
    """A notebook and a test in one run, as `make test` does it, after a failure of lint."""
    nbformat.write(new_notebook(cells=[new_code_cell("1 + 1")]), tmp_path / "00_tiny.ipynb")
    (tmp_path / "test_tiny.py").write_text("def test_it():\n    pass\n")
    conftest = (ROOT / "tests" / "conftest.py").read_text("utf-8")
    (tmp_path / "conftest.py").write_text(conftest)
    # nbval imports jsonschema, which builds grammars with this package, and takes 2 s for it
    start = "import sys; sys.modules['rfc3987_syntax'] = None; import pytest; "
    start += "sys.exit(pytest.main())"
    command = [sys.executable, "-c", start, "--nbval-lax", "--nbval-current-env"]
    environment = os.environ | {"COTLEARN_FAILED": "lint"}
    options = {"cwd": tmp_path, "env": environment, "capture_output": True, "text": True}
    done = subprocess.run(command, **options, check=False)
    lines = done.stdout.splitlines()
    assert done.returncode == 0, done.stdout
    assert " 2 passed in " in lines[-1]
    assert any(re.match(r"00_tiny\.ipynb +\d+\.\d$", line) for line in lines)
    assert any("FAILED before: lint" in line for line in lines)


def test_the_real_stamp_is_plain_json(script, installs):
    script.set_up()
    assert json.loads(script.STAMP.read_text()) == {"fingerprint": script.fingerprint()}
