"""Executes notebooks without a browser, in the Python that this package is installed in."""

import os
import re
import time
from dataclasses import dataclass
from pathlib import Path

import nbformat
import zmq
from jupyter_client.kernelspec import KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

from cotlearn.claims import count_claims
from cotlearn.files import write_text
from cotlearn.progress import progress_bar


@dataclass(frozen=True)
class Run:
    """What happened when a notebook was executed.

    Attributes:
        path: where the notebook is.
        notebook: with the new outputs.
        seconds: from start to end.
        claims: how many held.
        failed: the cell at which it stopped, counted from 0 among all cells; None if it did not.
        error: why it stopped: a traceback, or a sentence.
    """

    path: Path
    notebook: nbformat.NotebookNode
    seconds: float
    claims: int
    failed: int | None = None
    error: str = ""


def execute(path: Path, *, timeout: int = 300) -> Run:
    """Executes a notebook from top to bottom in a fresh kernel.

    The kernel is the Python that runs this function, whatever kernels are registered on the
    machine. Progress bars inside the notebook are off (`COTLEARN_PROGRESS=0`), and it computes
    on one core unless `OMP_NUM_THREADS` says otherwise: the course's networks are so small that
    threads cost more time than they save.

    Args:
        path: The notebook; it is read, not changed.
        timeout: Most seconds for one cell; at least 1.

    Returns:
        The executed notebook, the time it took, the claims that held and the failure, if any.

    Raises:
        ValueError: If `path` is not a readable notebook, or `timeout` is below 1.
    """
    if timeout < 1:
        raise ValueError(f"timeout must be at least 1 second, got {timeout}")
    notebook = read(path)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    start, begun = time.perf_counter(), [0]
    bar = progress_bar(total=len(code), what=path.stem)
    client = NotebookClient(
        notebook,
        km=_kernel_manager(),
        timeout=timeout,
        record_timing=False,
        store_widget_state=False,
        resources={"metadata": {"path": str(path.resolve().parent)}},
        on_cell_execute=lambda cell, cell_index: begun.append(cell_index),
        on_cell_executed=lambda **done: bar.update(),
    )
    environment = {"OMP_NUM_THREADS": "1", **os.environ, "COTLEARN_PROGRESS": "0"}
    environment["PYDEVD_DISABLE_FILE_VALIDATION"] = "1"
    error = ""
    try:
        with bar:
            client.execute(cleanup_kc=True, env=environment)  # always ends the kernel
    except CellExecutionError as raised:
        error = _outputs(notebook.cells[begun[-1]], "error") or str(raised)
    except CellTimeoutError:
        error = f"The cell ran for longer than {timeout} seconds and was stopped."
    except DeadKernelError:
        if hasattr(client, "_async_cleanup_kernel_future"):  # nbclient's mark of a Ctrl-C
            raise KeyboardInterrupt from None
        error = "The kernel died while it ran this cell (out of memory?)."
    seconds = time.perf_counter() - start
    claims = sum(count_claims(_outputs(cell, "stdout")) for cell in code)
    return Run(path, notebook, seconds, claims, begun[-1] if error else None, error)


def read(path: Path) -> nbformat.NotebookNode:
    """Reads a notebook.

    Args:
        path: An `.ipynb` file.

    Returns:
        The notebook, in format 4.

    Raises:
        ValueError: If the file is missing or damaged.
    """
    try:
        notebook = nbformat.read(path, as_version=4)
        if isinstance(notebook.get("cells"), list):
            return notebook
        problem = "it has no cells"
    except FileNotFoundError:
        raise ValueError(f"there is no notebook at {path}") from None
    except OSError as error:
        raise ValueError(f"{path.name} cannot be read: {error.strerror}") from None
    except Exception as error:  # nbformat fails in many ways on what is no notebook
        problem = f"it is empty or damaged, or another kind of file ({str(error)[:200]})"
    raise ValueError(f"{path.name} is not a readable notebook: {problem}")


def store(run: Run) -> None:
    """Writes the executed notebook over the original; the old file stays whole until the end."""
    run.notebook.metadata.setdefault("language_info", {}).pop("version", None)
    run.notebook.metadata.pop("widgets", None)
    text = nbformat.writes(run.notebook)
    write_text(run.path, text if text.endswith("\n") else text + "\n")


def to_html(run: Run, folder: Path) -> Path:
    """Writes the executed notebook as a page to read.

    Args:
        run: An executed notebook.
        folder: Where to; made if it does not exist.

    Returns:
        The path of the page.
    """
    page = folder / f"{run.path.stem}.html"
    body = _as_html(run.notebook, run.path.stem)
    # Links between notebooks become links between pages.
    for other in run.path.parent.glob("*.ipynb"):
        body = body.replace(f'href="{other.name}', f'href="{other.stem}.html')
    write_text(page, body)
    return page


def write_index(runs: list[Run], folder: Path) -> Path:
    """Writes a page that links to the pages of `runs`, with time and claims of each."""
    lines = ["# cotlearn\n"]
    for run in runs:
        end = f"; stopped at cell {run.failed}" if run.error else ""
        facts = f"{run.seconds:.0f} s, {run.claims} claims hold{end}"
        lines.append(f"- [{title(run.notebook)}](<{run.path.stem}.html>): {facts}")
    index = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell("\n".join(lines))])
    page = folder / "index.html"
    write_text(page, _as_html(index, "cotlearn"))
    return page


def title(notebook: nbformat.NotebookNode) -> str:
    """Returns the first heading of a notebook, or "untitled"."""
    prose = (cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    found = re.search(r"^# (.+)$", "\n".join(prose), re.MULTILINE)
    return found[1].strip() if found else "untitled"


def _as_html(notebook: nbformat.NotebookNode, name: str) -> str:
    from nbconvert import HTMLExporter  # takes half a second, and most runs do without

    resources = {"metadata": {"name": name}}
    return str(HTMLExporter().from_notebook_node(notebook, resources=resources)[0])


def _kernel_manager() -> AsyncKernelManager:
    # Without folders it knows only the Python that runs now, and no other kernel of the machine.
    specs = KernelSpecManager(kernel_dirs=[])
    manager = AsyncKernelManager(kernel_name="python3", kernel_spec_manager=specs)
    # Newer kernels warn about a connection without encryption, and newer managers can encrypt.
    if manager.has_trait("transport_encryption") and zmq.has("curve"):
        manager.transport_encryption = "auto"
    return manager


def _outputs(cell: nbformat.NotebookNode, kind: str) -> str:
    """What a cell printed to "stdout", or the traceback of its "error"."""
    outputs = [item for item in cell.outputs if kind in (item.get("name"), item.output_type)]
    return "\n".join(item.get("text") or "\n".join(item.traceback) for item in outputs)
