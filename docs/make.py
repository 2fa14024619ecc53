"""Builds the site and checks it: what `make docs` runs.

    python docs/make.py            # into build/site

It checks the spelling of all prose, builds with every warning an error, and reads the pages that
came out: links inside the site, texts of figures, and that nothing is loaded from elsewhere. It
needs no network.
"""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
SITE = ROOT / "build" / "site"
LOADS = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src"}


def prose(folder: Path) -> list[Path]:
    """Write the text of all notebooks to a folder, and return all files whose words count."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [*ROOT.glob("*.md"), *DOCS.rglob("*.md"), ROOT / "data" / "README.md"]
    files += [ROOT / "course.py", *(ROOT / "cotlearn").rglob("*.py"), *DOCS.rglob("*.py")]
    for notebook in sorted((ROOT / "notebooks").rglob("*.ipynb")):
        if notebook.parent.name.startswith("."):
            continue
        cells = json.loads(notebook.read_text("utf-8"))["cells"]
        text = folder / f"{notebook.stem}.md"
        sources = ["".join(cell["source"]) for cell in cells]
        alts = [cell["metadata"].get("alt", "") for cell in cells]
        text.write_text("\n\n".join([*sources, *alts]), "utf-8")
        files.append(text)
    return files


def misspelled(folder: Path) -> list[str]:
    """Return the words that codespell knows to be wrong, as `file:line: word ==> right`.

    A right word that it takes for a wrong one goes to docs/words.txt, in small letters.
    """
    command = [sys.executable, "-m", "codespell_lib", "--ignore-words", str(DOCS / "words.txt")]
    command += [str(path) for path in prose(folder)]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)
    return (done.stdout or done.stderr).splitlines() if done.returncode else []


def build(site: Path) -> int:
    """Run Sphinx; warnings are errors. Return its exit status."""
    options = ["-q", "-W", "--keep-going", "-c", str(DOCS), "-d", str(site.parent / "doctrees")]
    # A process of its own: Sphinx changes the signatures of the functions that it describes.
    command = [sys.executable, "-m", "sphinx", *options, str(ROOT), str(site)]
    return subprocess.call(command, cwd=ROOT)


class Page(HTMLParser):
    """What a page of the site links to, loads and shows.

    Attributes:
        anchors: the ids that a link can lead to.
        links: targets of links, as written.
        loads: addresses of scripts, styles and pictures.
        images: the text of every picture, None where it has none.
    """

    def __init__(self, html: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.images: list[str | None] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note one element."""
        values = dict(attrs)
        if values.get("id"):
            self.anchors.add(str(values["id"]))
        if tag == "a" and values.get("href"):
            self.links.append(str(values["href"]))
        if tag == "img":
            self.images.append(values.get("alt"))
        if tag in LOADS and values.get(LOADS[tag]):
            self.loads.append(str(values[LOADS[tag]]))


def problems(site: Path) -> list[str]:
    """Return what is wrong with the pages of a built site, a sentence each."""
    pages = {path: Page(path.read_text("utf-8")) for path in sorted(site.rglob("*.html"))}
    return [
        f"{path.relative_to(site).as_posix()}: {problem}"
        for path, page in pages.items()
        for problem in problems_of(path, page, pages)
    ]


def problems_of(path: Path, page: Page, pages: dict[Path, Page]) -> Iterator[str]:
    """Yield what is wrong with one page."""
    for alt in page.images:
        if not (alt or "").strip():
            yield "a picture without a text (alt)"
    for address in page.loads:
        if urlsplit(address).scheme in {"http", "https"} or address.startswith("//"):
            yield f"loads {address} from elsewhere"
    for link in page.links:
        parts = urlsplit(link)
        if parts.scheme or parts.netloc:
            continue
        target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        if not target.exists():
            yield f"links to {link}, which does not exist"
        elif parts.fragment and target in pages and parts.fragment not in pages[target].anchors:
            yield f"links to {link}, which is a page without that place"


def main() -> int:
    """Check the words, build, check the pages; return 0 if all is well."""
    found = misspelled(ROOT / "build" / "words")
    shutil.rmtree(SITE, ignore_errors=True)  # pages that are no more would still answer links
    status = build(SITE)
    if status == 0:
        found += problems(SITE)
    for line in found:
        print(line, file=sys.stderr)
    if status or found:
        return 1
    print(f"The site is built: open {SITE / 'index.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
