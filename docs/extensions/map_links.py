"""Makes the rooms of the course's map links: they lie over the picture, which stays a picture."""

import sys
from html import escape
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "figures"))

import course_map  # noqa: E402


def page_of(room: str) -> str:
    """The page that a room leads to: a notebook, or the first of a folder."""
    pattern = f"{room}_*.ipynb" if room.isdigit() else f"{room}/*.ipynb"
    first = min((ROOT / "notebooks").glob(pattern))
    return first.relative_to(ROOT).with_suffix("").as_posix()


def link(app: Sphinx, doctree: nodes.document, page: str) -> None:
    """Put links over each picture of the map on this page."""
    if app.builder.format != "html":
        return
    for image in list(doctree.findall(nodes.image)):
        if not image["uri"].endswith("course_map.svg"):
            continue
        html = ""
        for room, (left, top, width, height) in course_map.boxes().items():
            target = app.builder.get_relative_uri(page, page_of(room))
            place = f"left:{left:.2%};top:{top:.2%};width:{width:.2%};height:{height:.2%}"
            name = escape(f"{room} {course_map.titles()[room]}")
            html += f'<a href="{escape(target)}" style="{place}" aria-label="{name}"></a>'
        parts = (nodes.raw("", '<span class="map">', format="html"), image.deepcopy())
        image.parent.replace(image, [*parts, nodes.raw("", f"{html}</span>", format="html")])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the handler."""
    app.connect("doctree-resolved", link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
