"""Opening a notebook in the JupyterLab of `cotlearn lab` and saving it changes nothing."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from ipykernel.ipkernel import IPythonKernel
from ipykernel.kernelspec import get_kernel_dict
from support import until_answered

from cotlearn.course import execution

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
PORT = 8974
OPENED = ("02_couplings", "laboratory/03_skew_on_paper_and_images", "hw1")
SAVE = """async (path) => {
    const context = [...window.jupyterapp.shell.widgets("main")].map(w => w.context)
        .find(context => context && context.path === path);
    await context.ready;
    await context.sessionContext.ready;
    await context.sessionContext.session.kernel.info;
    await new Promise(done => setTimeout(done, 1000));
    await context.save();
}"""


def test_notebooks_are_stored_with_what_jupyterlab_writes():
    kernel, language = get_kernel_dict(), dict(IPythonKernel.language_info)
    language.pop("version")
    spec = {"display_name": kernel["display_name"], "language": "python", "name": "python3"}
    assert {"kernelspec": spec, "language_info": language} == execution.METADATA
    for path in sorted(NOTEBOOKS.rglob("*.ipynb")):
        if path.parent.name == ".ipynb_checkpoints":  # JupyterLab's, of an earlier time
            continue
        text = path.read_text("utf-8")
        notebook = json.loads(text)
        assert notebook["metadata"] | execution.METADATA == notebook["metadata"], path
        lines = json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True) + "\n"
        assert text == lines, f"{path} is not as nbformat writes it"


@pytest.fixture
def lab(tmp_path):
    """`cotlearn lab` with copies that keep their outputs, in a folder of this test."""
    words = ["lab", "--to", str(tmp_path / "mine"), "--with-outputs", "--expose-app-in-browser"]
    words += ["--no-browser", f"--port={PORT}", "--IdentityProvider.token="]
    command = [sys.executable, "-m", "cotlearn", *words, "--ServerApp.port_retries=0"]
    settings = {**os.environ, "JUPYTER_NO_CONFIG": "1", "JUPYTER_CONFIG_DIR": str(tmp_path / "c")}
    server = subprocess.Popen(command, env=settings, stderr=subprocess.DEVNULL)
    try:
        until_answered(server, PORT)
        yield tmp_path / "mine"
    finally:
        server.send_signal(signal.SIGINT)  # as Ctrl-C; it ends JupyterLab
        server.wait()


@pytest.mark.slow
def test_opened_and_saved_they_are_the_same_bytes(lab, browser):
    page = browser.new_page()
    page.set_default_timeout(120_000)
    for name in OPENED:
        copy = lab / f"{name}.ipynb"
        before, when = copy.read_bytes(), copy.stat().st_mtime_ns
        page.goto(f"http://localhost:{PORT}/lab/tree/{name}.ipynb?reset")
        page.locator(".jp-Notebook .jp-Cell").first.wait_for()
        page.evaluate(SAVE, f"{name}.ipynb")
        assert copy.stat().st_mtime_ns > when, "it was not saved"
        assert copy.read_bytes() == before, name
    page.close()
