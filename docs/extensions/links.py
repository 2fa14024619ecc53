"""Links that nobody has to write: glossary terms, names of the library and arXiv numbers.

Notebooks are read in JupyterLab too, where a role like {term} would be noise. So the first time
that a page's text uses a term of the glossary, or names something of the library in code, the site
links it.
"""

import importlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

GLOSSARY = "docs/reference/glossary"
#: What an inline name may stand for; of two with one name, the first.
LIBRARY = ("mixtures", "gaussian", "couplings", "flows", "potentials", "metrics", "diagnostics")
ARXIV = re.compile(r"(?<![\w./])(\d{4}\.\d{5})(?![\w/]|\.\d)")
#: Terms that are everyday words, too: a text means the term where it writes it in italics.
EVERYDAY = {"bend", "floor", "frame", "margin", "mode", "plan", "probe", "stream", "teacher"}
EVERYDAY |= {"temperature", "trial", "variety"}
NOT_IN = (nodes.reference, nodes.literal, nodes.math, nodes.title, addnodes.pending_xref)


@cache
def terms(path: Path) -> dict[str, str]:
    """Return the terms of the glossary, in small letters -> as they stand there."""
    block = path.read_text("utf-8").split("{glossary}\n", 1)[1].split("\n:::", 1)[0]
    found = [line for line in block.splitlines() if line and not line[0].isspace()]
    return {term.lower(): term for term in found}


@cache
def pattern(path: Path) -> re.Pattern[str]:
    """Return the pattern of all terms, the longest first, also in the plural.

    Abbreviations are looked for as they stand: MAC is no Mac.
    """
    longest = sorted(terms(path).values(), key=len, reverse=True)
    words = [re.escape(t) if t.isupper() else f"(?i:{re.escape(t)})" for t in longest]
    return re.compile(rf"(?<![\w-])({'|'.join(words)})s?(?![\w-])")


@cache
def library_names() -> dict[str, str]:
    """Return the names that the library exports, as name -> full name."""
    names: dict[str, str] = {}
    for module_name in LIBRARY:
        module = importlib.import_module(f"cotlearn.{module_name}")
        for name in getattr(module, "__all__", None) or vars(module):
            home = getattr(getattr(module, name), "__module__", "") or ""
            if not name.startswith("_") and home.startswith("cotlearn"):
                names.setdefault(name, f"cotlearn.{module_name}.{name}")
    return names


def cross_reference(domain: str, kind: str, target: str, inner: nodes.Node) -> nodes.Node:
    """Return a reference that stays plain text if its target does not exist."""
    return addnodes.pending_xref(
        "", inner, refdomain=domain, reftype=kind, reftarget=target, refexplicit=True
    )


class Links(SphinxTransform):
    """Puts the links into the paragraphs of a page."""

    default_priority = 400

    def apply(self) -> None:
        """Look at every paragraph of this document."""
        docname = self.env.docname
        is_api = docname.startswith("docs/reference/api")
        self.glossary = Path(self.env.srcdir) / f"{GLOSSARY}.md"
        self.seen: set[str] = set()
        for paragraph in self.document.findall(nodes.paragraph):
            for text in list(paragraph.findall(nodes.Text)):
                if not inside(text, NOT_IN):
                    pieces = list(self.arxiv(text.astext()))
                    if docname != GLOSSARY and not is_api:
                        italic = inside(text, (nodes.emphasis,))
                        pieces = [q for p in pieces for q in self.glossary_terms(p, italic=italic)]
                    if len(pieces) > 1:
                        text.parent.replace(text, pieces)
            if not is_api:
                self.names(paragraph)

    def arxiv(self, text: str) -> Iterator[nodes.Node]:
        """Split a text at arXiv numbers, which become references."""
        for i, part in enumerate(ARXIV.split(text)):
            if i % 2:
                yield nodes.reference("", part, refuri=f"https://arxiv.org/abs/{part}")
            elif part:
                yield nodes.Text(part)

    def glossary_terms(self, piece: nodes.Node, *, italic: bool) -> Iterator[nodes.Node]:
        """Split a text, perhaps in italics, at the terms that this page has not used before."""
        if not isinstance(piece, nodes.Text):
            yield piece
            return
        text, start = piece.astext(), 0
        for match in pattern(self.glossary).finditer(text):
            term = match[1].lower()
            if term in self.seen or (term in EVERYDAY and not italic):
                continue
            self.seen.add(term)
            if match.start() > start:
                yield nodes.Text(text[start : match.start()])
            words = nodes.inline("", match[0], classes=["term"])
            yield cross_reference("std", "term", terms(self.glossary)[term], words)
            start = match.end()
        if start < len(text):
            yield nodes.Text(text[start:])

    def names(self, paragraph: nodes.paragraph) -> None:
        """Link inline code that is a name of the library, once a page."""
        for literal in list(paragraph.findall(nodes.literal)):
            name = literal.astext().removesuffix("()")
            full = library_names().get(name)
            if full is None or name in self.seen or inside(literal, NOT_IN):
                continue
            self.seen.add(name)
            literal.replace_self(cross_reference("py", "obj", full, literal.deepcopy()))


def inside(node: nodes.Node, kinds: tuple[type[nodes.Node], ...]) -> bool:
    """Tell whether one of the node's ancestors is of one of the kinds."""
    node = node.parent
    while node is not None:
        if isinstance(node, kinds):
            return True
        node = node.parent
    return False


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the transform."""
    app.add_transform(Links)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
