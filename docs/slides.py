"""Makes slides from the stored notebooks: what `make slides` runs.

    python docs/slides.py           # all, into build/slides
    python docs/slides.py 03 04     # some

A heading starts a new slide, a figure or a long text one below it. Exercises keep their stub;
checks and folded solutions are left out. `jupyter nbconvert --to slides` does the rest. When they
are shown the pages load reveal.js, require.js and, for formulas, MathJax from the network;
`--reveal` names another place for the first of them.
"""

import argparse
import logging
import sys
from html import escape
from pathlib import Path

import nbformat
from nbconvert.exporters import SlidesExporter

from cotlearn.assets import all_notebooks, find_notebook

OUT = Path(__file__).resolve().parents[1] / "build" / "slides"
NO_ALT = "No description has been provided for this image"  #: nbconvert's words
LONG = 700  #: characters of text that fill a slide


def kind_of(cell: nbformat.NotebookNode, room: int) -> str:
    """Return what a cell is to the slides: "slide", "subslide", "-" (goes on) or "skip".

    Args:
        cell: a cell of a notebook.
        room: characters that the slide before it still holds.
    """
    tags = cell.metadata.get("tags", [])
    if "check" in tags or cell.source.startswith("<details>"):
        return "skip"
    if cell.cell_type == "markdown" and cell.source.startswith(("# ", "## ")):
        return "slide"
    if cell.cell_type == "markdown" and cell.source.startswith("### "):
        return "subslide"
    if "alt" in cell.metadata or room < len(cell.source):
        return "subslide"
    return "-"


def as_slides(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Return a copy of a notebook in which every cell says what it is to the slides."""
    result = split_at_headings(notebook)
    room = 0
    for cell in result.cells:
        kind = kind_of(cell, room)
        cell.metadata["slideshow"] = {"slide_type": kind}
        if kind != "skip":
            room = (room if kind == "-" else LONG) - len(cell.source)
    return result


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
    if options.reveal:
        exporter.reveal_url_prefix = options.reveal
    for path in [find_notebook(n) for n in options.notebook] or all_notebooks():
        slides = as_slides(nbformat.read(path, as_version=4))
        page = with_alts(exporter.from_notebook_node(slides)[0], slides)
        (OUT / f"{path.stem}.slides.html").write_text(page, encoding="utf-8")
        print(OUT / f"{path.stem}.slides.html")
    return 0


if __name__ == "__main__":
    sys.exit(main())
