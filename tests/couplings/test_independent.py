import torch

from cotlearn.couplings import Independent


def test_row_meets_row():
    x0, x1, c = torch.randn(5, 2), torch.randn(5, 2), torch.randn(5, 3)
    pairs = Independent()(x0, x1, c)
    assert torch.equal(pairs.x0, x0)
    assert torch.equal(pairs.x1, x1)
    assert torch.equal(pairs.c, c)
    assert torch.equal(pairs.source_index, torch.arange(5))
    assert torch.equal(pairs.target_index, torch.arange(5))
    assert Independent()(x0, x1).c is None
    assert Independent.name == "independent"
