"""Take the README's figure out of the executed notebook that made it.

python docs/figures/extract.py
"""

import base64
import json
from pathlib import Path

HERE = Path(__file__).resolve().parent
FIGURES = {"one_step.png": ("00_start_here.ipynb", "Six panels of samples.")}


def main() -> None:
    """Write every figure next to this file."""
    for name, (notebook, alt) in FIGURES.items():
        cells = json.loads((HERE.parents[1] / "notebooks" / notebook).read_text("utf-8"))["cells"]
        [cell] = [c for c in cells if c["metadata"].get("alt", "").startswith(alt)]
        [png] = [o["data"]["image/png"] for o in cell["outputs"] if "data" in o]
        (HERE / name).write_bytes(base64.b64decode(png))
        print(f"{name} from {notebook}")


if __name__ == "__main__":
    main()
