"""Basis images by the backend that suits the view [CBP21, eq. 5]."""

from torchbrdf.arguments import check_types, warn_of_lost_gradient
from torchbrdf.brdf import MaterialLibrary
from torchbrdf.light import LightProbe
from torchbrdf.mitsuba_backend import bake_basis
from torchbrdf.transport import DEFAULT_SAMPLES, BasisImages, sampled_basis
from torchbrdf.transport.harmonic import HarmonicBasis, in_perspective, is_precomputed, unsuited
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

    backend   "sampled"; "harmonic", precomputed once per library, some ten to twenty times as fast, for balls and, of
              orthographic cameras, other shapes without shadows; "mitsuba", slower and independent, with an error
              estimate for every image (`mitsuba_backend.bake_basis`). "auto" is "harmonic" where the library's
              transport has been precomputed (`torchbrdf precompute`), the view allows it and no samples are given,
              else "sampled"
    samples   a pixel, on average over the view, at least 2; None for 4096. Not for "harmonic"
    adaptive  give the pixels that need it more samples than others; "sampled" only
    They run on the device that holds the library's columns, "mitsuba" on the CPU. Only pixels under the view's mask are
    computed and only cells that samples touch are read. "harmonic" is differentiable in the probe's radiance; the
    others warn where that requires a gradient. Raises ValueError for an unknown backend, too few samples, a view that
    "harmonic" cannot take, or arguments of other types.
    """
    check_types("tb.render_basis", library=(library, MaterialLibrary), probe=(probe, LightProbe), view=(view, View))
    if backend == "auto":
        fast = samples is None and unsuited(view) is None and is_precomputed(library, in_perspective(view))
        backend = "harmonic" if fast else "sampled"
    if backend == "harmonic":
        return HarmonicBasis(library, probe, view, progress).basis_at()
    warn_of_lost_gradient(probe.radiance, f"the probe's radiance with backend={backend!r}", '"harmonic" carries it')
    samples = DEFAULT_SAMPLES if samples is None else samples
    if backend == "mitsuba":
        return bake_basis(library, probe, view, samples, seed, progress)
    if backend == "sampled":
        return sampled_basis(library, probe, view, samples, seed, progress, adaptive)
    raise ValueError(f'backend must be "auto", "sampled", "harmonic" or "mitsuba", got {backend!r}')
