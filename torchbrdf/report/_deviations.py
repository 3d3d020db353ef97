"""What a report shows of the posterior: standard deviations of pictures and of a curve."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.brdf import GRID, MaterialLibrary
from torchbrdf.estimation import Reconstruction
from torchbrdf.light import LightProbe
from torchbrdf.rendering import render_basis
from torchbrdf.transport import BasisImages
from torchbrdf.transport.harmonic import is_precomputed
from torchbrdf.view import SphereView

_SPREAD_SIZE, _SPREAD_SAMPLES = 48, 256
"""Of the basis images under another light, which the standard deviation needs; samples where they have to be drawn."""


@dataclass(frozen=True, eq=False)
class Spread:
    """What the photograph leaves open, as standard deviations of the posterior.

    observed  (1, H, W)  of the picture under the photograph's light, relative to it
    novel     (1, M, M)  of a sphere under another light, relative to it
    curve     (90, 3)    of f_r over theta_h at theta_d = 0, mean over phi_d, in 1/sr
    typical   RMS of the deviation of the sphere over that of its radiance
    """

    observed: Tensor
    novel: Tensor
    curve: Tensor
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
    radiance = torch.einsum("ns,nsp->sp", result.weights.detach().to(others.packed), others.packed).cpu()
    deviation = others.pack(result.image_std(others).cpu())
    curve = result.posterior.std(retroreflection_rows(library)).T
    return Spread(
        observed=relative_spread(result.image_std(basis).cpu(), fitted),
        novel=others.unpack(relative_spread(deviation, radiance)),
        curve=curve.cpu(),
        typical=float(deviation.norm() / radiance.norm()),
    )


def relative_spread(deviation: Tensor, radiance: Tensor) -> Tensor:
    """(1, ...): the length of the deviation (3, ...) over that of the radiance; 0 where that is black."""
    size = radiance.double().norm(dim=0, keepdim=True)
    return torch.where(size > 0, deviation.double().norm(dim=0, keepdim=True) / torch.where(size > 0, size, 1), 0)


def retroreflection_rows(library: MaterialLibrary) -> Tensor:
    """(90, n) float64: every basis BRDF over theta_h in the first row of theta_d, mean over phi_d."""
    columns = library.stored.columns.view(*GRID, -1)[:, 0].float().mean(1).cpu().double()
    return (columns * library.stored.scale)[:, library.column_index]
