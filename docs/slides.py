"""Tells nbconvert what is a slide: `jupyter nbconvert --to slides --config docs/slides.py`.

A heading starts a slide, and a figure has one below it; checks, folded solutions and folded code
are left out. When they are shown, the slides load reveal.js from the network.
"""

from html import escape

import nbformat
from nbconvert.preprocessors import Preprocessor


class Slides(Preprocessor):
    """Marks what each cell is to the slides."""

    def preprocess_cell(
        self, cell: nbformat.NotebookNode, resources: dict[str, object], index: int
    ) -> tuple[nbformat.NotebookNode, dict[str, object]]:
        """Mark one cell, and give its figures the text of the cell."""
        cell.metadata["slideshow"] = {"slide_type": kind_of(cell)}
        text = escape(cell.metadata.get("alt", ""))
        for output in cell.get("outputs", []):
            picture = output.get("data", {}).get("image/png")
            if picture:  # nbconvert's own template has no place for a text
                source = f"data:image/png;base64,{picture}"
                output.data = {"text/html": f'<img alt="{text}" src="{source}">'}
        return cell, resources


def kind_of(cell: nbformat.NotebookNode) -> str:
    """Return what a cell is, in nbconvert's words."""
    if "check" in cell.metadata.get("tags", []) or cell.source.startswith("<details>"):
        return "skip"
    if cell.source.startswith(("# ", "## ")):
        return "slide"
    if cell.source.startswith("### ") or "alt" in cell.metadata:
        return "subslide"
    return "-"


if "get_config" in globals():  # nbconvert reads this file, and does not import it
    config = globals()["get_config"]()
    config.SlidesExporter.preprocessors = [Slides]
    config.SlidesExporter.reveal_scroll = True
    config.TagRemovePreprocessor.enabled = True
    config.TagRemovePreprocessor.remove_input_tags = {"hide-input"}
