"""Other people's packages that some tests need: those of the extra `peers`."""

import importlib
import os
import re
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch

OPERATOR = re.compile(r"torchvision::(\w+)|register_meta\(\"(\w+)\"")


def peer(name):
    """Import a package, or skip the test; with COTLEARN_PEERS=1, as in CI, its absence fails."""
    if name == "lerobot":
        return lerobot()
    if os.environ.get("COTLEARN_PEERS") == "1":
        return importlib.import_module(name)
    return pytest.importorskip(name, reason=f"no {name}: COTLEARN_PEERS=1 make setup brings it")


def lerobot():
    """Import LeRobot, or skip the test: `make bridge` brings it, into an environment of its own."""
    if find_spec("lerobot") is None:
        pytest.skip("no lerobot: make bridge runs this test with it")
    os.environ.setdefault("HF_HUB_OFFLINE", "1")  # a data set on this disk is not looked for there
    name_torchvisions_operators()
    return importlib.import_module("lerobot")


def name_torchvisions_operators():
    """Let torchvision be imported though its operators were built for another torch.

    It declares shapes for operators as box suppression, and fails where their binary does not load.
    No test calls them, so their names are enough.
    """
    try:
        import torchvision  # noqa: F401
    except RuntimeError:
        folder = Path(find_spec("torchvision").submodule_search_locations[0])
        source = (folder / "_meta_registrations.py").read_text("utf-8")
        library = torch.library.Library("torchvision", "FRAGMENT")
        for name in {first or second for first, second in OPERATOR.findall(source)}:
            library.define(f"{name}(Tensor rows) -> Tensor")
        _KEPT.append(library)  # its names go with it


_KEPT = []
