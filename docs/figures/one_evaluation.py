"""Make docs/figures/one_evaluation.gif: two robots, one network evaluation for each decision.

    python docs/figures/one_evaluation.py

Three shipped policies push the T, and three lead the arm past the pillar, from the same starts and
with the same noise: the first three episodes of each robot, none selected.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import torch
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from cotlearn import plots
from cotlearn.assets import find_data
from cotlearn.plots.style import readable
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import EXPLORATION, rollout
from cotlearn.robots.push_t import coverage
from cotlearn.robots.push_t.rasteriser import rasterise

TARGET = Path(__file__).resolve().with_suffix(".gif")
#: Two couplings that ignore the condition, and the best conditional one that ships.
METHODS = ("independent", "minibatch_ot", "residual")
STARTS = 3
EVERY = {"push_t": 10, "arm_ring": 3}  #: control steps between two frames
WIDE, TALL, LINE, GAP = 204, 153, 17, 6  #: pixels
COLOURS, FRAMES_A_SECOND, STILL = 96, 8, 6  #: of a start, after its end

Play = list[list[tuple[NDArray[np.uint8], str]]]  #: for each start its frames, with a line of text


def policy(robot: str, method: str) -> ChunkPolicy:
    """A shipped policy that samples with one evaluation."""
    made = ChunkPolicy.load(find_data(f"weights/{robot}_{method}.safetensors"))
    return made.with_sampler(replace(made.sampler, nfe=1))


def push_t(method: str) -> Play:
    """The first episodes of the T."""
    run = rollout(policy("push_t", method), episodes=STARTS, record=True, progress=False)
    assert run.states is not None
    play: Play = []
    for states in run.states[:: EVERY["push_t"]].swapaxes(0, 1):
        pictures = rasterise(states, size=WIDE).numpy()
        best = np.maximum.accumulate([float(coverage(state[2:])) for state in states])
        play.append([(p, f"best: {b:.0%} covered") for p, b in zip(pictures, best, strict=True)])
    return play


def arm_ring(method: str) -> Play:
    """The first episodes of the arm."""
    env = gymnasium.make("cotlearn/ArmRing-v0", render_mode="rgb_array", width=WIDE, height=TALL)
    driver = policy("arm_ring", method)
    noise = driver.noise(STARTS, torch.Generator().manual_seed(0))
    play: Play = []
    for k in range(STARTS):
        (state, info), over, frames = env.reset(seed=EXPLORATION + k), False, []
        for step, action in enumerate(driver.act(state[None, None], noise=noise[:, [k]])[0]):
            if not over:
                *_, over, _, info = env.step(action)
            if step % EVERY["arm_ring"] == 0 or step == driver.execute - 1:
                words = "hits the pillar" if info["collision"] else "on its way"
                frames.append((env.render(), "reaches the goal" if info["success"] else words))
        play.append(frames)
    return play


def side_by_side(plays: Sequence[Play], start: int) -> list[NDArray[np.uint8]]:
    """Frames of one start: a row for each robot, a column for each method."""
    columns = [play[start] for play in plays]
    length = max(map(len, columns))
    panels = [
        [panel(title, *frame) for frame in column + column[-1:] * (STILL + length - len(column))]
        for title, column in zip(METHODS * 2, columns, strict=True)
    ]
    half = len(panels) // 2
    moments = zip(*panels, strict=True)
    return [np.vstack([np.hstack(now[:half]), np.hstack(now[half:])]) for now in moments]


def panel(method: str, picture: NDArray[np.uint8], words: str) -> NDArray[np.uint8]:
    """A picture between the name of its method and a line of text."""
    high = len(picture) + 2 * LINE + GAP
    image = Image.new("RGB", (WIDE + GAP, high), "white")
    image.paste(Image.fromarray(picture), (GAP // 2, LINE))
    pen = ImageDraw.Draw(image)
    bold, plain = (font_manager.FontProperties(weight=w) for w in ("bold", "regular"))
    lines = ((0, plots.label_of(method), bold, plots.COLORS[method]),)
    for top, text, weight, colour in (*lines, (high - LINE - GAP, words, plain, "#333333")):
        font = ImageFont.truetype(font_manager.findfont(weight), 12)
        pen.text((WIDE / 2, top + 1), text, fill=readable(colour), font=font, anchor="ma")
    return np.asarray(image)


def main() -> None:
    """Write the film."""
    plays = [show(method) for show in (push_t, arm_ring) for method in METHODS]
    frames = [frame for start in range(STARTS) for frame in side_by_side(plays, start)]
    # one palette for all frames: nothing flickers, and what stands still costs nothing
    palette = Image.fromarray(np.hstack(frames[::10])).quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
    first, *others = (
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    )
    lasts = round(1000 / FRAMES_A_SECOND)
    first.save(TARGET, save_all=True, append_images=others, duration=lasts, loop=0, optimize=False)
    print(f"{TARGET.name}: {len(frames)} frames, {TARGET.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
