"""Linear radiance on a screen: the tone curve, and the exposures that suit an image."""

from math import log2

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

DISPLAY_GAMMA = 2.2


def tone_map(image: Tensor, exposure: float = 1.0) -> Tensor:
    """Display values of linear radiance: (exposure * image clipped to [0, 1]) ** (1 / 2.2); NaN becomes 0.

    image      (..., 3, H, W), or any other shape
    returns    the same shape, in [0, 1]
    source     [CBP21, section VII]
    """
    return torch.nan_to_num(image * exposure, nan=0.0).clamp(0.0, 1.0) ** (1.0 / DISPLAY_GAMMA)


def with_rim(image: Tensor, mask: Tensor, coverage: Tensor) -> Tensor:
    """An image (3, H, W) before black, of which pixels outside its mask (1, H, W) show the shape in part.

    coverage  (1, H, W)  how much of each pixel it covers; they show as much of what is beside them under the mask
    """
    inside = torch.where(mask, image, 0)
    beside = avg_pool2d(inside, 3, 1, 1) / avg_pool2d(mask.to(image), 3, 1, 1).clamp_min(1e-9)
    return torch.where(mask, image, beside * coverage.to(image))


def exposure_for(image: Tensor, used: Tensor) -> float:
    """The factor that takes the 99th percentile of the brightest channel to white.

    image  (3, H, W);  used  (1, H, W) bool
    """
    bright = image.amax(0)[used[0]].double()
    white = float(torch.quantile(bright[:: max(1, len(bright) // 1_000_000)], 0.99)) if len(bright) else 0.0
    return 1 / white if white > 0 else 1.0


def exposure_for_light(radiance: Tensor) -> float:
    """The factor that takes the 93rd percentile of light to white: lamps are clipped, the room is seen.

    radiance  (...) of the brightest channel
    """
    white = float(torch.quantile(radiance, 0.93)) or float(radiance.max())
    return 1 / white if white > 0 else 1.0


def stops_for(image: Tensor) -> tuple[float, float]:
    """Two exposures for (3, H, W), powers of two: for its highlight, and for what lies beside it.

    The first brings the brightest thousandth of the lit pixels to white, the second the upper quartile to half
    of white, but not below the first.
    """
    bright = image.amax(0)
    lit = bright[bright > 0].double()
    if not len(lit):
        return 1.0, 1.0
    peak, quartile = (float(torch.quantile(lit, q)) for q in (0.999, 0.75))
    first = 2.0 ** round(log2(1 / peak))
    return first, max(first, 2.0 ** round(log2(0.5 / quartile)))
