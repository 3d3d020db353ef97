"""Basis images by the backend that suits the view [CBP21, eq. 5], and tables under a light [CBP21, eq. 1]."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchbrdf.basis_images import BasisImages
from torchbrdf.harmonic_basis import HarmonicBasis
from torchbrdf.harmonic_cache import is_precomputed
from torchbrdf.library import MaterialLibrary
from torchbrdf.merl import MerlTable
from torchbrdf.mitsuba_backend.baking import bake_basis
from torchbrdf.probe import LightProbe
from torchbrdf.ring_lookup import unsuited
from torchbrdf.transport import DEFAULT_SAMPLES, render_columns, sampled_basis
from torchbrdf.view import View


def render_basis(
    library: MaterialLibrary,
    probe: LightProbe,
    view: View,
    backend: str = "auto",
    samples: int | None = None,
    seed: int = 0,
    progress: bool = False,
    adaptive: bool = True,
) -> BasisImages:
    """Images Y of every basis BRDF under a probe [CBP21, eq. 5].

    backend   "sampled"; "harmonic", precomputed once per library, some twenty times as fast, for orthographic cameras
              without shadows; "mitsuba", slower and independent, with an error estimate for every image
              (`mitsuba_backend.bake_basis`). "auto" is "harmonic" where the library's transport has been precomputed
              (`torchbrdf precompute`), the view allows it and no samples are given, else "sampled"
    samples   a pixel, on average over the view, at least 2; None for 4096. Not for "harmonic"
    adaptive  give the pixels that need it more samples than others; "sampled" only
    They run on the device that holds the library's columns. Only pixels under the view's mask are computed and only
    cells that samples touch are read. Raises ValueError for an unknown backend, too few samples, or a view that
    "harmonic" cannot take.
    """
    if backend == "auto":
        fast = samples is None and is_precomputed(library) and unsuited(view) is None
        backend = "harmonic" if fast else "sampled"
    if backend == "harmonic":
        return HarmonicBasis(library, probe, view, progress).basis_at()
    samples = DEFAULT_SAMPLES if samples is None else samples
    if backend == "mitsuba":
        return bake_basis(library, probe, view, samples, seed, progress)
    if backend == "sampled":
        return sampled_basis(library, probe, view, samples, seed, progress, adaptive)
    raise ValueError(f'backend must be "auto", "sampled", "harmonic" or "mitsuba", got {backend!r}')


def render(
    table: MerlTable, probe: LightProbe, view: View, samples: int = DEFAULT_SAMPLES, seed: int = 0
) -> Tensor:
    """Radiance (3, H, W) of a view whose material is `table`, 0 outside the mask.

    Runs on the device of the probe, as `render_basis` does but in float32.
    """
    return render_tables([table], probe, view, samples, seed)[0]


def render_tables(
    tables: Sequence[MerlTable], probe: LightProbe, view: View, samples: int = DEFAULT_SAMPLES, seed: int = 0
) -> Tensor:
    """Radiance (K, 3, H, W): `render` of several tables with one set of samples, which cost more than the lookups."""
    values = torch.cat([table.filled.to(probe.device, torch.float32) for table in tables], dim=1)
    packed = render_columns(values, probe, view, samples, seed).unflatten(2, (len(tables), 3))
    return view.unpack(torch.einsum("cpkc->kcp", packed))
