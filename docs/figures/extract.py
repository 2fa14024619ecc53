"""Take the README's figure out of the executed notebook that made it.

python docs/figures/extract.py
"""

import base64
import io
import json
from pathlib import Path

from PIL import Image

HERE = Path(__file__).resolve().parent
FIGURES = {"one_step.png": ("00_start_here.ipynb", "Six panels of samples.")}

COLOURS = 128


def main() -> None:
    """Write every figure next to this file."""
    for name, (notebook, alt) in FIGURES.items():
        cells = json.loads((HERE.parents[1] / "notebooks" / notebook).read_text("utf-8"))["cells"]
        [cell] = [c for c in cells if c["metadata"].get("alt", "").startswith(alt)]
        [png] = [o["data"]["image/png"] for o in cell["outputs"] if "data" in o]
        picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
        few = picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        few.save(HERE / name, optimize=True)  # a third of the size
        print(f"{name} from {notebook}")


if __name__ == "__main__":
    main()
