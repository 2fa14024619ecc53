"""Gives every figure of a notebook the text of its cell: the metadata {"alt": "..."}."""

import re
from html import escape

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

IMAGE = re.compile(r"<img\b(?P<attributes>[^>]*)>")
ALT = re.compile(r"""\s*\balt=("[^"]*"|'[^']*')""")


def with_alt(html: str, alt: str) -> str:
    """Return HTML in which every image has the text `alt`, in place of any that it had."""

    def change(match: re.Match[str]) -> str:
        attributes = ALT.sub("", match["attributes"]).strip()
        return f'<img alt="{escape(alt)}" {attributes}>'

    return IMAGE.sub(change, html)


class AlternativeText(SphinxTransform):
    """Writes the text of a cell into the images of its outputs."""

    default_priority = 300

    def apply(self) -> None:
        """Look at every code cell of this document."""
        for cell in self.document.findall(nodes.container):
            if cell.get("nb_element") != "cell_code":
                continue
            alt = cell.get("cell_metadata", {}).get("alt")
            if not alt:
                continue
            for image in cell.findall(nodes.image):
                image["alt"] = alt
            for raw in cell.findall(nodes.raw):
                if "<img" in raw.astext():
                    changed = with_alt(raw.astext(), alt)
                    raw.children = [nodes.Text(changed)]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the transform."""
    app.add_transform(AlternativeText)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
