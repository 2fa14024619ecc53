import os
import re
import sys
import time
from types import SimpleNamespace

import pytest

from cotlearn import progress
from cotlearn.progress import SWITCH, progress_bar


@pytest.fixture(autouse=True)
def _nobody_decided(monkeypatch):
    monkeypatch.delenv(SWITCH, raising=False)
    monkeypatch.delenv("CI", raising=False)


def shown(**options):
    with progress_bar(total=3, what="work", **options) as bar:
        bar.update()
        bar.set_postfix(loss="1.0", refresh=False)
        return not bar.disable


def watching(monkeypatch, yes):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: yes, raising=False)


def test_silent_for_a_minute_when_nobody_watches(monkeypatch, capsys):
    watching(monkeypatch, False)
    shown()
    assert capsys.readouterr().err == ""


def test_then_a_line_now_and_then(monkeypatch, capsys):
    watching(monkeypatch, False)
    monkeypatch.setattr(progress, "LINE_EVERY", 0.01)
    with progress_bar(total=4, what="work") as bar:
        for step in range(4):
            bar.set_postfix(loss=f"{step}.5", refresh=False)
            time.sleep(0.02)
            bar.update()
    lines = [line for line in re.split("[\r\n]+", capsys.readouterr().err) if line]
    assert lines[0].startswith("work: 1 of 4, 00:00 so far")
    assert "loss=0.5" in lines[0]
    assert len(lines) >= 3


def test_on_in_a_terminal(monkeypatch):
    watching(monkeypatch, True)
    assert shown()


def test_a_terminal_that_does_not_know_its_width_has_a_bar(monkeypatch):
    pty = pytest.importorskip("pty")
    master, slave = pty.openpty()
    with open(slave, "w") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        assert shown()
    assert b"work:" in os.read(master, 1000)


@pytest.mark.parametrize(("switch", "expected"), [("0", False), ("1", True)])
@pytest.mark.parametrize("terminal", [True, False])
def test_the_switch_decides(monkeypatch, switch, expected, terminal):
    watching(monkeypatch, terminal)
    monkeypatch.setenv(SWITCH, switch)
    assert shown() is expected


@pytest.mark.parametrize("show", [True, False])
def test_the_argument_decides_before_the_switch(monkeypatch, show):
    monkeypatch.setenv(SWITCH, "0" if show else "1")
    assert shown(show=show) is show


def test_on_in_a_notebook_but_not_because_a_kernel_is_merely_installed(monkeypatch):
    watching(monkeypatch, False)
    monkeypatch.setitem(sys.modules, "ipykernel", SimpleNamespace())
    shell = None
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    assert shown()  # lines, after a minute
    shell = SimpleNamespace(kernel=object())
    assert shown()
    monkeypatch.setenv("CI", "1")
    assert not shown()


def test_a_bar_goes_on_where_it_was():
    with progress_bar(total=10, initial=4, show=False) as bar:
        assert (bar.n, bar.total) == (4, 10)


def test_in_a_notebook_it_is_text_beside_what_is_printed(monkeypatch, capsys):
    """A widget's place said "model not found" when the file was opened again; stderr is red."""
    watching(monkeypatch, False)
    shell = SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    assert shown()
    said = capsys.readouterr()
    assert "work:" in said.out
    assert said.err == ""
