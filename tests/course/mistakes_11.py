"""Wrong answers to the exercises of notebook 11, words of their hints, right ones."""

import torch

from cotlearn.flows.networks import SpatialSoftmax


def mean_place(share):
    right, down = torch.linspace(-1, 1, share.shape[2]), torch.linspace(-1, 1, share.shape[1])
    return torch.stack([share.sum(dim=1) @ right, share.sum(dim=2) @ down], dim=1)


def place(h):
    return mean_place(h.flatten(1).softmax(dim=1).view_as(h))


def strongest(h):
    return mean_place((h == h.amax(dim=(1, 2), keepdim=True)).float())


def in_cells(h):
    sides = torch.tensor([h.shape[2], h.shape[1]])
    return (place(h) + 1) / 2 * (sides - 1)


def components(pixels, mean, basis):
    return (pixels - mean) @ basis.T


def inside(label, value):
    off = [value[label == k] - value[label == k].mean(dim=0) for k in label.unique()]
    return torch.cat(off).square().sum(dim=1).mean()


def by_position(label, value):
    mean = torch.stack([value[label == k].mean(dim=0) for k in label.unique()])
    return (value - mean[label]).square().sum(dim=1).mean()


def whole(label, value):
    return (value - value.mean(dim=0)).square().sum(dim=1).mean()


def uncentred(x0, m):
    size = x0.shape[1] * m.square().sum(dim=1).mean()
    return (x0 * m).sum(dim=1).mean() / size.sqrt()


def correlation(x0, m):
    return uncentred(x0, m - m.mean(dim=0))


MISTAKES = [
    ("11.place", lambda h: place(h).flip(1), "changed places"),
    ("11.place", strongest, "not the mean places"),
    ("11.place", mean_place, "not shares yet"),
    ("11.place", lambda h: mean_place(h.flatten().softmax(0).view_as(h)), "over its cells only"),
    ("11.place", in_cells, "from -1"),
    ("11.place", lambda h: place(h).T, "must have shape (5, 2)"),
    ("11.place", lambda h: -place(h), "not the mean places"),
    ("11.place", 3, "expected a function"),
    ("11.components", lambda p, m, b: (p - p.mean(dim=0)) @ b.T, "slip of the published code"),
    ("11.components", lambda p, m, b: p @ b.T, "subtract the fitted mean first"),
    ("11.components", lambda p, m, b: (p + m) @ b.T, "not added"),
    ("11.components", lambda p, m, b: (m - p) @ b.T, "not mean minus pixels"),
    ("11.components", lambda p, m, b: p - m, "must have shape (6, 3)"),
    ("11.components", lambda p, m, b: 2 * components(p, m, b), "expected [["),
    ("11.components", lambda p, m, b: (p - m) @ b, "raised RuntimeError"),
    ("11.inside", whole, "own cluster"),
    ("11.inside", lambda k, v: len(v) * inside(k, v), "not the total"),
    ("11.inside", lambda k, v: inside(k, v) / 2, "the sum over coordinates"),
    ("11.inside", lambda k, v: whole(k, v) - inside(k, v), "expected"),
    ("11.inside", by_position, "raised IndexError"),
    ("11.correlation", lambda x0, m: correlation(x0, m) * (x0.shape[1] / 3) ** 0.5, "expected"),
    ("11.correlation", uncentred, "the average of m"),
    ("11.correlation", lambda x0, m: 3**0.5 * correlation(x0, m), "d is missing"),
    ("11.correlation", lambda x0, m: correlation(x0, m) / 3, "a sum over columns"),
    ("11.correlation", lambda x0, m: correlation(x0, m).square(), "expected"),
    ("11.correlation", lambda x0, m: x0, "return one number"),
]


RIGHT = [
    ("11.place", place),
    ("11.place", lambda h: SpatialSoftmax()(h[:, None])),
    ("11.components", components),
    ("11.components", lambda p, m, b: torch.einsum("np,kp->nk", p - m, b)),
    ("11.inside", inside),
    ("11.correlation", correlation),
]
