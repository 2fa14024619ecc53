"""Makes slides from stored notebooks: `python docs/slides.py build/slides 00 03`.

Every heading starts a slide. A figure or a table has a slide of its own below it, and a long text
goes on in the next one. Checks, solutions and folded code are left out. The folder also gets
reveal.js and MathJax, so the slides need no network.
"""

import math
import re
import shutil
import sys
from html import escape
from importlib.metadata import distribution
from pathlib import Path

import nbformat
from nbconvert import SlidesExporter
from traitlets.config import Config

from cotlearn.course import assets, pages
from cotlearn.course.execution import read
from cotlearn.files import write_text

#: Formulas are drawn before reveal.js hides all slides but one. A slide too high scrolls.
START = """
{% block footer_js %}
<style>
.reveal { font-size: 24px; }
.reveal .slides section section { max-height: 100%; overflow-y: auto; }
.reveal h1, .reveal h2, .reveal h3 { text-transform: none; line-height: 1.2; }
.reveal .jp-RenderedHTMLCommon { font-size: 24px; line-height: 1.35; }
.reveal .jp-RenderedHTMLCommon table { font-size: 19px; }
.reveal .jp-InputArea-editor, .reveal pre, .reveal pre code { max-height: none; width: 100%;
    box-sizing: border-box; }
.reveal .slides pre { margin: 0; font-size: 17px; line-height: 1.3; white-space: pre-wrap;
    overflow-wrap: anywhere; word-break: normal; box-shadow: none; }
.reveal .slides img { display: block; margin: 0 auto; width: 100%; max-height: 600px;
    object-fit: contain; }
</style>
<script src="reveal/dist/reveal.js"></script>
<script>
addEventListener("load", async () => {
    await MathJax.startup?.promise;
    Reveal.initialize({history: true, width: 960, height: 700});
});
</script>
{% endblock %}
"""

ROOM = 16  #: lines of text on a slide
HEADING = 3  #: lines that a heading or a formula takes
WIDE = 78  #: characters of a line
PART = re.compile(
    r"<details.*?</details>|^```.*?^```|^\$\$.*?\$\$[ .,]*$"  # kept whole, with empty lines
    r"|^#+ [^\n]*|^(?:[-*]|\d+\.) .*?(?=\n(?:[-*]|\d+\.) |\n\n|\Z)|^ *\S.*?(?=\n\n|\n```|\Z)",
    re.DOTALL | re.MULTILINE,
)
ITEM = re.compile(r"(?:[-*]|\d+\.) ")
HEADING_ALONE = re.compile(r"#+ [^\n]*")
FIGURE = re.compile(r"!\[|<img ")


def slides_of(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Return a copy of a notebook whose cells say where a slide starts."""
    cells: list[nbformat.NotebookNode] = []
    filled = math.inf  # lines of the slide so far

    def add(cell: nbformat.NotebookNode, lines: float, kind: str = "-") -> None:
        nonlocal filled
        if kind == "-" and filled + lines > ROOM:
            kind = "subslide"
        cell.metadata["slideshow"] = {"slide_type": kind}
        cells.append(cell)
        filled = lines + (0 if kind != "-" else filled)

    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            for part in together(PART.findall(cell.source)):
                if part.startswith("<details"):
                    filled = ROOM  # what follows a solution has a slide of its own
                    continue
                kind = kind_of(part)
                if kind == "subslide" and cells and HEADING_ALONE.fullmatch(cells[-1].source):
                    kind = "-"  # a heading within a heading
                joined = cells and cells[-1].cell_type == "markdown" and kind == "-"
                if joined and filled + lines_of(part) <= ROOM:
                    items = ITEM.match(part) and ITEM.match(cells[-1].metadata["last"])
                    cells[-1].source += ("\n" if items else "\n\n") + part
                    cells[-1].metadata["last"] = part
                    filled += lines_of(part)
                else:
                    new = nbformat.v4.new_markdown_cell(part, metadata={"last": part})
                    add(new, lines_of(part), kind)
        elif cell.cell_type == "code" and "check" not in cell.metadata.get("tags", []):
            for piece in pieces(cell):
                shown = 0 if "hide-input" in piece.metadata.tags else code_lines(piece.source)
                high = any(is_high(output) for output in piece.outputs)
                printed = sum(code_lines(output.get("text", "")) for output in piece.outputs)
                if high:
                    add(piece, ROOM, "subslide")
                elif shown or piece.outputs:
                    add(piece, shown + printed)
    return nbformat.v4.new_notebook(cells=cells, metadata=notebook.metadata)


def together(parts: list[str]) -> list[str]:
    """Join the items of a list, and the sentence before them, if they fit below a heading."""
    joined: list[str] = []
    for part in parts:
        last = joined[-1] if joined else ""
        whole = last + ("\n" if ITEM.match(last.split("\n")[-1]) else "\n\n") + part
        plain = (
            last and not last.startswith(("#", "|", "$$", "```", "<")) and not FIGURE.match(last)
        )
        if ITEM.match(part) and plain and lines_of(whole) <= ROOM - HEADING:
            joined[-1] = whole
        else:
            joined.append(part)
    return joined


def kind_of(part: str) -> str:
    """Return what a part of a text starts, in nbconvert's words."""
    if part.startswith(("# ", "## ")):
        return "slide"
    return "subslide" if part.startswith("##") or FIGURE.match(part) else "-"


def lines_of(part: str) -> float:
    """Return how many lines a part of a text takes, about."""
    if part.startswith("```"):
        return code_lines(part)
    if FIGURE.match(part):
        return ROOM
    if part.startswith(("#", "$$")):
        return HEADING
    text = re.sub(r"\]\([^)]*\)", "", part)  # the addresses of links
    if part.startswith("|"):
        return sum(1.2 * math.ceil(len(row) / WIDE) for row in text.splitlines())
    if len(rows := text.splitlines()) > 1 and any(map(ITEM.match, rows)):  # a list
        return sum(lines_of(row) for row in rows if row)
    return math.ceil(len(text) / WIDE) + (0.3 if ITEM.match(part) else 0.8)


def code_lines(code: str) -> float:
    """Return how many lines of text are as high as this code."""
    return 0.7 * (len(code.splitlines()) + 1) if code else 0


def is_high(output: nbformat.NotebookNode) -> bool:
    """Whether an output is a figure or a table."""
    return bool({"image/png", "image/gif", "text/html"} & set(output.get("data", {})))


def pieces(cell: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    """Return a code cell as one with what it prints, and one for each figure or table."""
    text, tags = escape(cell.metadata.get("alt", "")), cell.metadata.get("tags", [])
    first = nbformat.v4.new_code_cell(cell.source, metadata={"tags": tags})
    found = [first]
    for output in cell.outputs:
        if not is_high(output):
            first.outputs.append(output)
            continue
        picture = output.data.get("image/png")
        if picture:  # nbconvert's own template has no place for a text
            source = f"data:image/png;base64,{picture}"
            html = {"text/html": f'<img alt="{text}" src="{source}">'}
            output = nbformat.v4.new_output("display_data", html)
        folded = {"tags": ["hide-input"]}
        found.append(nbformat.v4.new_code_cell(cell.source, metadata=folded, outputs=[output]))
    return found


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
        exclude_input_prompt=True,
        exclude_output_prompt=True,
        reveal_theme="white",
        reveal_url_prefix="reveal",
        raw_template=pages.template("reveal", folder) + START,
    )


def main(out: str, *names: str) -> None:
    """Write the slides of the notebooks with these numbers or paths, or of all of the path."""
    folder = Path(out)
    try:
        paths = [assets.find_notebook(name) for name in names] or assets.notebooks()
    except ValueError as error:
        sys.exit(f"error: {error}")
    write, written = exporter(folder), []
    for path in paths:
        body, _ = write.from_notebook_node(slides_of(read(path)), {"metadata": {"name": path.stem}})
        page = folder / f"{path.stem}.slides.html"
        body = re.sub(r'href="(?:[\w.-]+/)?([\w.-]+)\.ipynb', r'href="\1.slides.html', body)
        write_text(page, pages.with_pictures(body, path.parent))
        written.append(page)
    for page in written:
        pages.unlink_missing(page)
        print(page)


if __name__ == "__main__":
    main(*sys.argv[1:])
