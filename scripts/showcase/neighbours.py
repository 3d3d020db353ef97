"""Who is near whom in a library: distances of all pairs of materials, as `torchbrdf compare` has them."""

import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.brdf import METRICS, N_CELLS, ROW_CELLS, cell_measure, incident_cosine, unpacked

METRIC = "cube-root"
"""Of `METRICS`: highlights count, and what lies around them, and dark materials."""


def distances(library: tb.MaterialLibrary) -> Tensor:
    """(m, m) float64: `cell_difference` in METRIC of material j from material i as the reference, row i, column j.

    |m(f_j cos) - m(f_i cos)| / |m(f_i cos)| over the cells measured in both.
    """
    m = len(library)
    measured = unpacked(library.stored.valid[list(library.materials)]).T
    cosine, measure = incident_cosine().ravel(), cell_measure().ravel()
    own, common = (torch.zeros(m, m, dtype=torch.float64) for _ in range(2))
    for start in range(0, N_CELLS, ROW_CELLS):
        cells = torch.arange(start, start + ROW_CELLS)
        cells = cells[measure[cells] > 0]
        there = measured[cells].double()
        f_r = library.rows(cells).clamp_min(0).unflatten(1, (m, 3))
        mapped = METRICS[METRIC](f_r * cosine[cells, None, None].float())  # float32, as stored; sums are not
        mapped = mapped * (there * measure[cells, None].sqrt())[..., None]
        own += mapped.square().sum(2).T @ there  # |m(f_i)|^2 over the cells of both i and j
        flat = mapped.transpose(1, 2).flatten(0, 1)
        common += flat.T @ flat
    squared = (own + own.T - 2 * common).clamp_min(0)
    return (squared / own).sqrt()


def nearest(distances: Tensor, position: int, count: int) -> list[tuple[int, float]]:
    """The materials nearest to one, the nearest first, with how far they are."""
    row = distances[position].clone()
    row[position] = torch.inf
    found = torch.topk(row, min(count, len(row) - 1), largest=False)
    return list(zip(found.indices.tolist(), found.values.tolist(), strict=True))
