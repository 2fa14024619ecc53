"""The panels in a notebook, with anywidget; and `Hands`, which needs the Python behind it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import anywidget
import traitlets
from IPython import get_ipython

from cotlearn.play import content, page, replay
from cotlearn.play.packing import pack
from cotlearn.play.recorder import Recorder
from cotlearn.play.script import joined, style_sheet
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import EXPLORATION
from cotlearn.validation import check_choice, check_count


class Panel(anywidget.AnyWidget):
    """One panel in a notebook's cell.

    Args:
        name: "pairs", "samples", "robots" or "results".
        shown: what it shows; the course's own if None.
    """

    _esm = f"{joined('widget')}export default {{ render: cotlearn_play.widget.render }};\n"
    _css = style_sheet()
    name = traitlets.Unicode().tag(sync=True)
    data = traitlets.Unicode().tag(sync=True)

    def __init__(self, name: str, shown: Mapping[str, Any] | None = None) -> None:
        known = (*page.CONTENT, "hands")
        own = page.CONTENT[check_choice(name, "name", known)]() if shown is None else shown
        super().__init__(name=name, data=pack({**content.common(), **own}))


def watch(policies: Mapping[str, ChunkPolicy], *, nfe: int = 1, episodes: int = 3) -> Panel:
    """Replays of several policies of a task, side by side, from the same starts.

    Args:
        policies: title -> policy, all of Push-T or all of the arm with one pillar.
        nfe: evaluations for each decision.
        episodes: number of starts.

    Raises:
        ValueError: there is no policy, or they are of other tasks.
    """
    if not policies:
        raise ValueError("policies must hold at least one, got none")
    check_count(episodes, "episodes")
    name = replay.drawable(next(iter(policies.values())).windows.task)
    starts = range(EXPLORATION, EXPLORATION + episodes)
    return Panel("robots", {"tasks": {name: replay.compare(name, policies, [nfe], starts)}})


class Hands(Panel):
    """Push the T yourself; each episode that reaches the goal is recorded.

    Hold the pointer down, or use the arrow keys, and the round agent follows. Time stands still
    while you do not push. What goes wrong with the file is said in the panel.

    Args:
        path: an `.npz` file, written after each episode; an existing recording is continued.
        seed: of the first start.

    Raises:
        ValueError: the file is damaged or holds another recording.
    """

    view = traitlets.Dict().tag(sync=True)

    def __init__(self, path: str | Path, *, seed: int = 0) -> None:
        self.recorder = Recorder(path, seed=seed)
        super().__init__("hands", {"scene": replay.scene("push-t")})
        self.on_msg(self._heard)
        self._turn = 0
        self.view = self.recorder.view

    def _heard(self, _: Any, message: dict[str, Any], __: Any) -> None:
        """Do what the browser asks for; nothing in a message names a file."""
        problem = ""
        try:
            if message.get("do") == "step":
                self.recorder.step(float(message["x"]), float(message["y"]))
            elif message.get("do") == "undo":
                self.recorder.undo()
        except (OSError, ValueError) as error:
            problem = f"Not written: {error}"
        self._turn += 1  # an answer that is like the last one arrives too
        self.view = {**self.recorder.view, "problem": problem, "turn": self._turn}


def hands(path: str | Path, *, seed: int = 0) -> Hands | None:
    """`Hands` where somebody runs the cells, and nothing where a program does.

    A program (nbclient, nbval) does not let a cell ask for input.
    """
    kernel = getattr(get_ipython(), "kernel", None)
    request = kernel.get_parent("shell").get("content", {}) if kernel else {}
    return Hands(path, seed=seed) if request.get("allow_stdin") else None
