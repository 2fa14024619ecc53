"""The playground as one page: panels, script, style and data in a file that needs no server."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from cotlearn.files import page, write_text
from cotlearn.play import content, replay, stills
from cotlearn.play.packing import pack
from cotlearn.play.script import joined, style_sheet

#: What each panel shows besides `content.common`; made when a page is written.
CONTENT: dict[str, Callable[[], dict[str, Any]]] = {
    "pairs": dict,
    "samples": content.samples,
    "robots": replay.shipped,
    "results": content.results,
}


def write_page(path: str | Path, *, panels: Mapping[str, Any] | None = None) -> Path:
    """Write the page, atomically.

    Args:
        path: the file to make.
        panels: name of a panel -> what it shows; all of the course's if None.

    Returns:
        The path.
    """
    shown = {name: make() for name, make in CONTENT.items()} if panels is None else dict(panels)
    text = page(
        "cotlearn.play",
        panels=tuple(shown),
        stills={name: stills.of_panel(name, value) for name, value in shown.items()},
        data={name: pack(value) for name, value in {"common": content.common(), **shown}.items()},
        script=joined("page"),
        style=style_sheet(),
    )
    write_text(path, text)
    return Path(path)
