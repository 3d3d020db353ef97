"""Lookups that share their work among cores."""

import pytest
import torch
from torch.nn.functional import grid_sample

from torchbrdf.transport.harmonic._bilinear import bilinear


@pytest.mark.parametrize("rows", [1, 4, 7])
def test_is_a_lookup_in_one_picture(rows: int) -> None:
    generator = torch.Generator().manual_seed(0)
    texels = torch.rand(3, 5, 9, generator=generator)
    places = torch.rand(rows, 6, 2, generator=generator) * 2 - 1
    expected = grid_sample(texels[None], places[None], align_corners=True)[0]
    torch.testing.assert_close(bilinear(texels, places), expected)
