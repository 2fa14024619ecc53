"""The address of the repository, in the one place where a copy of the course says its own.

That is `Repository` under `[project.urls]` in pyproject.toml. Pages write `<address of your copy>`;
with an address the site writes it there, and each notebook's page begins with "Open in Colab" if
the address is GitHub's, which Colab reads. Without one pages stay as they are.
"""

import re
import tomllib
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

PLACE = "<address of your copy>"
GITHUB = re.compile(r"https://github\.com/([\w.-]+/[\w.-]+?)(?:\.git|/)?")
COLAB = "https://colab.research.google.com/github"


def address(pyproject: Path) -> str:
    """The repository's address, or nothing."""
    project = tomllib.loads(pyproject.read_text("utf-8"))["project"]
    return str(project.get("urls", {}).get("Repository", ""))


def in_colab(repository: str, page: str) -> str:
    """The address at which Colab opens a page's notebook, or nothing if it cannot."""
    found = GITHUB.fullmatch(repository)
    if not found or not page.startswith("notebooks/"):
        return ""
    return f"{COLAB}/{found[1]}/blob/main/{page}.ipynb"


def fill_in(app: Sphinx, page: str, source: list[str]) -> None:
    """Write the address into a page that asks for it."""
    if repository := address(Path(app.srcdir) / "pyproject.toml"):
        source[0] = source[0].replace(PLACE, repository)


class Badge(SphinxTransform):
    """Puts "Open in Colab" below the title of a notebook."""

    default_priority = 500

    def apply(self) -> None:
        """Look at this document."""
        repository = address(Path(self.env.srcdir) / "pyproject.toml")
        target = in_colab(repository, self.env.docname)
        title = next(iter(self.document.findall(nodes.title)), None)
        if target and title is not None:
            link = nodes.reference("", "Open in Colab", refuri=target)
            words = nodes.Text(" (the how-to page on Colab has the two lines that it needs first)")
            title.parent.insert(title.parent.index(title) + 1, nodes.paragraph("", "", link, words))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register both."""
    app.connect("source-read", fill_in)
    app.add_transform(Badge)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
