"""Executes notebooks without a browser, in the current Python environment."""

import os
import re
import time
import uuid
from dataclasses import dataclass
from pathlib import Path

import nbformat
import zmq
from jupyter_client.kernelspec import KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

from cotlearn.course.claims import count_claims
from cotlearn.files import write_text
from cotlearn.progress import progress_bar

#: What JupyterLab writes about the kernel; the version of Python is left out, as it varies.
METADATA = {
    "kernelspec": {
        "display_name": "Python 3 (ipykernel)",
        "language": "python",
        "name": "python3",
    },
    "language_info": {
        "codemirror_mode": {"name": "ipython", "version": 3},
        "file_extension": ".py",
        "mimetype": "text/x-python",
        "name": "python",
        "nbconvert_exporter": "python",
        "pygments_lexer": "ipython3",
    },
}


@dataclass(frozen=True)
class Run:
    """The result of executing a notebook.

    Attributes:
        path: path of the notebook.
        notebook: the notebook with its new outputs.
        seconds: run time.
        claims: number of claims that held.
        failed: index of the failed cell, from 0 among all cells; None if no cell failed.
        error: a traceback or a sentence; empty if no cell failed.
    """

    path: Path
    notebook: nbformat.NotebookNode
    seconds: float
    claims: int
    failed: int | None = None
    error: str = ""


def execute(path: Path, *, timeout: int = 300) -> Run:
    """Executes a notebook from top to bottom in a fresh kernel.

    The kernel runs the same Python as this function, whichever kernels are registered on the
    machine. Progress bars in the notebook are off (`COTLEARN_PROGRESS=0`). The notebook uses one
    core unless `OMP_NUM_THREADS` is set: the course's networks are so small that threads cost more
    time than they save.

    Args:
        path: The notebook; the file is not changed.
        timeout: Time limit for each cell in seconds, at least 1.

    Returns:
        The executed notebook, the time it took, the claims that held and the failure, if any.

    Raises:
        ValueError: If `path` is not a readable notebook, or `timeout` is below 1.
    """
    from cotlearn.validation import check_count  # imports torch

    check_count(timeout, "timeout")
    notebook = read(path)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    start, begun = time.perf_counter(), [0]
    bar = progress_bar(total=len(code), what=path.stem)
    client = NotebookClient(
        notebook,
        km=kernel_manager(),
        timeout=timeout,
        record_timing=False,
        store_widget_state=False,
        shutdown_kernel="immediate",
        resources={"metadata": {"path": str(path.resolve().parent)}},
        on_cell_execute=lambda cell, cell_index: begun.append(cell_index),
        on_cell_executed=lambda **done: bar.update(),
    )
    error = ""
    try:
        with bar:
            try:
                client.execute(cleanup_kc=True, env=environment())  # always ends the kernel
            except BaseException:  # cancelled coroutines, too
                if hasattr(client, "_async_cleanup_kernel_future"):  # nbclient's mark of a Ctrl-C
                    raise KeyboardInterrupt from None
                raise
    except CellExecutionError as raised:
        error = _outputs(notebook.cells[begun[-1]], "error") or str(raised)
    except CellTimeoutError:
        error = f"The cell ran for longer than {timeout} seconds and was stopped."
    except DeadKernelError:
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
        text = path.read_text(encoding="utf-8")  # nbformat.read would print what is not by the book
        notebook = nbformat.convert(nbformat.reader.reads(text), 4)
        if isinstance(notebook.get("cells"), list):
            return _with_ids(notebook)
        problem = "it has no cells"
    except FileNotFoundError:
        raise ValueError(f"there is no notebook at {path}") from None
    except OSError as error:
        raise ValueError(f"{path.name} cannot be read: {error.strerror}") from None
    except Exception:  # nbformat raises many kinds of errors for other files
        problem = "it is empty or damaged, or another kind of file"
    raise ValueError(f"{path.name} is not a readable notebook: {problem}")


def _with_ids(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Gives each cell an id of its own, as the format demands since 4.5."""
    seen: set[str] = set()
    for cell in notebook.cells if notebook.get("nbformat_minor", 0) >= 5 else []:
        if "id" not in cell or cell["id"] in seen:
            cell["id"] = uuid.uuid4().hex[:8]
        seen.add(cell["id"])
    return notebook


def store(run: Run) -> None:
    """Atomically replaces the original notebook by the executed one."""
    run.notebook.metadata |= nbformat.from_dict(METADATA)
    run.notebook.metadata.pop("widgets", None)
    text = nbformat.writes(run.notebook)
    write_text(run.path, text if text.endswith("\n") else text + "\n")


def title(notebook: nbformat.NotebookNode) -> str:
    """Returns the first heading of a notebook, or "untitled"."""
    prose = (cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    found = re.search(r"^# (.+)$", "\n".join(prose), re.MULTILINE)
    return found[1].strip() if found else "untitled"


def environment() -> dict[str, str]:
    """The environment of a kernel: one core unless set otherwise, no progress bars or warnings."""
    settled = {"COTLEARN_PROGRESS": "0", "PYDEVD_DISABLE_FILE_VALIDATION": "1"}
    return {"OMP_NUM_THREADS": "1", **os.environ, **settled}


def kernel_manager() -> AsyncKernelManager:
    """Starts kernels of the current Python, whichever others are registered."""
    # Without folders, there is no other.
    specs = KernelSpecManager(kernel_dirs=[])
    manager = AsyncKernelManager(kernel_name="python3", kernel_spec_manager=specs)
    # Newer kernels warn about a connection without encryption, and newer managers can encrypt.
    if manager.has_trait("transport_encryption") and zmq.has("curve"):
        manager.transport_encryption = "auto"
    return manager


def _outputs(cell: nbformat.NotebookNode, kind: str) -> str:
    """A cell's printed text (kind "stdout") or its traceback (kind "error")."""
    outputs = [item for item in cell.outputs if kind in (item.get("name"), item.output_type)]
    return "\n".join(item.get("text") or "\n".join(item.traceback) for item in outputs)
