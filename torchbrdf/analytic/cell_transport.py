"""The transport of a probe and a view as one sparse matrix from cells to pixels, for BRDFs that change often.

`transport.render` looks a table up at samples. Here the samples are drawn once and summed by cell, so that a BRDF that
is a function of angles is evaluated once for each cell, and rendered, and differentiated, by sparse products. A model
changes slowly with phi_d: cells are widened to _WIDTH of MERL's, at the mean phi_d of the samples in them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf.analytic.catalogue import model_of
from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.arguments import check_types
from torchbrdf.brdf import GRID, N_CELLS, MerlTable, above_horizon, cell_centres, mirrored_cells, nearest_measured
from torchbrdf.lasting import lasting
from torchbrdf.light import LightProbe
from torchbrdf.transport import plan_transport
from torchbrdf.view import View

if TYPE_CHECKING:  # it takes 0.2 s, which `import torchbrdf` need not wait
    from scipy.sparse import csr_array

SAMPLES = 1024
"""Samples a pixel, on average."""

_WIDTH = 15
"""Cells of MERL's along phi_d, folded at 90 degrees, in one of ours; a divisor of 90. Narrower ones gain nothing."""

_ROUGHNESSES = (0.02, 0.06, 0.2, 0.5)
"""Of the lobes for which pixels and light are sampled."""


@dataclass(frozen=True, eq=False)
class CellTransport:
    """Pixels as sums over cells: radiance = matrix f_r, for each channel.

    cells     (M,)  flat MERL cells, that at the mean phi_d of each of ours
    geometry  of the pairs of directions of our M cells
    matrices  three (P, M), in sr times the radiance of the light
    view      whose P pixels they are
    probe     fingerprint of the light
    """

    cells: Tensor
    geometry: ShadingGeometry
    matrices: "tuple[csr_array, csr_array, csr_array]"
    view: View
    probe: str

    @classmethod
    @lasting
    def build(cls, probe: LightProbe, view: View, samples: int = SAMPLES, seed: int = 0) -> "CellTransport":
        """Draw the samples and sum them by cell; reciprocal BRDFs only, as phi_d is folded."""
        from scipy.sparse import coo_array

        check_types("CellTransport.build", probe=(probe, LightProbe), view=(view, View))
        plan = plan_transport(_typical_columns(), probe, view, samples, seed)
        parts = [
            (chosen.repeat_interleave(drawn.cells.shape[1]), drawn.cells.ravel(), drawn.weights.flatten(1))
            for chosen, drawn in plan.blocks()
        ]
        pixels, cells, weights = (torch.cat(part, dim=-1) for part in zip(*parts, strict=True))
        lit = (weights > 0).any(0)
        pixels, weights = pixels[lit], weights[:, lit] * plan.sampler.strata.unit
        cells = nearest_measured(above_horizon())[cells[lit].long()]
        phi_d = cells % GRID[2]
        phi_d = torch.minimum(phi_d, GRID[2] - 1 - phi_d)
        wide = (cells // GRID[2]) * (GRID[2] // 2 // _WIDTH) + phi_d // _WIDTH
        used, column = torch.unique(wide, return_inverse=True)
        total = weights.sum(0).double()
        mean = torch.zeros(len(used), dtype=torch.float64).index_add_(0, column, total * phi_d)
        mean /= torch.zeros_like(mean).index_add_(0, column, total)
        rows = torch.div(used, GRID[2] // 2 // _WIDTH, rounding_mode="floor")
        theta_h, theta_d, _ = cell_centres()
        angles = theta_h.ravel()[rows // GRID[1]], theta_d.ravel()[rows % GRID[1]], (mean + 0.5) * (pi / GRID[2])
        shape, place = (len(view.pixels), len(used)), (pixels.numpy(), column.numpy())
        red, green, blue = (coo_array((weight.numpy(), place), shape).tocsr() for weight in weights)
        middle = rows * GRID[2] + mean.round().long()
        return cls(middle, ShadingGeometry.of_angles(*angles), (red, green, blue), view, probe.fingerprint)

    def values(self, table: MerlTable) -> Tensor:
        """(M, 3): f_r of a table in our cells, the mean of MERL's cell and of that at 180 degrees - phi_d."""
        filled = table.filled.detach().cpu()
        return (filled[self.cells] + filled[mirrored_cells(self.cells)]) / 2

    def render(self, f_r: Tensor) -> Tensor:
        """(*batch, P, 3) radiance of f_r (*batch, M, 3) in 1/sr, float32; differentiable."""
        return _Product.apply(f_r.float(), self.matrices)


class _Product(torch.autograd.Function):
    """The matrices' products, channel by channel. SciPy's, as those of torch take a hundred times as long backwards."""

    @staticmethod
    def forward(ctx: Any, f_r: Tensor, matrices: "Sequence[csr_array]") -> Tensor:
        ctx.matrices = matrices
        return _multiply(matrices, f_r)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        return _Product.apply(gradients[0], [matrix.T for matrix in ctx.matrices]), None


def _multiply(matrices: "Sequence[csr_array]", values: Tensor) -> Tensor:
    """(*batch, rows, 3) of values (*batch, columns, 3)."""
    flat = values.detach().reshape(-1, *values.shape[-2:]).numpy()
    products = [matrix @ np.ascontiguousarray(flat[..., c].T) for c, matrix in enumerate(matrices)]
    return torch.from_numpy(np.stack(products)).permute(2, 1, 0).reshape(*values.shape[:-2], matrices[0].shape[0], 3)


def _typical_columns() -> Tensor:
    """(N_CELLS, n) float32: a diffuse column and lobes, which say where samples are needed."""
    model, whole = model_of("ggx"), ShadingGeometry.of_angles(*cell_centres(torch.float32))
    colours = [(0.5, 0.0, 0.3), *((0.0, 0.04, roughness) for roughness in _ROUGHNESSES)]
    columns = [
        model.evaluate(dict(zip(model.defaults, values.split(1), strict=True)), whole)
        for values in torch.tensor(colours, dtype=torch.float32)
    ]
    return torch.stack([column[..., 0].reshape(N_CELLS) for column in columns], dim=1)
