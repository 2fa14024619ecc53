"""In a real JupyterLab: an episode that a script steers by mouse is recorded, and replays."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from support import until_answered

from cotlearn.robots.episodes import read
from cotlearn.robots.push_t import PushTExpert, Simulation, coverage, random_state
from cotlearn.robots.push_t.constants import SIZE, SUCCESS

pytestmark = pytest.mark.slow
PORT = 8973
SEED = 110  # of a short push
AT_ONCE = 12  #: steps that the planner's hand takes before it looks again
EDGE = 2  #: pixels around the world in the picture
CELL = f"from cotlearn.play.widgets import hands\nhands('mine.npz', seed={SEED})"


@pytest.fixture
def lab(tmp_path):
    """A JupyterLab in a folder with one notebook; returns its address."""
    cell = {"cell_type": "code", "execution_count": None, "id": "a", "metadata": {}, "outputs": []}
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook = {"cells": [{**cell, "source": CELL}], "metadata": {"kernelspec": kernel}}
    text = json.dumps({**notebook, "nbformat": 4, "nbformat_minor": 5})
    (tmp_path / "hands.ipynb").write_text(text)
    command = [sys.executable, "-m", "jupyterlab", "--no-browser", f"--port={PORT}"]
    command += ["--IdentityProvider.token=", "--allow-root", f"--ServerApp.root_dir={tmp_path}"]
    with (tmp_path / "log.txt").open("w") as log:
        server = subprocess.Popen(
            command,
            cwd=tmp_path,
            stdout=log,
            stderr=log,
            env={**os.environ, "JUPYTER_NO_CONFIG": "1"},
        )
        try:
            until_answered(server, PORT)
            yield f"http://localhost:{PORT}/lab/tree/hands.ipynb"
        finally:
            server.terminate()
            server.wait()


def test_a_hand_in_jupyterlab_records_an_episode(lab, browser, tmp_path):
    page = browser.new_page(viewport={"width": 1200, "height": 1000})
    page.set_default_timeout(120_000)
    page.goto(lab)
    page.locator(".jp-Notebook").wait_for()
    page.locator(".jp-Notebook .jp-Cell").first.click()
    page.wait_for_function("document.body.innerText.includes('Python 3')")
    panel, canvas = page.locator(".cotlearn-play .panel"), page.locator(".cotlearn-play canvas")
    for look in range(120):  # until the kernel listens
        if look % 6 == 0:
            page.keyboard.press("Control+Enter")
        page.wait_for_timeout(500)
        if canvas.count():
            break
    steer(page, panel, canvas)
    page.locator(".cotlearn-play .sentence", has_text="Recorded after").wait_for()
    page.mouse.move(600, 600)  # still held down
    page.wait_for_timeout(500)
    assert panel.get_attribute("data-step") == "0", "a held pointer pushes in the next start"
    page.mouse.up()
    push_and_reload(page, panel, canvas)
    assert page.evaluate(RESTART) == 200
    canvas.focus()
    page.keyboard.press("ArrowRight")
    answer = "Python does not answer"
    page.locator(".cotlearn-play .sentence", has_text=answer).wait_for(timeout=20_000)
    page.close()
    episodes = read(tmp_path / "mine.npz")
    assert (len(episodes), episodes.seed.tolist()) == (1, [SEED])
    again = Simulation(random_state(np.random.default_rng(SEED)))
    for action in episodes.action:
        assert coverage(again.state[2:]) <= SUCCESS
        again.step(*action)
    assert coverage(again.state[2:]) > SUCCESS


def push_and_reload(page, panel, canvas):
    """A page that is loaded again in the middle of an episode goes on with it."""
    canvas.focus()
    for step in range(1, 4):
        page.keyboard.press("ArrowRight")
        page.locator(f".cotlearn-play .panel[data-step='{step}']").wait_for()
    state = panel.get_attribute("data-state")
    page.keyboard.press("Control+s")
    page.wait_for_timeout(1000)
    page.reload()
    page.locator(".cotlearn-play .panel[data-step='3']").wait_for()
    assert panel.get_attribute("data-state") == state
    canvas.focus()
    page.keyboard.press("ArrowRight")
    page.locator(".cotlearn-play .panel[data-step='4']").wait_for()


STEPPED = """(step) => {
  const { dataset } = document.querySelector(".cotlearn-play .panel");
  return dataset.step !== step || dataset.recorded === "1";
}"""
RESTART = """async () => {
  const [kernel] = await (await fetch("/api/kernels")).json();
  const headers = { "X-XSRFToken": document.cookie.match(/_xsrf=([^;]*)/)[1] };
  const answer = await fetch(`/api/kernels/${kernel.id}/restart`, { method: "POST", headers });
  return answer.status;
}"""


def steer(page, panel, canvas):
    """Moves the pointer as the planner would, from what the panel shows, until it is recorded."""
    expert = PushTExpert()
    box = canvas.bounding_box()
    scale = (box["width"] - 2 * EDGE) / SIZE

    def seen(name):
        return panel.get_attribute(f"data-{name}")

    def point(action):
        page.mouse.move(*(box[k] + EDGE + scale * v for k, v in zip("xy", action, strict=True)))

    held = False
    for look in range(60):
        state = [float(value) for value in seen("state").split(",")]
        for action in expert.episode(look, state=state).intention[:AT_ONCE]:
            point(action)
            if not held:
                page.mouse.down()
                held = True
            step = seen("step")
            page.wait_for_function(STEPPED, arg=step)
            if seen("recorded") == "1":
                page.mouse.up()
                return
    pytest.fail("the T did not reach the goal")
