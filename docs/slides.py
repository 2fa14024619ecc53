"""Makes slides from stored notebooks: `python docs/slides.py build/slides 00 03`.

A heading starts a slide, and a figure has one below it; checks, folded solutions and folded code
are left out. The folder also gets reveal.js and MathJax, so the slides need no network.
"""

import shutil
import sys
from html import escape
from importlib.metadata import distribution
from pathlib import Path

import nbformat
from nbconvert import SlidesExporter
from nbconvert.preprocessors import Preprocessor
from traitlets.config import Config

from cotlearn.course import assets, pages
from cotlearn.course.execution import read
from cotlearn.files import write_text

#: Formulas are drawn before reveal.js hides all slides but one. A slide too high scrolls.
START = """
{% block footer_js %}
<style>.reveal .slides > section > section { max-height: 100%; overflow-y: auto; }</style>
<script src="reveal/dist/reveal.js"></script>
<script>
addEventListener("load", async () => {
    await MathJax.startup?.promise;
    Reveal.initialize({history: true, width: 960, height: 700});
});
</script>
{% endblock %}
"""


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


def exporter(folder: Path) -> SlidesExporter:
    """Return nbconvert's exporter of slides into `folder`, which gets what they load."""
    programs = distribution("sphinx-revealjs").locate_file("sphinx_revealjs/_static/revealjs")
    without = shutil.ignore_patterns("*.map", "*.esm.js")
    shutil.copytree(
        f"{programs}/dist", folder / "reveal" / "dist", ignore=without, dirs_exist_ok=True
    )
    folded = {"enabled": True, "remove_input_tags": {"hide-input"}}
    return SlidesExporter(
        config=Config(TagRemovePreprocessor=folded),
        preprocessors=[Slides],
        reveal_theme="white",
        reveal_url_prefix="reveal",
        raw_template=pages.template("reveal", folder) + START,
    )


def main(out: str, *names: str) -> None:
    """Write the slides of the notebooks with these numbers or paths, or of all of the path."""
    folder = Path(out)
    write = exporter(folder)
    for path in [assets.find_notebook(name) for name in names] or assets.notebooks():
        body, _ = write.from_notebook_node(read(path), {"metadata": {"name": path.stem}})
        page = folder / f"{path.stem}.slides.html"
        write_text(page, pages.with_pictures(body, path.parent))
        print(page)


if __name__ == "__main__":
    main(*sys.argv[1:])
