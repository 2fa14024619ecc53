"""Old names that still work, with a warning, for one minor version; CHANGELOG lists them."""

import importlib
import importlib.abc
import importlib.machinery
import sys
import warnings
from collections.abc import Callable
from types import ModuleType
from typing import Any

#: Modules that moved: old name -> new name.
MODULES = {
    "cotlearn.robots.benchmark": "cotlearn.policies.comparison",
    "cotlearn.robots.episodes.windows": "cotlearn.policies.windows",
    "cotlearn.robots.pixels": "cotlearn.policies.pixels",
    "cotlearn.robots.policies": "cotlearn.policies.policy",
    "cotlearn.robots.rollout": "cotlearn.policies.rollout",
    "cotlearn.robots.settings": "cotlearn.policies.settings",
    "cotlearn.robots.training": "cotlearn.policies.training",
    "cotlearn.robots.visuomotor": "cotlearn.policies.pixels",
}


def renamed(module: str, names: dict[str, str]) -> Callable[[str], Any]:
    """Make a `__getattr__` for a module that finds renamed objects and warns (FutureWarning).

    Args:
        module: `__name__` of the module.
        names: old name -> new name, or -> "module:name" if the object also moved.
    """

    def find(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        where, _, new = names[name].rpartition(":")
        _warn(f"{module}.{name}", f"{where or module}.{new}")
        return getattr(importlib.import_module(where or module), new)

    return find


class _Moved(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """An import hook that finds `MODULES` under their old names."""

    def find_spec(
        self, fullname: str, path: Any = None, target: Any = None
    ) -> importlib.machinery.ModuleSpec | None:
        return importlib.machinery.ModuleSpec(fullname, self) if fullname in MODULES else None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        _warn(spec.name, MODULES[spec.name])
        module = importlib.import_module(MODULES[spec.name])
        spec.loader_state = module.__spec__  # the import system is about to replace it
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing to execute: the module was imported under its new name."""
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state


def _warn(old: str, new: str) -> None:
    warnings.warn(f"{old} is called {new} now", FutureWarning, stacklevel=3)


sys.meta_path.append(_Moved())
