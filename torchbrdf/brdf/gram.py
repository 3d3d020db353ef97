"""Gram matrices in half the time of a product."""

from itertools import pairwise

from torch import Tensor

_BLOCKS = 3
"""Of rows, each of which is multiplied with those up to its own."""


def lower_gram(rows: Tensor) -> Tensor:
    """A A^T (..., n, n) of A (..., n, P), 0 above the blocks on the diagonal: `eigh` reads the lower triangle."""
    gram = rows.new_zeros(*rows.shape[:-1], rows.shape[-2])
    edges = [rows.shape[-2] * i // _BLOCKS for i in range(_BLOCKS + 1)]
    for start, end in pairwise(edges):
        gram[..., start:end, :end] = rows[..., start:end, :] @ rows[..., :end, :].mT
    return gram
