"""The checks of notebook 11."""

from __future__ import annotations

from typing import Any

import torch

from cotlearn.homework.checks.common import compare, expect_function, tensor
from cotlearn.homework.registry import exercise


@exercise("11.place")
def place(answer: Any) -> None:
    """The mean place of a softmax over the cells of a grid."""
    expect_function(answer)
    generator = torch.Generator().manual_seed(0)
    for height, width in ((4, 4), (3, 7)):
        h = 2 * torch.randn(5, height, width, generator=generator)
        found = tensor(answer(h.clone()), (5, 2), "the places, x and y of each grid,")
        down, right = torch.linspace(-1, 1, height), torch.linspace(-1, 1, width)
        share = h.flatten(1).softmax(dim=1).view_as(h)
        columns, rows = share.sum(dim=1), share.sum(dim=2)
        mean = torch.stack([columns @ right, rows @ down], dim=1)
        largest = h.flatten(1).argmax(dim=1)
        hard = torch.stack([right[largest % width], down[largest // width]], dim=1)
        weighed = torch.stack([h.sum(dim=1) @ right, h.sum(dim=2) @ down], dim=1)
        all_at_once = h.flatten().softmax(dim=0).view_as(h)
        of_all = torch.stack([all_at_once.sum(dim=1) @ right, all_at_once.sum(dim=2) @ down], dim=1)
        cells = torch.stack(
            [columns @ torch.arange(width).float(), rows @ torch.arange(height).float()], dim=1
        )
        mistakes = [
            (mean.flip(1), "y and x have changed places: columns are x, rows are y"),
            (hard, "that is the strongest cell; its place jumps, and nothing can be learned by it"),
            (weighed, "the values are not shares yet: softmax makes them positive and sum to 1"),
            (of_all, "the shares of each grid sum to 1 by themselves: softmax over its cells only"),
            (cells, "count places from -1 (left, top) to 1 (right, bottom)"),
        ]
        compare(found, mean, mistakes, "these are not the mean places of the softmax")


@exercise("11.components")
def components(answer: Any) -> None:
    """(pixels - mean) basis^T, with the mean that was fitted."""
    expect_function(answer)
    generator = torch.Generator().manual_seed(1)
    pixels = torch.rand(6, 20, generator=generator)
    mean = torch.rand(20, generator=generator)
    basis = torch.linalg.qr(torch.randn(20, 3, generator=generator)).Q.T.contiguous()
    found = tensor(
        answer(pixels.clone(), mean.clone(), basis.clone()), (6, 3), "the components, (n, 3),"
    )
    right = (pixels - mean) @ basis.T
    mistakes = [
        (
            (pixels - pixels.mean(dim=0)) @ basis.T,
            "that centres by the batch's own mean, the slip of the published code: the same "
            "picture would have other components in another batch; use the fitted mean",
        ),
        (pixels @ basis.T, "subtract the fitted mean first"),
        ((pixels + mean) @ basis.T, "the mean is subtracted, not added"),
        ((mean - pixels) @ basis.T, "pixels minus mean, not mean minus pixels"),
        (
            (pixels - mean[:1]) @ basis.T,
            "every pixel has a mean of its own: subtract the whole vector",
        ),
    ]
    compare(found, right, mistakes, "these are not the components of the centred pixels")
