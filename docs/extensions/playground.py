"""Writes the playground beside the site's pages: playground.html, one file that needs no server."""

from pathlib import Path

from sphinx.application import Sphinx

from cotlearn.play import write_page

NAME = "playground.html"


def write(app: Sphinx, error: Exception | None) -> None:
    """Write the page at the end of a build that went well."""
    if error is None and app.builder.format == "html":
        write_page(Path(app.outdir) / NAME)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the page."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
