"""Marks figures of notebooks that are too wide for a phone, so that they scroll there.

A row of panels that is shrunk to a phone's width has words of four pixels. The class `wide` lets
the style sheet keep it at a size that can be read.
"""

import struct
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

WIDE = 600  #: pixels; charts of one panel have fewer


def png_width(path: Path) -> int:
    """Return the width in pixels that the header of a PNG tells; 0 for other files."""
    with path.open("rb") as file:
        header = file.read(24)
    if not header.startswith(b"\x89PNG"):
        return 0
    (width,) = struct.unpack(">I", header[16:20])
    return int(width)


class WideFigures(SphinxTransform):
    """Gives the class to images in the outputs of code cells."""

    default_priority = 310

    def apply(self) -> None:
        """Look at every code cell of this document."""
        for cell in self.document.findall(nodes.container):
            if cell.get("nb_element") == "cell_code":
                for image in cell.findall(nodes.image):
                    path = Path(self.env.relfn2path(image["uri"])[1])
                    if path.is_file() and png_width(path) > WIDE:
                        image["classes"].append("wide")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the transform."""
    app.add_transform(WideFigures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
