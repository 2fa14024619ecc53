"""Writes notebooks as pages that need no network: the programs they load lie beside them."""

import base64
import mimetypes
import re
import shutil
from html import unescape
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import nbformat

from cotlearn.course.execution import Run, title
from cotlearn.files import write_text

#: Where MathJax is taken from without the package of the extra `docs`.
ELSEWHERE = "https://cdn.jsdelivr.net/npm/mathjax@3/es5/tex-svg.js"

#: The blocks of nbconvert's templates that would load something from the network.
BLOCKS = """
{% block html_head_js %}{% endblock %}
{% block html_head_js_mermaidjs %}{% endblock %}
{% block html_head_js_mathjax %}
<script>
window.MathJax = {tex: {inlineMath: [["$", "$"], ["\\\\(", "\\\\)"]], processEscapes: true}};
</script>
<script defer src="MATHJAX"></script>
{% endblock %}
"""

#: Code that is folded in the notebook is folded on its page, too.
FOLDED = """
{% block input_group %}
{% if "hide-input" in cell.metadata.get("tags", [])
      or cell.metadata.get("jupyter", {}).get("source_hidden") %}
<details class="folded">
<summary style="font: 14px sans-serif; margin-left: 70px">
{{ cell.metadata.get("mystnb", {}).get("code_prompt_show", "Show the code") }}
</summary>
{{ super() }}
</details>
{% else %}{{ super() }}{% endif %}
{% endblock %}
"""

KEPT = ".unfinished"  #: the folder, in that of the pages, of notebooks that were executed so far

#: What the index says first.
ABOUT = "The notebooks as they ran, with their results, to be read in a browser. "
ABOUT += "To run and change them yourself: `make lab`.\n"


def to_html(run: Run, folder: Path) -> Path:
    """Writes the executed notebook as an HTML page.

    Args:
        run: An executed notebook.
        folder: The destination; created if it does not exist.

    Returns:
        The path of the page.
    """
    page = folder / f"{run.path.stem}.html"
    body = _as_html(run.notebook, run.path, folder)
    # Links between notebooks, also from and to a folder, become links between pages.
    body = re.sub(r'href="(?:[\w.-]+/)?([\w.-]+)\.ipynb', r'href="\1.html', body)
    write_text(page, body)
    return page


def keep(run: Run, folder: Path) -> None:
    """Keeps an executed notebook, so that a command that is stopped goes on behind it."""
    found = run.notebook.copy()
    found.metadata = {
        **run.notebook.metadata,
        "run": {"seconds": run.seconds, "claims": run.claims},
    }
    write_text(_kept(run.path, folder), nbformat.writes(found))


def kept(path: Path, folder: Path) -> Run | None:
    """What was kept of a notebook; None if nothing was, or the notebook has changed since."""
    file = _kept(path, folder)
    if not file.exists() or file.stat().st_mtime < path.stat().st_mtime:
        return None
    notebook = nbformat.read(file, as_version=4)
    return Run(path, notebook, **notebook.metadata.pop("run"))


def forget(folder: Path) -> None:
    """Removes what was kept, once all pages are written."""
    shutil.rmtree(folder / KEPT, ignore_errors=True)


def _kept(path: Path, folder: Path) -> Path:
    return folder / KEPT / path.name


def write_index(runs: list[Run], folder: Path) -> Path:
    """Writes `index.html` with links to the pages of `runs`, and returns its path.

    The pages must be there: their links to files that are not become plain text.
    """
    for run in runs:
        unlink_missing(folder / f"{run.path.stem}.html")
    lines = ["# cotlearn\n", ABOUT]
    for run in runs:
        end = f"; stopped at cell {run.failed}" if run.error else ""
        facts = f"{run.seconds:.0f} s, {run.claims} claims hold{end}"
        lines.append(f"- [{title(run.notebook)}](<{run.path.stem}.html>): {facts}")
    index = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell("\n".join(lines))])
    page = folder / "index.html"
    write_text(page, _as_html(index, Path("cotlearn"), folder))
    return page


def template(base: str, folder: Path) -> str:
    """Returns a template of nbconvert that loads MathJax from `folder`, and nothing else.

    Args:
        base: The template that it extends, such as "lab".
        folder: Where the pages go, and MathJax with them.
    """
    blocks = BLOCKS.replace("MATHJAX", mathjax(folder))
    return f'{{% extends "{base}/index.html.j2" %}}{blocks}'


def mathjax(folder: Path) -> str:
    """Copies MathJax into a folder of pages; returns its address for them.

    It draws formulas as pictures, so it needs no font. Without the package that has it, the address
    is one in the network.
    """
    try:
        package = distribution("sphinx-mathjax-offline")
    except PackageNotFoundError:
        return ELSEWHERE
    source = Path(str(package.locate_file("sphinx-mathjax-offline/static/mathjax/tex-svg.js")))
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, folder / source.name)
    return source.name


def unlink_missing(page: Path) -> None:
    """Turns a page's links to files that do not lie beside it into plain text."""

    def checked(found: re.Match[str]) -> str:
        target = unquote(unescape(found[1])).partition("#")[0]
        there = not target or re.match("[a-z]+:", target) or (page.parent / target).exists()
        return found[0] if there else found[2]

    if page.exists():
        body = page.read_text("utf-8")
        link = r'<a (?:[^>]* )?href="([^"]*)"[^>]*>(.*?)</a>'
        write_text(page, re.sub(link, checked, body, flags=re.DOTALL))


def with_pictures(body: str, home: Path) -> str:
    """Puts the pictures that a page shows from files into the page.

    Args:
        body: The HTML page.
        home: The folder of its notebook.
    """

    def embed(found: re.Match[str]) -> str:
        file, kind = home / found[2], mimetypes.guess_type(found[2])[0]
        if kind is None or not file.is_file():
            return found[0]
        return f"{found[1]}data:{kind};base64,{base64.b64encode(file.read_bytes()).decode()}"

    return re.sub(r'(<img [^>]*\bsrc=")(?!data:)([^"]+)', embed, body)


def _as_html(notebook: Any, path: Path, folder: Path) -> str:
    from nbconvert import HTMLExporter  # takes half a second, and most runs do without

    resources = {"metadata": {"name": path.stem}}
    exporter = HTMLExporter(raw_template=template("lab", folder) + FOLDED)
    body, _ = exporter.from_notebook_node(notebook, resources=resources)
    return with_pictures(body, path.parent)
