"""Light transport between a probe and a view by samples: images of columns of B [CBP21, eq. 5].

For every pixel a set of weighted MERL cells stands for the integral over light directions and over the pixel's
area: radiance = sum_s weight_s f_r(cell_s). Basis images gather rows of B by those cells; a rendering of one
table gathers its values. A pilot with few samples says which pixels need many.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.arguments import whole
from torchbrdf.brdf import GRID, MaterialLibrary
from torchbrdf.images import LUMINANCE
from torchbrdf.light import LightProbe, LightStrata
from torchbrdf.progress import progress_bar
from torchbrdf.transport._importance import Lobes, allocate, representatives
from torchbrdf.transport.basis_images import BasisImages
from torchbrdf.transport.sampling import LEAST, TransportSampler, TransportSamples
from torchbrdf.view import View

_BLOCK = 1 << 17
"""Samples, or pairs of a pixel and a stratum, worked on at once on a CPU: their arrays stay in its cache."""

_BAG = 256
"""Samples of a pixel that are summed in the columns' own precision."""

_LOOK = 256
"""Samples a pixel of a first look; a power of two."""

_FIRST_LOOK = 384
"""Pixels that say about how bright each column's image is."""


def sampled_basis(
    library: MaterialLibrary,
    probe: LightProbe,
    view: View,
    samples: int,
    seed: int = 0,
    progress: bool = False,
    adaptive: bool = True,
) -> BasisImages:
    """Images Y of every basis BRDF; `rendering.render_basis` says what the arguments mean."""
    columns, scale = library.stored.columns, library.stored.scale
    library.stored.prefetch()
    packed = render_columns(columns, probe, view, samples, seed, adaptive, progress)
    packed = (packed * scale.to(packed.device, torch.float32))[..., library.column_index.to(packed.device)]
    description = f"sampled, {samples} samples a pixel, seed {seed}"
    return BasisImages.of(packed.permute(2, 0, 1).contiguous(), library, probe, view, description)


def render_columns(
    columns: Tensor,
    probe: LightProbe,
    view: View,
    samples: int,
    seed: int,
    adaptive: bool = True,
    progress: bool = False,
) -> Tensor:
    """(3, P, n): the images of columns (N_CELLS, n), in their units."""
    plan = plan_transport(columns, probe, view, samples, seed, adaptive)
    packed = torch.empty(3, len(view.pixels), columns.shape[1], dtype=torch.float32, device=columns.device)
    total = int(plan.counts.sum())
    with progress_bar(total=total, desc="basis images, samples", unit="", unit_scale=True, shown=progress) as bar:
        for chosen, transport in plan.blocks():
            packed[:, chosen] = gather_columns(transport, columns)
            bar.update(int(plan.counts[chosen].sum()))
    return packed.mul_(plan.sampler.strata.unit)


@dataclass(frozen=True)
class TransportPlan:
    """How the pixels of a view are sampled.

    counts  (P,)  int64, samples of each pixel, powers of two
    """

    sampler: TransportSampler
    lobes: Lobes
    counts: Tensor

    def blocks(self) -> Iterator[tuple[Tensor, TransportSamples]]:
        """All pixels, a block of equal counts at a time: which of those under the mask, and their samples."""
        for count in torch.unique(self.counts).tolist():
            chosen = torch.nonzero(self.counts == count).ravel()
            yield from _blocks(self.sampler, self.lobes, chosen, count)


def _blocks(
    sampler: TransportSampler, lobes: Lobes, chosen: Tensor, count: int
) -> Iterator[tuple[Tensor, TransportSamples]]:
    block = _BLOCK if chosen.device.type == "cpu" else 64 * _BLOCK
    for some in chosen.split(max(1, block // max(count, len(sampler.strata)))):
        yield some, sampler.draw(some, count, lobes)


def plan_transport(
    columns: Tensor, probe: LightProbe, view: View, samples: int, seed: int, adaptive: bool = True
) -> TransportPlan:
    """Decide how to sample for columns (N_CELLS, n), on their device.

    First some pixels tell the energy of every column's image; with it the lobes are known. Then all pixels tell,
    with few samples, how much each adds to the relative squared error of representative columns. These samples
    are independent of the later ones: a pixel that missed its light twice would be too dark on average [KA91].
    """
    samples = whole("samples", samples)
    if samples < 2:
        raise ValueError(f"the transport needs at least 2 samples a pixel, got {samples}")
    columns, device = columns.detach(), columns.device
    generator = torch.Generator().manual_seed(seed)
    strata = LightStrata.build(probe.to(device), generator)
    average = max(LEAST, 1 << (samples.bit_length() - 1))
    pilot = min(_LOOK, max(LEAST, average // 8))
    sampler = TransportSampler.build(strata, view, max(32 * average, _LOOK), generator)
    scout = sampler.reshifted(generator)
    pixels = torch.arange(len(view.pixels), device=device)

    profiles = columns.view(GRID[0], GRID[1], GRID[2], -1)[:, :, GRID[2] // 2].float()
    some = pixels[:: max(1, len(pixels) // _FIRST_LOOK)]
    looks = [gather_columns(draws, columns) for _, draws in _blocks(scout, Lobes.unknown(device), some, _LOOK)]
    energy = torch.cat(looks, 1).double().square().sum((0, 1))
    lobes = Lobes.of(profiles, energy)
    if not adaptive or not bool((energy > 0).any()):
        return TransportPlan(sampler, lobes, torch.full_like(pixels, average))
    few = representatives(profiles, energy)
    moments = [_moments(draws, few) for _, draws in _blocks(scout, lobes, pixels, pilot)]
    mean, variance = (torch.cat(parts) for parts in zip(*moments, strict=True))
    counts = allocate(
        variance, mean.double().square().sum(0), samples, max(LEAST, average // 4), sampler.points.shape[1]
    )
    return TransportPlan(sampler, lobes, counts)


def _moments(transport: TransportSamples, profiles: Tensor) -> tuple[Tensor, Tensor]:
    """Means (Q, m) of the luminance of profiles (8100, m), and their variances with one sample."""
    rows = transport.cells // GRID[2]
    weights = sum(share * weight for share, weight in zip(LUMINANCE, transport.weights, strict=True))
    bag = torch.nn.functional.embedding_bag
    mean = bag(rows, profiles, per_sample_weights=weights, mode="sum")
    square = bag(rows, profiles.square(), per_sample_weights=weights * weights, mode="sum")
    return mean, (rows.shape[1] * square - mean * mean).clamp_min_(0)


def gather_columns(transport: TransportSamples, columns: Tensor) -> Tensor:
    """(3, Q, n) float32: weighted sums of rows of columns (N_CELLS, n), in their units.

    The three channels stand side by side so that the rows are still in cache for the second and third. The
    samples come in an order of like weights; bags of few of them, each divided by the power of two that brings
    its sum to between 4 and 8, keep float16 from losing the small weights of the brightest cells. (Columns stay
    below 2^12, so that no sum overflows.)
    """
    q, s = transport.cells.shape
    size = min(_BAG, max(1, s // 8))
    cells, weights = transport.cells, transport.weights
    if s % size:
        cells, weights = (torch.nn.functional.pad(values, (0, -s % size)) for values in (cells, weights))
    n_bags = cells.numel() // size
    cells = cells.view(n_bags, 1, size).expand(-1, 3, size)
    weights = weights.reshape(3, n_bags, size).transpose(0, 1)
    total = weights.sum(-1, keepdim=True)
    unit = torch.exp2(torch.ceil(torch.log2(torch.where(total > 0, total, 1.0))) - 3)
    sums = torch.nn.functional.embedding_bag(
        cells.reshape(-1, size),
        columns,
        mode="sum",
        per_sample_weights=(weights / unit).to(columns.dtype).reshape(-1, size),
    )
    return (sums.view(q, n_bags // q, 3, -1).float() * unit.view(q, -1, 3, 1)).sum(1).permute(1, 0, 2)
