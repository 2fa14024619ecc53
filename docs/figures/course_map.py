"""Draw docs/figures/course_map.svg: the notebooks as a path, with its side rooms and two routes.

    python docs/figures/course_map.py

Titles are read from the notebooks, so a new one joins: on the path if it is not in `BESIDE`.
"""

import json
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).resolve().parents[2]
TARGET = Path(__file__).resolve().with_suffix(".svg")
#: On the evening's route, and which part of it; empty: all.
EVENING = {
    "00": "",
    "01": "",
    "02": "",
    "03": "sections 1 to 4",
    "04": "sections 1 to 4",
    "07": "",
    "08": "",
}
WEEKS = {"1": ("00", "02"), "2": ("03", "04"), "3": ("07", "10"), "4": ("11", "99")}
#: What stands beside the path, next to which notebook, and the question that it answers.
BESIDE = {
    "05": ("04", "should the model choose?"),
    "06": ("07", "can one evaluation be exact?"),
    "extras": ("02", "a related work each"),
    "laboratory": ("08", "all methods, ablations"),
}
BLUE, INK, PALE, GREY = "#0b5ea8", "#222222", "#eef4fa", "#666666"
WIDE, STEP, HIGH = 4.6, 0.62, 0.46  #: inches: of the map, between two boxes, of a box
LEFT, RIGHT = (0.5, 2.42), (2.62, 4.55)  #: edges of the two columns


def titles() -> dict[str, str]:
    """Number -> title of every numbered notebook; folders of others by their name."""
    found = {}
    for path in sorted((ROOT / "notebooks").glob("[0-9][0-9]_*.ipynb")):
        first = json.loads(path.read_text("utf-8"))["cells"][0]["source"]
        number, title = "".join(first).splitlines()[0].removeprefix("# ").split(" · ")
        found[number] = title
    for name, words in (("extras", "Extras"), ("laboratory", "Laboratory")):
        count = len(list((ROOT / "notebooks" / name).glob("*.ipynb")))
        if count:
            found[name] = f"{words}: {count} notebooks"
    return found


def described() -> str:
    """All rooms in words, which the figure stores."""
    return "; ".join(f"{name} {title}" for name, title in titles().items())


def route() -> str:
    """The evening's route in words, as pages quote it."""
    stops = [f"{part} of {number}" if part else number for number, part in EVENING.items()]
    return f"{', '.join(stops[:-1])} and {stops[-1]}"


def height() -> float:
    """The height of the map, in inches."""
    return 0.85 + STEP * sum(name not in BESIDE for name in titles())


def heights() -> dict[str, float]:
    """Name of a room -> the height of its middle, in inches."""
    rooms = titles()
    path = [name for name in rooms if name not in BESIDE]
    found = {name: height() - 0.82 - STEP * k for k, name in enumerate(path)}
    return found | {name: found[beside] for name, (beside, _) in BESIDE.items() if name in rooms}


def boxes() -> dict[str, tuple[float, float, float, float]]:
    """Name of a room -> left, top, width and height of its box, as shares of the map."""
    found = {}
    for name, y in heights().items():
        left, right = RIGHT if name in BESIDE else LEFT
        top, size = (height() - y - HIGH / 2) / height(), HIGH / height()
        found[name] = (left / WIDE, top, (right - left) / WIDE, size)
    return found


def box(ax: Axes, across: tuple[float, float], y: float, lines: tuple[str, str], on: bool) -> None:
    """A room: a rounded box with a title and a smaller line; filled if `on`."""
    left, right = across
    look = {"boxstyle": "round,pad=0,rounding_size=0.07", "linewidth": 1.1}
    face = BLUE if on else PALE
    size = (right - left, HIGH)
    ax.add_patch(FancyBboxPatch((left, y - HIGH / 2), *size, fc=face, ec=BLUE, zorder=2, **look))
    colour, small = ("white", "#dbe9f6") if on else (INK, GREY)
    title, below = lines
    at = {"ha": "left", "va": "center", "zorder": 3}
    ax.text(left + 0.09, y + (0.085 if below else 0), title, color=colour, fontsize=8.8, **at)
    ax.text(left + 0.09, y - 0.11, below, color=small, fontsize=7.4, **at)


def main() -> None:
    """Write the map, with the names of all its rooms as its description."""
    fonts = ["DejaVu Sans", "sans-serif"]  # as text, which is short and can be read
    plt.rcParams.update({"svg.hashsalt": "map", "svg.fonttype": "none", "font.family": fonts})
    rooms = titles()
    path = [name for name in rooms if name not in BESIDE]
    high = height()
    figure = plt.figure(figsize=(WIDE, high))
    ax = figure.add_axes((0, 0, 1, 1), xlim=(0, WIDE), ylim=(0, high))
    ax.set_axis_off()
    place = heights()
    middle = sum(LEFT) / 2
    ax.plot([middle] * 2, [place[path[0]], place[path[-1]]], color=BLUE, lw=2.2, zorder=1)
    for name in path:
        box(
            ax,
            LEFT,
            place[name],
            (f"{name}  {rooms[name]}", EVENING.get(name, "")),
            name in EVENING,
        )
    for name, (beside, words) in BESIDE.items():
        if name in rooms:
            y = place[beside]
            ax.plot([middle, RIGHT[0]], [y, y], color=BLUE, lw=1.4, ls=(0, (2, 2)), zorder=1)
            title = f"{name}  {rooms[name]}" if name.isdigit() else rooms[name]
            box(ax, RIGHT, y, (title, words), False)
    for week, (first, last) in WEEKS.items():
        inside = [place[name] for name in path if first <= name <= last]
        ax.plot([0.34] * 2, [max(inside) + 0.22, min(inside) - 0.22], color=GREY, lw=1.6)
        words = {"rotation": 90, "ha": "center", "va": "center", "color": GREY, "fontsize": 8.4}
        ax.text(0.17, (max(inside) + min(inside)) / 2, f"week {week}", **words)
    ax.text(middle, high - 0.28, "the path", ha="center", fontsize=9.5, weight="bold", color=INK)
    ax.text(sum(RIGHT) / 2, high - 0.28, "side rooms", ha="center", fontsize=9.5, weight="bold")
    ax.add_patch(plt.Rectangle((RIGHT[0], high - 0.9), 0.16, 0.16, fc=BLUE, ec=BLUE))
    ax.text(RIGHT[0] + 0.24, high - 0.82, "in one evening", va="center", fontsize=8.4, color=INK)
    figure.savefig(TARGET, metadata={"Date": None, "Creator": None, "Description": described()})
    print(f"{TARGET.name}: {TARGET.stat().st_size / 1e3:.0f} kB; {described()}")


if __name__ == "__main__":
    main()
