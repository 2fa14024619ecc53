"""Makes slides from the stored notebooks: what `make slides` runs.

    python docs/slides.py           # all, into build/slides
    python docs/slides.py 03 04     # some

A heading starts a new slide, and what no longer fits on the screen one below it. Code and its
outputs are separate; folded code, checks and solutions are left out, and exercises keep their
stub. `jupyter nbconvert --to slides` does the rest. When they
are shown the pages load reveal.js, require.js and, for formulas, MathJax from the network;
`--reveal` names another place for the first of them.
"""

import argparse
import logging
import math
import sys
from html import escape
from pathlib import Path

import nbformat
from nbconvert.exporters import SlidesExporter
from nbconvert.preprocessors import TagRemovePreprocessor

from cotlearn.assets import all_notebooks, find_notebook

OUT = Path(__file__).resolve().parents[1] / "build" / "slides"
NO_ALT = "No description has been provided for this image"  #: nbconvert's words
SCREEN = 18.3  #: lines of text that fit on a slide
WIDTH = 84  #: characters of a line
CODE, PRINTED = 0.75, 1.1  #: heights of a line of code and of an output, in lines of text
TITLE, HEADING = 8.0, 2.5
ROW = 1.1  #: of a row of a table
STYLE = """<style>
.reveal .jp-OutputArea-output img { max-height: 560px; width: auto; margin: 0; }
.reveal .jp-OutputArea-output pre { font-size: 12px; line-height: 1.25; }
.reveal .jp-OutputArea-output table { font-size: 12px; }
.reveal .jp-OutputArea-output td, .reveal .jp-OutputArea-output th { padding: 2px 8px; }
</style></head>"""


def height_of(cell: nbformat.NotebookNode) -> float:
    """Estimate the height of a cell on a slide, in lines of text."""
    if cell.cell_type == "markdown":
        return 0.5 + sum(height_of_line(line) for line in cell.source.splitlines())
    found = 0.0
    if "output-only" not in cell.metadata.get("tags", []):
        found += 1 + CODE * len(cell.source.splitlines())
    for output in cell.get("outputs", []):
        data = output.get("data", {})
        if "image/png" in data or ("text/html" in data and "<table" not in data["text/html"]):
            return SCREEN
        if "text/html" in data:
            found += 1 + ROW * data["text/html"].count("<tr")
        else:
            text = output.get("text", "") or data.get("text/plain", "")
            found += 1 + PRINTED * len(text.splitlines())
    return found


def height_of_line(line: str) -> float:
    """Estimate the height of a line of Markdown, in lines of text."""
    if line.startswith("|"):
        return ROW * math.ceil(len(line) / (1.4 * WIDTH))
    if not line.strip():
        return 0.5
    if line.startswith("#"):
        return TITLE if line.startswith("# ") else HEADING
    return math.ceil(len(line) / WIDTH)


def kind_of(cell: nbformat.NotebookNode, room: float) -> str:
    """Return what a cell is to the slides: "slide", "subslide", "-" (goes on) or "skip".

    Args:
        cell: a piece of a notebook, see `pieces_of`.
        room: lines that still fit on the slide before it.
    """
    if "check" in cell.metadata.get("tags", []) or cell.source.startswith("<details>"):
        return "skip"
    if cell.cell_type == "markdown" and cell.source.startswith(("# ", "## ")):
        return "slide"
    if cell.cell_type == "markdown" and cell.source.startswith("### "):
        return "subslide"
    return "-" if height_of(cell) <= room else "subslide"


def as_slides(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Return a copy of a notebook in pieces, each of which says what it is to the slides."""
    result = nbformat.from_dict({**notebook, "cells": []})
    room = 0.0
    for cell in split_at_headings(notebook).cells:
        for piece in pieces_of(cell):
            kind = kind_of(piece, room)
            piece.metadata["slideshow"] = {"slide_type": kind}
            if kind != "skip":
                room = (room if kind == "-" else SCREEN) - height_of(piece)
            result.cells.append(piece)
    return result


def pieces_of(cell: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    """Return what can stand on different slides: paragraphs of a long text, code, each output."""
    tags = cell.metadata.get("tags", [])
    if cell.cell_type == "markdown":
        if height_of(cell) <= SCREEN or cell.source.startswith("<details>"):
            return [cell]
        paragraphs = paragraphs_of(cell.source)
        return [nbformat.v4.new_markdown_cell(paragraph) for paragraph in paragraphs]
    if cell.cell_type != "code" or "check" in tags:
        return [cell]
    alt = {"alt": cell.metadata["alt"]} if "alt" in cell.metadata else {}
    shown = nbformat.v4.new_code_cell(cell.source, metadata={"tags": tags})
    parts = [] if "hide-input" in tags else [shown]
    about = {"tags": [*tags, "output-only"], **alt}
    for output in (part for whole in cell.outputs for part in parts_of(whole)):
        parts.append(nbformat.v4.new_code_cell("", metadata=about, outputs=[output]))
    return parts


def parts_of(output: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    """Return an output; a printed text that is higher than the screen in several."""
    lines = output.get("text", "").splitlines(keepends=True)
    most = int(SCREEN / PRINTED) - 1
    parts = [lines[k : k + most] for k in range(0, len(lines), most)]
    if len(parts) < 2:
        return [output]
    return [nbformat.from_dict({**output, "text": "".join(part)}) for part in parts]


def paragraphs_of(text: str) -> list[str]:
    """Return the paragraphs of a text and the points of its lists; fenced code stays together."""
    found = [""]
    fenced = False
    for line in text.splitlines():
        if not fenced and (not line.strip() or line.startswith("- ")):
            found.append("")
        found[-1] += f"{line}\n"
        fenced ^= line.startswith("```")
    return [paragraph.strip() for paragraph in found if paragraph.strip()]


def split_at_headings(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Return a copy in which each heading begins a cell of its own."""
    result = nbformat.from_dict({**notebook, "cells": []})
    for cell in notebook.cells:
        if cell.cell_type != "markdown" or cell.source.startswith("<details>"):
            result.cells.append(nbformat.from_dict(cell))
            continue
        parts: list[list[str]] = [[]]
        fenced = False
        for line in cell.source.splitlines():
            fenced ^= line.startswith("```")
            if line.startswith("#") and not fenced and parts[-1]:
                parts.append([])
            parts[-1].append(line)
        for part in parts:
            result.cells.append(nbformat.v4.new_markdown_cell("\n".join(part).strip()))
    return result


def with_alts(page: str, notebook: nbformat.NotebookNode) -> str:
    """Return the page with the text of its cell in every picture that nbconvert left without."""
    shown = [c for c in notebook.cells if c.metadata["slideshow"]["slide_type"] != "skip"]
    alts = [
        escape(cell.metadata.get("alt", ""))
        for cell in shown
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {}) and "text/html" not in output["data"]
    ]
    pieces = page.split(f'alt="{NO_ALT}"')
    if len(pieces) != len(alts) + 1:
        raise RuntimeError(f"{len(pieces) - 1} pictures without a text, {len(alts)} texts")
    return "".join(a + b for a, b in zip([""] + [f'alt="{a}"' for a in alts], pieces, strict=True))


def main(arguments: list[str] | None = None) -> int:
    """Write one page of slides a notebook."""
    parser = argparse.ArgumentParser(description="Make slides from the notebooks.")
    parser.add_argument("notebook", nargs="*", help="a number or a name; all if none is given")
    parser.add_argument("--reveal", help="another folder or address of reveal.js")
    options = parser.parse_args(arguments)
    OUT.mkdir(parents=True, exist_ok=True)
    logging.getLogger("traitlets").setLevel(logging.ERROR)  # the texts come below
    exporter = SlidesExporter(reveal_scroll=True)
    hidden = {"enabled": True, "remove_input_tags": {"output-only"}}
    exporter.register_preprocessor(TagRemovePreprocessor(**hidden), enabled=True)
    if options.reveal:
        exporter.reveal_url_prefix = options.reveal
    for path in [find_notebook(n) for n in options.notebook] or all_notebooks():
        slides = as_slides(nbformat.read(path, as_version=4))
        page = with_alts(exporter.from_notebook_node(slides)[0], slides)
        page = page.replace("</head>", STYLE, 1)
        (OUT / f"{path.stem}.slides.html").write_text(page, encoding="utf-8")
        print(OUT / f"{path.stem}.slides.html")
    return 0


if __name__ == "__main__":
    sys.exit(main())
