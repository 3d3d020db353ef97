"""Eigenvalues side by side are torch's own."""

import pytest
import torch

from torchbrdf.estimation.eigenpairs import eigh


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("batch", [(), (1,), (3,), (5, 3)])
def test_the_same_as_of_torch_whatever_the_batch_and_the_threads(batch, threads):
    rows = torch.randn(*batch, 12, 20, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    matrices = rows @ rows.mT
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        values, vectors = eigh(matrices)
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(values, torch.linalg.eigvalsh(matrices))
    torch.testing.assert_close(vectors * values[..., None, :] @ vectors.mT, matrices)


def test_only_the_lower_triangle_is_read():
    lower = torch.tensor([[2.0, float("nan")], [1.0, 3.0]], dtype=torch.float64).expand(4, 2, 2)
    values, _ = eigh(lower)
    torch.testing.assert_close(values.sum(-1), torch.full((4,), 5.0, dtype=torch.float64))
