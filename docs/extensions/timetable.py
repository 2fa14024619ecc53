"""The directive `timetable`: every notebook with its claim and its times, from its first cells."""

import json
import re
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

TITLE = re.compile(r"# (\d\d · .+)")
CLAIM = re.compile(r"^\*\*([^*].+)\*\*$", re.MULTILINE)
TIME = re.compile(r"\*\*Time\*\*:? (.+)")


def rows(folder: Path) -> list[tuple[str, str, str, str]]:
    """Return (file name, title, claim, times) for every numbered notebook."""
    found = []
    for path in sorted(folder.glob("[0-9][0-9]_*.ipynb")):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        opening = "\n".join("".join(cell["source"]) for cell in cells[:3])
        parts = [pattern.search(opening) for pattern in (TITLE, CLAIM, TIME)]
        if None in parts:
            raise ValueError(f"{path.name} does not open with a title, a claim and its times")
        found.append((path.name, *(part[1].strip() for part in parts if part)))
    return found


class Timetable(SphinxDirective):
    """Expands to a list of the notebooks."""

    def run(self) -> list[nodes.Node]:
        """Return one item a notebook."""
        folder = Path(self.env.srcdir) / "notebooks"
        here = Path(self.env.docname).parent
        up = "../" * len(here.parts)
        lines = []
        for name, title, claim, times in rows(folder):
            if f"notebooks/{Path(name).stem}" not in self.env.found_docs:
                continue  # it came while the site was being built
            self.env.note_dependency(str(folder / name))
            lines += [f"**[{title}]({up}notebooks/{name})**", f": {claim}", f": *{times}*", ""]
        return self.parse_text_to_nodes("\n".join(lines))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("timetable", Timetable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
