"""How far one BRDF is from another: over the cells of the table, and in a picture of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.merl_grid import measured_share
from torchbrdf.brdf.metrics import METRICS, cell_measure, incident_cosine
from torchbrdf.images import relative_rms


@dataclass(frozen=True)
class BRDFDifference:
    """One BRDF against a reference.

    cells         metric of `METRICS` -> `cell_difference`
    common        share of the cells above the horizon that were measured in both
    picture       relative RMS difference of a picture of it; infinite where that of the reference is black
    delta_e_mean  CIEDE2000, mean over the picture
    delta_e_95    and its 95th percentile
    """

    cells: Mapping[str, float]
    common: float
    picture: float
    delta_e_mean: float
    delta_e_95: float

    @classmethod
    def of(
        cls, table: MerlTable, reference: MerlTable, pictures: tuple[Tensor, Tensor], mask: Tensor, exposure: float
    ) -> "BRDFDifference":
        """Compare two tables and pictures of them.

        pictures  radiance (3, H, W) of the table and of the reference under one light
        mask      (1, H, W)  bool, True = use
        exposure  what takes radiance to the picture's values, 1 = white
        Raises ValueError where no cell was measured in both.
        """
        image, target = pictures
        colours = delta_e_2000(image, target, exposure)[mask[0]]
        lit = bool(target[mask.expand(target.shape)].any())
        black = 0.0 if not bool(image[mask.expand(image.shape)].any()) else inf
        return cls(
            _cell_differences(table, reference, tuple(METRICS)),
            measured_share(table.valid.cpu() & reference.valid.cpu()),
            relative_rms(image, target, mask) if lit else black,
            float(colours.mean()),
            float(torch.quantile(colours[:: max(1, len(colours) // 1_000_000)], 0.95)),
        )


def cell_difference(table: MerlTable, reference: MerlTable, metric: str) -> float:
    """Relative difference of two tables in a metric.

    |m(f cos) - m(g cos)| / |m(g cos)|, |x|^2 = sum of x^2 dw_i dw_o over R, G, B and the cells measured in both

    metric   a key of `METRICS`: m is "l2", "log" or "cube-root"
    returns  0 where both are 0, infinity where only the reference is 0
    Negative f_r counts as 0, as in a file. Raises ValueError for an unknown metric, or where no cell is common.
    """
    if metric not in METRICS:
        raise ValueError(f"metric must be one of {', '.join(METRICS)}, got {metric!r}")
    return _cell_differences(table, reference, (metric,))[metric]


def _cell_differences(table: MerlTable, reference: MerlTable, metrics: tuple[str, ...]) -> dict[str, float]:
    """`cell_difference` in some metrics."""
    common = table.valid.cpu() & reference.valid.cpu()
    if not common.any():
        raise ValueError(f"{table.name} and {reference.name}: no cell was measured in both, so nothing can be compared")
    cosine, measure = incident_cosine()[common][:, None], cell_measure()[common]
    weighted = [t.values.cpu()[common].double().clamp_min(0) * cosine for t in (table, reference)]
    found = {}
    for metric in metrics:
        one, other = map(METRICS[metric], weighted)
        off, size = (float((part.square().sum(1) * measure).sum()) for part in (one - other, other))
        found[metric] = (off / size) ** 0.5 if size else inf if off else 0.0
    return found


def delta_e_2000(image: Tensor, reference: Tensor, exposure: float = 1.0) -> Tensor:
    """(H, W) float64: CIEDE2000 of two pictures, pixel by pixel [SWD05]; 1 is about what an eye notices side by side.

    image, reference  (3, H, W)  linear radiance; R, G, B have the primaries of sRGB
    exposure          radiance times this is the picture's value; beyond [0, 1] it is clipped, as on a screen
    White is D65: R = G = B = 1.
    """
    if image.shape != reference.shape or image.ndim != 3 or image.shape[0] != 3:
        raise ValueError(
            f"images must have equal shapes (3, H, W), got {tuple(image.shape)} and {tuple(reference.shape)}"
        )
    from skimage.color import deltaE_ciede2000

    one, other = (_lab((picture.detach().cpu().double() * exposure).numpy()) for picture in (image, reference))
    return torch.from_numpy(deltaE_ciede2000(one, other))


def _lab(picture: np.ndarray) -> np.ndarray:
    """L*a*b* (H, W, 3) of linear sRGB (3, H, W)."""
    from skimage.color import xyz2lab
    from skimage.color.colorconv import xyz_from_rgb

    return xyz2lab(np.moveaxis(picture.clip(0.0, 1.0), 0, -1) @ xyz_from_rgb.T, illuminant="D65", observer="2")
