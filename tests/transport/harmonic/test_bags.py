"""Sums of samples on nodes, beside a dense matrix."""

import torch

from torchbrdf.transport.harmonic._bags import Bags


def test_a_node_holds_its_share_of_each_sample() -> None:
    """Some nodes get none, and a sample may reach one twice."""
    generator = torch.Generator().manual_seed(0)
    node = torch.randint(0, 40, (50, 4), generator=generator, dtype=torch.int32)
    node[node % 3 == 0] = 7
    share, values = torch.rand(50, 4, generator=generator).float(), torch.rand(50, 5, generator=generator).float()
    dense = torch.zeros(45, 50).float()
    dense.index_put_((node.long().ravel(), torch.arange(50).repeat_interleave(4)), share.ravel(), accumulate=True)
    sums = Bags.of(node, share, 45).sums(values)
    assert torch.allclose(sums, dense @ values, atol=1e-6)
    assert (sums[dense.sum(1) == 0] == 0).all()
