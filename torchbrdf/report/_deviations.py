"""What a report shows of the posterior: standard deviations of pictures and of a curve."""

from dataclasses import dataclass
from math import radians

import torch
from torch import Tensor

from torchbrdf.brdf import GRID, N_CELLS, MaterialLibrary, cell_centres
from torchbrdf.estimation import Reconstruction
from torchbrdf.light import LightProbe
from torchbrdf.rendering import render_basis
from torchbrdf.report._description import BESIDE_DEG
from torchbrdf.transport import BasisImages
from torchbrdf.transport.harmonic import is_precomputed
from torchbrdf.view import SphereView

_SPREAD_SIZE, _SPREAD_SAMPLES = 48, 256
"""Of the basis images under another light, which the standard deviation needs; samples where they have to be drawn."""

_HIGHLIGHT_DEG = 6.0
"""theta_h within which f_r is averaged to tell a highlight: the normals of three pixels of a ball 64 across."""


@dataclass(frozen=True, eq=False)
class Spread:
    """What the photograph leaves open, as standard deviations of the posterior.

    observed  (1, H, W)  of the picture under the photograph's light, relative to it
    novel     (1, M, M)  of a sphere under another light, relative to it
    curve     (90, 3)    of f_r over theta_h at theta_d = 0, mean over phi_d, in 1/sr
    highlight  (2, 3)    how much brighter f_r is there in the middle than beside, see `highlight_row`; its deviation
    typical   RMS of the deviation of the sphere over that of its radiance
    """

    observed: Tensor
    novel: Tensor
    curve: Tensor
    highlight: Tensor
    typical: float


def gather_spread(
    result: Reconstruction,
    fitted: Tensor,
    basis: BasisImages,
    library: MaterialLibrary,
    probe: LightProbe,
    size: int,
) -> Spread:
    """Standard deviations under the light of the basis images, under a probe, and of the curve over theta_h.

    fitted  (3, H, W)  Y w
    size    pixels along a side of the sphere under the probe, at most
    """
    samples = None if is_precomputed(library) else _SPREAD_SAMPLES
    others = render_basis(library, probe, SphereView(min(size, _SPREAD_SIZE)), samples=samples)
    radiance = others.pack(others.render(result.weights.detach().to(others.packed))).cpu()
    deviation = others.pack(result.image_std(others).cpu())
    rows = retroreflection_rows(library)
    curve, lobe = result.posterior.std(rows).T, highlight_row(rows)
    brighter = (lobe @ result.weights.detach().cpu().double(), result.posterior.std(lobe).T[0].cpu())
    return Spread(
        observed=relative_spread(result.image_std(basis).cpu(), fitted),
        novel=others.unpack(relative_spread(deviation, radiance)),
        curve=curve.cpu(),
        highlight=torch.stack([each.reshape(3) for each in brighter]),
        typical=float(deviation.norm() / radiance.norm()),
    )


def relative_spread(deviation: Tensor, radiance: Tensor) -> Tensor:
    """(1, ...): the length of the deviation (3, ...) over that of the radiance; 0 where that is black."""
    size = radiance.double().norm(dim=0, keepdim=True)
    return torch.where(size > 0, deviation.double().norm(dim=0, keepdim=True) / torch.where(size > 0, size, 1), 0)


def retroreflection_rows(library: MaterialLibrary) -> Tensor:
    """(90, n) float64: every basis BRDF over theta_h in the first row of theta_d, mean over phi_d."""
    cells = torch.arange(0, N_CELLS, GRID[1] * GRID[2])[:, None] + torch.arange(GRID[2])
    return library.rows(cells.ravel(), keep=False).unflatten(0, (GRID[0], GRID[2])).mean(1).cpu().double()


def highlight_row(rows: Tensor) -> Tensor:
    """(1, n): how much brighter curves (90, n) over theta_h are in the highlight, mean by solid angle, than beside it.

    Pixels average over angles like its, so a photograph tells this where it cannot tell a peak in its middle.
    """
    theta_h = cell_centres()[0].ravel().double()
    inside = (theta_h < radians(_HIGHLIGHT_DEG)) * torch.sin(theta_h) * theta_h.sqrt()  # cells widen as theta_h^1/2
    beside = ((theta_h > radians(BESIDE_DEG[0])) & (theta_h < radians(BESIDE_DEG[1]))).double()
    return ((inside / inside.sum() - beside / beside.sum()) @ rows)[None]
