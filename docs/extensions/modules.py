"""The directive `modules`: the reference of all modules whose names match.

A pattern to a line, as in a shell; what a module exports by `__all__` is shown there, and otherwise
what it defines. An object is shown once. A new module joins without a new line.
"""

import fnmatch
import importlib
import inspect
import pkgutil
from types import ModuleType

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.parsing import nested_parse_to_nodes

import cotlearn


def module_names() -> list[str]:
    """Return the names of all modules of the package, but private ones and those that run."""
    found = pkgutil.walk_packages(cotlearn.__path__, "cotlearn.")
    return [m.name for m in found if "._" not in m.name]


def public_names(module: ModuleType) -> list[str]:
    """Return what a module offers, in the order in which it does."""
    if hasattr(module, "__all__"):
        return list(module.__all__)
    own = [n for n, v in vars(module).items() if getattr(v, "__module__", "") == module.__name__]
    return [n for n in own if not n.startswith("_") and inspect.getdoc(vars(module)[n])]


class Modules(SphinxDirective):
    """Expands to one `automodule` a module."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the nodes of all modules that match."""
        shown: set[int] = set()
        lines: list[str] = []
        for pattern in self.content:
            names = fnmatch.filter(module_names(), pattern)
            if not names:
                raise self.error(f"no module matches {pattern!r}")
            for name in names:
                lines += self.lines_of(name, shown)
        return nested_parse_to_nodes(self.state, StringList(lines, source="modules"))

    def lines_of(self, name: str, shown: set[int]) -> list[str]:
        """Return the reStructuredText of one module; notes in `shown` what it shows."""
        module = importlib.import_module(name)
        members = [n for n in public_names(module) if id(getattr(module, n)) not in shown]
        members = [n for n in members if callable(getattr(module, n))]
        shown.update(id(getattr(module, n)) for n in members)
        if not members:
            return []
        return [
            "",
            f".. rubric:: {name}",
            "",
            f".. automodule:: {name}",
            f"   :members: {', '.join(members)}",
            "",
        ]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("modules", Modules)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
