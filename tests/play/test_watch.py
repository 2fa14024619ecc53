"""`cotlearn watch` shows a policy on a page or in a GIF, and names what it cannot show."""

import io
import shutil

import pytest
from PIL import Image
from typer.testing import CliRunner

from cotlearn.cli import app
from cotlearn.course.assets import find_data
from cotlearn.interrupt import loading

RING = find_data("weights/arm_ring_residual.safetensors")


def run(*words):
    return CliRunner().invoke(app, ["watch", *map(str, words)])


@pytest.mark.slow
def test_a_page_and_a_film_of_a_policy(tmp_path):
    page, gif = tmp_path / "watch.html", tmp_path / "watch.gif"
    done = run("arm-ring", "--policy", RING, "--episodes", 1, "--out", page)
    assert done.exit_code == 0, done.output
    assert "arm_ring_residual: " in done.output
    html = page.read_text("utf-8")
    assert 'id="data-robots"' in html
    assert 'id="data-samples"' not in html
    assert run("arm-ring", "--policy", RING, "--episodes", 1, "--out", gif).exit_code == 0
    assert Image.open(io.BytesIO(gif.read_bytes())).n_frames > 20


@pytest.mark.slow
def test_two_files_of_one_name_are_both_shown(tmp_path):
    other = tmp_path / RING.name
    shutil.copy(RING, other)
    words = ("--policy", RING, "--policy", other, "--episodes", 1, "--out", tmp_path / "a.html")
    shown = "".join(run("arm-ring", *words).output.split())
    assert f"{other}:" in shown
    assert f"{RING}:" in shown


@pytest.mark.slow
def test_a_terminal_shows_that_policies_are_rolled_out(tmp_path, monkeypatch):
    monkeypatch.setenv("COTLEARN_PROGRESS", "1")
    done = run("arm-ring", "--policy", RING, "--episodes", 1, "--out", tmp_path / "a.html")
    assert "rollout" in done.stderr


def test_a_terminal_says_that_a_command_loads(monkeypatch, capsys):
    with loading():
        pass
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with loading():
        assert capsys.readouterr().err == "loading\r"
    assert capsys.readouterr().err == " " * len("loading") + "\r"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("push-t", "--policy", RING), "must be of the task push-t, got one of arm-ring"),
        (("arm-avoid", "--policy", RING), "task must be one of push-t, arm-ring"),
        (("arm-ring", "--policy", "none.safetensors"), "no such file"),
        (("arm-ring", "--policy", RING, "--out", "film.mov"), "suffix of out"),
    ],
)
def test_what_cannot_be_shown_is_named(words, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run(*words)
    assert done.exit_code == 2
    assert said in " ".join(done.output.split())
    assert list(tmp_path.iterdir()) == []
