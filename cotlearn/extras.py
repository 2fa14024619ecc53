"""How to install what is optional: from the checkout, because no release is in any registry."""


def how_to_install(extra: str) -> str:
    """The command that installs an extra of pyproject.toml, in the checkout's folder.

    It never asks a registry for this project: whoever registers the name there supplies the code.
    """
    return f"pip install '.[{extra}]' (in the folder of the course's checkout)"
