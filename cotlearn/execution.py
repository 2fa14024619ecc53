"""Executes notebooks without a browser, in the Python that this package is installed in."""

from __future__ import annotations

import html
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import nbformat
import zmq
from ipykernel.kernelspec import get_kernel_dict
from jupyter_client.kernelspec import KernelSpec, KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

from cotlearn.claims import count_claims
from cotlearn.files import write_text

#: Called after each code cell with (code cells done, code cells in all, seconds so far).
Progress = Callable[[int, int, float], None]


@dataclass(frozen=True)
class Failure:
    """The cell at which a notebook stopped."""

    #: Position among all cells of the notebook, counted from 0.
    index: int
    source: str
    traceback: str


@dataclass(frozen=True)
class Run:
    """What happened when a notebook was executed."""

    path: Path
    notebook: nbformat.NotebookNode
    seconds: float
    claims: int
    failure: Failure | None


def execute(path: Path, *, timeout: int = 300, progress: Progress | None = None) -> Run:
    """Executes a notebook from top to bottom in a fresh kernel.

    The kernel is the Python that runs this function, whatever kernels are registered on the
    machine. Progress bars inside the notebook are off (`COTLEARN_PROGRESS=0`), and it computes
    on one core unless `OMP_NUM_THREADS` says otherwise: the course's networks are so small that
    threads spend more time on waiting for each other than they save.

    Args:
        path: The notebook; it is read, not changed.
        timeout: Most seconds for one cell; at least 1.
        progress: Called after each code cell.

    Returns:
        The executed notebook, the time it took, the claims that held and the failure, if any.

    Raises:
        ValueError: If `path` is not a notebook that can be read, or `timeout` is below 1.
    """
    if timeout < 1:
        raise ValueError(f"timeout must be at least 1 second, got {timeout}")
    notebook = read(path)
    code = [i for i, cell in enumerate(notebook.cells) if cell.cell_type == "code"]
    start = time.perf_counter()
    current = code[0] if code else 0
    done = 0

    def on_start(cell: nbformat.NotebookNode, cell_index: int) -> None:
        nonlocal current
        current = cell_index

    def on_end(cell: nbformat.NotebookNode, cell_index: int, execute_reply: object) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, len(code), time.perf_counter() - start)

    client = NotebookClient(
        notebook,
        km=_kernel_manager(),
        timeout=timeout,
        record_timing=False,
        store_widget_state=False,
        resources={"metadata": {"path": str(path.resolve().parent)}},
        on_cell_execute=on_start,
        on_cell_executed=on_end,
    )
    error: str | None = None
    with _environment(
        COTLEARN_PROGRESS="0",
        OMP_NUM_THREADS=os.environ.get("OMP_NUM_THREADS", "1"),
        PYDEVD_DISABLE_FILE_VALIDATION="1",
    ):
        try:
            if code:
                client.execute(cleanup_kc=True)  # ends the kernel, whatever happens
        except CellExecutionError as raised:
            error = _traceback(notebook.cells[current]) or str(raised)
        except CellTimeoutError:
            error = f"The cell ran for longer than {timeout} seconds and was stopped."
        except DeadKernelError:
            if hasattr(client, "_async_cleanup_kernel_future"):  # nbclient's mark of a Ctrl-C
                raise KeyboardInterrupt from None
            error = "The kernel died while it ran this cell (out of memory?)."
    failure = error and Failure(current, notebook.cells[current].source, error)
    return Run(
        path=path,
        notebook=notebook,
        seconds=time.perf_counter() - start,
        claims=sum(count_claims(_printed(notebook.cells[i])) for i in code),
        failure=failure or None,
    )


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
        return nbformat.read(path, as_version=4)
    except FileNotFoundError:
        raise ValueError(f"there is no notebook at {path}") from None
    except (nbformat.reader.NotJSONError, nbformat.ValidationError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not a readable notebook: {str(error)[:200]}") from error


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
    from nbconvert import HTMLExporter  # takes half a second, and most runs do without

    folder.mkdir(parents=True, exist_ok=True)
    exporter = HTMLExporter()
    body, _ = exporter.from_notebook_node(
        run.notebook, resources={"metadata": {"name": run.path.stem}}
    )
    page = folder / f"{run.path.stem}.html"
    # Links between notebooks become links between pages.
    for other in run.path.parent.glob("*.ipynb"):
        body = body.replace(f'href="{other.name}', f'href="{other.stem}.html')
    write_text(page, body)
    return page


def write_index(runs: list[Run], folder: Path) -> Path:
    """Writes a page that links to the pages of `runs`, with time and claims of each."""
    rows = "\n".join(
        f'<tr><td><a href="{html.escape(run.path.stem)}.html">'
        f"{html.escape(title(run.notebook))}</a></td>"
        f"<td>{run.seconds:.0f} s</td><td>{run.claims}</td>"
        f"<td>{'stopped at cell ' + str(run.failure.index) if run.failure else 'ran'}</td></tr>"
        for run in runs
    )
    page = folder / "index.html"
    write_text(
        page,
        f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>cotlearn</title>
<style>body {{ font: 16px/1.5 sans-serif; max-width: 46rem; margin: 3rem auto; padding: 0 1rem }}
table {{ border-collapse: collapse; width: 100% }} td, th {{ text-align: left; padding: .3rem .6rem;
border-bottom: 1px solid #ccc }}</style></head>
<body><h1>cotlearn</h1>
<table><tr><th>Notebook</th><th>Time</th><th>Claims that hold</th><th></th></tr>
{rows}
</table></body></html>
""",
    )
    return page


def title(notebook: nbformat.NotebookNode) -> str:
    """Returns the first heading of a notebook, or "untitled"."""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            for line in cell.source.splitlines():
                if line.startswith("# "):
                    return str(line[2:].strip())
    return "untitled"


class _OwnKernel(KernelSpecManager):
    """Knows one kernel, the Python that runs now, so that no other on the machine can get in."""

    def get_kernel_spec(self, kernel_name: str) -> KernelSpec:
        return KernelSpec(**get_kernel_dict())  # names sys.executable


def _kernel_manager() -> AsyncKernelManager:
    manager = AsyncKernelManager(kernel_name="python3", kernel_spec_manager=_OwnKernel())
    # Newer kernels warn about a connection without encryption, and newer managers can encrypt.
    if manager.has_trait("transport_encryption") and zmq.has("curve"):
        manager.transport_encryption = "auto"
    return manager


@contextmanager
def _environment(**values: str) -> Iterator[None]:
    before = {key: os.environ.get(key) for key in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value


def _printed(cell: nbformat.NotebookNode) -> str:
    streams = (output for output in cell.get("outputs", []) if output.output_type == "stream")
    return "".join(output.text for output in streams if output.name == "stdout")


def _traceback(cell: nbformat.NotebookNode) -> str:
    errors = [output for output in cell.get("outputs", []) if output.output_type == "error"]
    return "\n".join("\n".join(output.traceback) for output in errors)
