"""How the JupyterLab of `cotlearn lab` saves: without what differs from machine to machine.

Opening a notebook of a checkout and saving it changes nothing, whichever Python runs it.
"""

from typing import Any

from jupyter_server.services.contents.largefilemanager import AsyncLargeFileManager


class SameEverywhere(AsyncLargeFileManager):
    """Jupyter's own manager of files; the version of Python is not written into notebooks."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.register_pre_save_hook(_forget_version)


def _forget_version(model: dict[str, Any], **options: Any) -> None:
    content = model.get("content")
    if model.get("type") == "notebook" and isinstance(content, dict):
        content.get("metadata", {}).get("language_info", {}).pop("version", None)
