"""Figures are drawn without a screen, in the course's style, and closed after each test."""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import pytest
import torch

from cotlearn import plots


@pytest.fixture(autouse=True)
def close_figures():
    with plt.rc_context():
        plots.use_style()
        yield
    plt.close("all")


@pytest.fixture
def cloud():
    g = torch.Generator().manual_seed(0)
    x0 = torch.randn(60, 2, generator=g)
    c = torch.eye(3)[torch.arange(60) % 3]
    return x0, 2 * x0 + 1, c
